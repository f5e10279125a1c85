"""Find the vertical edges of an image: detect segments, keep those that meet the nadir point, join and measure them.

And how an image is exposed: too dark or washed out, by its grey levels.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from functools import partial

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from localiser.camera import Camera, Mount, MountSigma
from localiser.edges.detectors import DETECTORS, Detector, EdgeParameters, columns, registered, segments_of_lines
from localiser.edges.measure import edges_of_segments, polarity_of_profiles, profiles, readout_of
from localiser.edges.mount import LENS_SIGMA, NEAR_RAD, MountError, NadirMiss, fit_mount, nadir_miss
from localiser.edges.types import Edges, Segments
from localiser.edges.views import Image, half_camera, halved
from localiser.errors import InputError
from localiser.geometry import Array, Twist
from localiser.geometry.compiled import compiled
from localiser.image_files import decode
from localiser.markers import sides_of_markers

END_SIGMA_PX = 0.5  # of an end across the line, if not stated
_MARKER_SIGMA_PX = 0.3  # of a marker's corner


def find_edges(
    image: Image,
    camera: Camera,
    parameters: EdgeParameters | None = None,
    *,
    mount: Mount | None = None,
    twist: Twist | None = None,
    detector: Detector | None = None,
) -> Edges:
    """Return the vertical edges of an image.

    image: (H, W) grey or (H, W, 3) BGR, uint8, of the size that the camera says. mount: of the camera when it took the
    image; None: as the camera says. twist: of the robot then, which matters where the camera's shutter rolls; edges are
    then as they were at the image's time stamp. detector: what finds segments, by default the one that the parameters
    name; see `Detector`. Raises InputError.
    """
    parameters, camera = parameters or EdgeParameters(), camera.at(mount)
    grey = grey_image(image, camera)
    if parameters.half_resolution and min(grey.shape) >= 4:
        smaller = replace(parameters, half_resolution=False, min_length_px=parameters.min_length_px / 2)
        edges = find_edges(halved(grey), half_camera(camera), smaller, twist=twist, detector=detector)
        ends_px, rejected_px = (2.0 * pixels + 0.5 for pixels in (edges.ends_px, edges.rejected_px))
        return replace(edges, ends_px=ends_px, rejected_px=rejected_px, length_px=2.0 * edges.length_px, mount=mount)
    found = (detector or _detector_of(parameters))(grey, camera)
    if not isinstance(found, Segments):
        lines = np.asarray(found, dtype=np.float64)
        if lines.size and (lines.ndim != 2 or lines.shape[1] != 4):
            raise InputError(f"expected lines (S, 4) of a detector, found an array {lines.shape}", field="detector")
        found = segments_of_lines(lines, camera, END_SIGMA_PX)
    taken, code = found, np.full(len(found), -1)
    if parameters.markers:
        lines, codes = sides_of_markers(grey, parameters.markers)
        sides, code = segments_of_lines(lines, camera, _MARKER_SIGMA_PX), np.concatenate([code, codes])
        sides = replace(sides, polarity=polarity_of_profiles(profiles(sides.ends_px, grey, camera)))
        both = ([getattr(one, each.name) for one in (taken, sides)] for each in fields(taken))
        taken = Segments(*map(np.concatenate, both))
    segments, readout, turn_sigma_rad = taken, readout_of(camera, twist), np.zeros(len(taken))
    if readout is not None:
        rate, rate_sigma = readout.rates(taken.ends_px)
        ends_px, support_px = (readout.at_stamp(points, rate) for points in (taken.ends_px, taken.support_px))
        segments = replace(taken, ends_px=ends_px, support_px=support_px)
        turn_sigma_rad = np.abs(readout.per_turn(support_px, rate)[0]) * np.hypot(rate_sigma, readout.turn_sigma_rad_s)
    stated, usual = camera.mount.sigma or MountSigma(), parameters.mount_sigma_rad.tolist()
    sigmas = zip((stated.tilt_rad, stated.roll_rad), usual, strict=True)
    mount_sigma_rad = np.array([otherwise if sigma is None else sigma for sigma, otherwise in sigmas])
    plumb_sigma_rad = float(np.deg2rad(parameters.plumb_sigma_deg))
    gate = parameters.gate_sigma
    vertical, error = vertical_segments(segments, camera, mount_sigma_rad, plumb_sigma_rad, gate, turn_sigma_rad)
    kept, others = segments.take(vertical), segments.take(~vertical)
    if not kept.polarity.all():
        kept = replace(kept, polarity=polarity_of_profiles(profiles(taken.ends_px[vertical], grey, camera)))
    edge = same_edge(kept, camera, error, gate)
    edges = edges_of_segments(kept, edge, grey, camera, mount_sigma_rad, readout)
    np.minimum.at(edges.landmark_id, edge, code[vertical])
    is_long = edges.length_px >= parameters.min_length_px
    # Is the direction known so well that not all that are looked at would pass?
    is_sure = is_long & (gate * np.hypot(edges.lean_sigma, plumb_sigma_rad) < REACH_RAD)
    edges = edges.take(is_sure | (edges.landmark_id < -1))
    rejected = camera.ideal.image_from_pixels(others.ends_px)
    return replace(edges, rejected_px=camera.pixels_from_image(rejected), mount=mount)


def _detector_of(parameters: EdgeParameters) -> Detector:
    """Return the registered detector that the parameters name, with their settings. Raises InputError."""
    try:
        detector = DETECTORS[registered(parameters.detector)]
    except ValueError as error:
        raise InputError(f"{error}, found {parameters.detector!r}", field="detector") from None
    return partial(columns, min_contrast=parameters.min_contrast) if parameters.detector == "columns" else detector


def grey_image(image: Image, camera: Camera) -> Image:
    """Return the grey image (H, W) of a grey or BGR one. Raises InputError when type or size is not as expected."""
    if not isinstance(image, np.ndarray):
        raise InputError(f"expected an array of 8-bit grey or BGR, found {type(image).__name__}", field="image")
    if image.dtype != np.uint8 or not (image.ndim == 2 or (image.ndim == 3 and image.shape[2] == 3)):
        raise InputError(f"expected 8-bit grey or BGR, found {image.dtype} {image.shape}", field="image")
    if image.shape[:2] != (camera.height, camera.width):
        found = f"{image.shape[1]}×{image.shape[0]}"
        raise InputError(f"expected {camera.width}×{camera.height} as the camera says, found {found}", field="image")
    return np.ascontiguousarray(image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), dtype=np.uint8)


# -- which segments are vertical edges, and which of those are one edge ----------------------------------------------

_ABOVE_NADIR = 0.05  # least c + e s of an edge's ends: nearer to the nadir point, a line tells no bearing ahead
_VAGUE_RAD = 0.5  # a segment so short that it would pass in nearly any direction proves nothing
REACH_RAD = float(np.arctan(1 / 8))  # how far from vertical `columns` looks, a column a block
_BESIDE_SHARE = 0.5  # segments that have more than this fraction of the shorter one's height in common are side by side
_RESOLVED_PX = 1.5  # segments side by side that are closer than this are one edge that was found twice


def vertical_segments(
    segments: Segments,
    camera: Camera,
    mount_sigma_rad: Array,
    plumb_sigma_rad: float,
    gate_sigma: float,
    turn_sigma_rad: ArrayLike = 0.0,
) -> tuple[NDArray[np.bool_], MountError]:
    """Return (S,) which segments meet the nadir point within what noise allows, and the error of the stated mount.

    The stated tilt and roll, uncertain by `mount_sigma_rad` (2,), say which segments may be vertical. Those agree on a
    better tilt and roll, and on how crooked edges are here, which then decide. turn_sigma_rad: by how much segments
    (S,) may be turned besides.
    """
    miss = nadir_miss(segments, camera, plumb_sigma_rad, lens_sigma=LENS_SIGMA)
    miss = miss._replace(sigma=np.hypot(miss.sigma, turn_sigma_rad))
    prior = MountError(np.zeros(3), np.diag(np.append(mount_sigma_rad, 1.0) ** 2))
    e, tilt_rad = camera.ideal.upright_from_pixels(segments.ends_px)[..., 1], camera.mount.tilt_rad
    above_nadir = (np.cos(tilt_rad) + e * np.sin(tilt_rad)).min(axis=1) > _ABOVE_NADIR
    candidates = above_nadir & _is_met(miss, prior, gate_sigma)
    # Of a vague mount, lines that are not vertical are candidates too: they would tell that all edges are crooked.
    is_near = bool(mount_sigma_rad.max() <= NEAR_RAD)
    posterior = fit_mount(NadirMiss(*(column[candidates] for column in miss)), mount_sigma_rad, learn_crooked=is_near)
    return candidates & _is_met(miss, posterior, gate_sigma), posterior


def _is_met(miss: NadirMiss, mount: MountError, gate_sigma: float) -> NDArray[np.bool_]:
    """Return (S,) whether segments point at the nadir point as well as a vertical edge would."""
    angle = miss.angle + miss.per_mount @ mount.state
    by_mount = ((miss.per_mount @ mount.state_cov) * miss.per_mount).sum(axis=1)
    allowed = gate_sigma * np.sqrt(miss.sigma**2 + (mount.crooked * miss.crooked) ** 2 + by_mount)
    return np.asarray((np.abs(angle) <= allowed) & (allowed < _VAGUE_RAD))


def same_edge(segments: Segments, camera: Camera, mount: MountError, gate_sigma: float) -> NDArray[np.int64]:
    """Return the edge (S,) that each vertical segment belongs to, numbered from 0.

    Segments are of one edge when they have the same polarity and their bearings agree within noise, however long the
    gap: something in front may hide a part. Side by side they are two edges unless too close to be distinguished. The
    most certain segment collects what agrees with it first, so that uncertain ones cannot join two edges in a chain.
    """
    ideal = camera.ideal
    bearing, per_px = ideal.bearings_of_segments(segments.support_px, 1.0)
    middle_e = ideal.upright_from_pixels(segments.support_px.mean(axis=1))[:, 1]
    per_mount = ideal.bearing_jacobians(bearing, middle_e)[1]
    variance = (per_px * segments.across_sigma_px) ** 2
    told_apart = np.stack([per_px * _RESOLVED_PX * np.sqrt(2.0), gate_sigma * per_px * segments.sigma_px], axis=-1)
    extent = np.ascontiguousarray(ideal.upright_from_pixels(segments.ends_px)[..., 1])
    # Sorting in the loop would take longer to compile than all of it.
    order, bearing = np.argsort(variance, kind="stable"), bearing + per_mount @ mount.mean
    return compiled(same_edge_loop)(
        bearing, order, per_mount, mount.cov, variance, told_apart, extent, segments.polarity, gate_sigma
    )


# -- how an image is exposed ------------------------------------------------------------------------------------------

DARK_GREY = 64.0  # where 95 % of the pixels are darker than this, noise covers faint edges
SATURATED_GREY = 250
WASHED_OUT = 0.4  # fraction of saturated pixels from which on whole edges vanish in white


@dataclass(frozen=True, slots=True)
class Light:
    """bright_grey: the grey level that 95 % of the pixels are below. saturated: fraction of pixels at the top."""

    bright_grey: float
    saturated: float


def light_of(image: Image | bytes) -> Light:
    """Return how an image (H, W) or (H, W, 3), uint8, or as a file, is exposed, at an eighth of its size."""
    some = np.asarray(decode(image, cv2.IMREAD_REDUCED_GRAYSCALE_8)) if isinstance(image, bytes) else image[::8, ::8]
    return Light(float(np.percentile(some, 95)), float((some >= SATURATED_GREY).mean()))


def same_edge_loop(
    bearing: Array,
    order: NDArray[np.int64],
    per_mount: Array,
    mount_cov: Array,
    variance: Array,
    told_apart: Array,
    extent: Array,
    polarity: NDArray[np.int8],
    gate_sigma: float,
) -> NDArray[np.int64]:
    """Return the edge (S,) of each segment: `same_edge`. order: (S,) from the most certain segment to the least.

    told_apart: (S, 2) least difference that can be told apart, and by scatter. extent: (S, 2) lowest and highest e.
    """
    edge, edges = np.full(len(bearing), -1, np.int64), 0
    for first in order:
        if edge[first] >= 0:
            continue
        for other in range(len(bearing)):
            if edge[other] >= 0 or polarity[other] != polarity[first]:
                continue
            by_tilt, by_roll = per_mount[other] - per_mount[first]
            by_mount = mount_cov[0, 0] * by_tilt**2 + 2 * mount_cov[0, 1] * by_tilt * by_roll
            by_mount += mount_cov[1, 1] * by_roll**2
            allowed = gate_sigma * np.sqrt(variance[first] + variance[other] + by_mount)
            common = min(extent[first, 1], extent[other, 1]) - max(extent[first, 0], extent[other, 0])
            shorter = min(extent[first, 1] - extent[first, 0], extent[other, 1] - extent[other, 0])
            if common > _BESIDE_SHARE * shorter:
                scatter = np.hypot(told_apart[first, 1], told_apart[other, 1])
                allowed = min(allowed, max(told_apart[other, 0], scatter))
            if abs(bearing[other] - bearing[first]) <= allowed:
                edge[other] = edges
        edges += 1
    return edge
