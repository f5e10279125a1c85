"""Measure vertical edges: lean, bearing and their sigmas, and the foot."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from localiser import geometry
from localiser.camera import Camera, MountSigma
from localiser.edges.foot import foot_of_edges
from localiser.edges.groups import Groups
from localiser.edges.profile import profiles
from localiser.edges.readout import Readout
from localiser.edges.segments import Segments
from localiser.edges.types import TURN_RATE, CommonError, Edges
from localiser.edges.undistort import Image, ideal_camera
from localiser.geometry import Array

_TYPICAL_INVERSE_RANGE = 0.4
"""1/m: rooms are some metres wide."""


def edges_of_segments(
    segments: Segments,
    edge: NDArray[np.int64],
    image: Image,
    camera: Camera,
    mount_sigma_rad: Array,
    readout: Readout | None = None,
) -> Edges:
    """Return the edges (E) that segments (S) make up, where `edge` (S,) says which segment belongs to which.

    Bearing and lean are least squares over the support points of an edge's segments: design equation 7 for any number
    of points. The bearing's line is held through the nadir point, the lean's is free. mount_sigma_rad: (2,). readout:
    by which segments were brought to the image's time stamp, None where all rows were taken then.
    """
    if len(segments) == 0:
        return Edges.none()
    groups = Groups(edge, int(edge.max()) + 1)
    bearing, bearing_sigma = _bearings(segments, groups, camera)
    lean, lean_sigma, upright_ends, middle_e = _lean_and_ends(segments, groups, camera)
    image_ends = camera.image_from_upright(upright_ends)
    ideal = ideal_camera(camera)
    ends_px, ideal_px = camera.pixels_from_image(image_ends), ideal.pixels_from_image(image_ends)
    pieces_px = groups.sum(np.linalg.norm(segments.ends_px[:, 1] - segments.ends_px[:, 0], axis=-1))
    polarity = np.zeros(groups.count, dtype=np.int8)
    polarity[edge] = segments.polarity
    taken_of = None if readout is None else partial(readout.as_taken, rate=readout.rates(ideal_px)[0])
    shown_px = ends_px if taken_of is None else camera.pixels_from_image(ideal.image_from_pixels(taken_of(ideal_px)))
    foot_range, foot_sigma = foot_of_edges(ends_px[:, 0], camera, shown_px[:, 0])
    edges = Edges.from_columns(
        bearing,
        bearing_sigma,
        lean,
        lean_sigma,
        length_px=np.minimum(pieces_px, np.linalg.norm(ideal_px[:, 1] - ideal_px[:, 0], axis=-1)),
        polarity=polarity,
        ends_px=ends_px,
        foot_range_m=foot_range,
        foot_range_sigma_m=foot_sigma,
        profile=profiles(ideal_px, image, camera, taken_of),
        common=common_error(bearing, middle_e, camera, mount_sigma_rad),
    )
    return edges if readout is None else _with_turn(edges, ideal_px, readout)


def _bearings(segments: Segments, groups: Groups, camera: Camera) -> tuple[Array, Array]:
    """Return the bearing (E,) of each edge and its sigma: the mean of its segments, weighed by their sigmas.

    Segments of one edge that disagree by more than their sigmas make it as uncertain as they are apart.
    """
    ideal = ideal_camera(camera)
    each = ideal.bearing_of_segments(segments.support_px)
    weight = ideal.bearing_sigma_of_segments(segments.support_px, segments.across_sigma_px) ** -2
    total = groups.sum(weight)
    bearing = groups.sum(weight * each) / total
    members = np.bincount(groups.of, minlength=groups.count)
    apart = groups.sum(weight * (each - bearing[groups.of]) ** 2) / np.maximum(members - 1, 1)
    return bearing, np.sqrt(np.maximum(apart, 1.0) / total)


def _lean_and_ends(segments: Segments, groups: Groups, camera: Camera) -> tuple[Array, Array, Array, Array]:
    """Return lean (E,), its sigma (E,), upright ends (E, 2, 2), bottom first, and mean height e (E,) of free lines."""
    ideal = ideal_camera(camera)
    support = ideal.upright_from_pixels(segments.support_px)
    members = np.bincount(groups.of, minlength=groups.count)[groups.of]
    # What moves a segment as a whole turns an edge only where segments are joined.
    sigma_px = np.where(members > 1, segments.across_sigma_px, segments.end_sigma_px)
    # An error across a leaning line is one of 1 / cos(lean) along a.
    weight = (np.cos(ideal.lean_of_segments(segments.support_px)) / sigma_px * camera.focal_px) ** 2
    points = Groups(np.repeat(groups.of, 2), groups.count)
    fit = points.line(support[..., 1].ravel(), support[..., 0].ravel(), np.repeat(weight, 2))
    lean = np.arctan(fit.slope)
    end_e = ideal.upright_from_pixels(segments.ends_px)[..., 1].ravel()
    e = np.stack([points.lowest(end_e), points.highest(end_e)], axis=-1)
    a = fit.y[:, None] + fit.slope[:, None] * (e - fit.x[:, None])
    return lean, np.cos(lean) ** 2 / np.sqrt(fit.spread), np.stack([a, e], axis=-1), fit.x


def common_error(bearing: Array, middle_e: Array, camera: Camera, mount_sigma_rad: Array) -> CommonError:
    """Return what an error of tilt and roll (2,) does to the bearings (E,) of a frame (design equation 8).

    And what errors of the other values of the mount do, where their sigma is stated. How far edges stand off decides
    what an offset does; it is taken as typical.
    """
    from_lean, from_line = camera.bearing_jacobians(bearing, middle_e)
    names, variances = ["tilt", "roll"], list(mount_sigma_rad**2)
    stated, zero = camera.mount.sigma or MountSigma(), np.zeros_like(bearing)
    others = {
        "yaw": (stated.yaw_rad, zero + 1.0),
        "height": (stated.height_m, zero),
        "right": (stated.right_m, -np.cos(bearing) * _TYPICAL_INVERSE_RANGE),
        "back": (stated.back_m, -np.sin(bearing) * _TYPICAL_INVERSE_RANGE),
    }
    for name, (sigma, per_unit) in others.items():
        if sigma:
            names.append(name)
            variances.append(sigma**2)
            from_lean, from_line = np.column_stack([from_lean, per_unit]), np.column_stack([from_line, per_unit])
    return CommonError(tuple(names), np.diag(variances), from_lean, from_line)


def _with_turn(edges: Edges, ends_px: Array, readout: Readout) -> Edges:
    """Return edges with the errors that the readout leaves: by unknown ranges, and by the turn rate, common to all.

    ends_px: (E, 2, 2) undistorted.
    """
    rate, rate_sigma = readout.rates(ends_px)
    turned, shifted = readout.turn_of(ends_px, rate), readout.shift_of(ends_px, rate)
    common, tilt_rad = edges.common, readout.camera.mount.tilt_rad
    per_lean = geometry.bearing_per_lean(edges.bearing, tilt_rad) if abs(np.sin(tilt_rad)) > 1e-12 else np.nan
    cov = np.zeros((len(common.names) + 1, len(common.names) + 1))
    cov[:-1, :-1], cov[-1, -1] = common.cov, readout.turn_sigma_rad_s**2
    return replace(
        edges,
        bearing_sigma=np.hypot(edges.bearing_sigma, shifted * rate_sigma),
        lean_sigma=np.hypot(edges.lean_sigma, turned * rate_sigma),
        common=CommonError(
            (*common.names, TURN_RATE),
            cov,
            np.column_stack([common.bearing_from_lean, per_lean * turned]),
            np.column_stack([common.bearing_from_line, shifted]),
        ),
    )
