"""Which segments are vertical edges, and which of those are one edge."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from localiser.camera import Camera
from localiser.edges.mount import LENS_SIGMA, NEAR_RAD, MountError, NadirMiss, fit_mount, nadir_miss
from localiser.edges.types import Edges, Segments
from localiser.edges.views import ideal_camera
from localiser.geometry import Array
from localiser.geometry.compiled import compiled

_ABOVE_NADIR = 0.05
"""Least c + e s of an edge's ends: closer to the nadir point, or below it, a line tells no bearing ahead."""
_VAGUE_RAD = 0.5
"""A segment so short that it would pass in nearly any direction proves nothing."""
REACH_RAD = float(np.arctan(1 / 8))
"""How far from vertical `columns` looks, a column a block."""
_BESIDE_SHARE = 0.5
"""Segments that have more than this fraction of the shorter one's height in common are side by side."""
_RESOLVED_PX = 1.5
"""Segments side by side that are closer than this are one edge that was found twice."""


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
    better tilt and roll, and on how crooked edges are here, which then decide. Plumb: how far real edges are from
    vertical. turn_sigma_rad: by how much segments (S,) may be turned besides.
    """
    miss = nadir_miss(segments, camera, plumb_sigma_rad, lens_sigma=LENS_SIGMA)
    miss = replace(miss, sigma=np.hypot(miss.sigma, turn_sigma_rad))
    prior = MountError.prior(mount_sigma_rad)
    e, tilt_rad = ideal_camera(camera).upright_from_pixels(segments.ends_px)[..., 1], camera.mount.tilt_rad
    above_nadir = (np.cos(tilt_rad) + e * np.sin(tilt_rad)).min(axis=1) > _ABOVE_NADIR
    candidates = above_nadir & _is_met(miss, prior, gate_sigma)
    # Of a vague mount, lines that are not vertical are candidates too: they would tell that all edges are crooked.
    is_near = bool(mount_sigma_rad.max() <= NEAR_RAD)
    posterior = fit_mount(miss.take(candidates), mount_sigma_rad, learn_crooked=is_near)
    return candidates & _is_met(miss, posterior, gate_sigma), posterior


def _is_met(miss: NadirMiss, mount: MountError, gate_sigma: float) -> NDArray[np.bool_]:
    """Return (S,) whether segments point at the nadir point as well as a vertical edge would."""
    angle, by_mount = miss.corrected(mount)
    allowed = gate_sigma * np.sqrt(miss.sigma**2 + (mount.crooked * miss.crooked) ** 2 + by_mount)
    return np.asarray((np.abs(angle) <= allowed) & (allowed < _VAGUE_RAD))


def has_direction(edges: Edges, plumb_sigma_rad: float, gate_sigma: float) -> NDArray[np.bool_]:
    """Return (E,) whether the direction of edges is known so well that not all that are looked at would pass."""
    allowed = gate_sigma * np.hypot(edges.lean_sigma, plumb_sigma_rad)
    return np.asarray(allowed < REACH_RAD)


def same_edge(segments: Segments, camera: Camera, mount: MountError, gate_sigma: float) -> NDArray[np.int64]:
    """Return the edge (S,) that each vertical segment belongs to, numbered from 0.

    Segments are of one edge when they have the same polarity and their bearings agree within noise. The gap between
    them may be long, because something in front can hide a part of the edge. Segments side by side are two edges
    unless they are too close to be distinguished. The most certain segment collects what agrees with it first, so that
    uncertain ones cannot join two edges in a chain.
    """
    ideal = ideal_camera(camera)
    per_px = ideal.bearing_sigma_of_segments(segments.support_px, 1.0)
    bearing = ideal.bearing_of_segments(segments.support_px)
    middle_e = ideal.upright_from_pixels(segments.support_px.mean(axis=1))[:, 1]
    per_mount = ideal.bearing_jacobians(bearing, middle_e)[1]
    variance = (per_px * segments.across_sigma_px) ** 2
    return compiled(same_edge_loop)(
        bearing + per_mount @ mount.mean,
        np.argsort(variance, kind="stable"),
        per_mount,
        mount.cov,
        variance,
        np.stack([per_px * _RESOLVED_PX * np.sqrt(2.0), gate_sigma * per_px * segments.sigma_px], axis=-1),
        np.ascontiguousarray(ideal.upright_from_pixels(segments.ends_px)[..., 1]),
        segments.polarity,
        gate_sigma,
        _BESIDE_SHARE,
    )


# -- loops, for numba to compile --------------------------------------------------------------------------------------


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
    beside_share: float,
) -> NDArray[np.int64]:
    """Return the edge (S,) of each segment, the most certain one gathering first: `same_edge`.

    order: (S,) from the most certain segment to the least; sorting would take longer to compile than all of this.
    told_apart: (S, 2) least difference that can be told apart, and by scatter. extent: (S, 2) lowest and highest e.
    """
    count = len(bearing)
    edge = np.full(count, -1, np.int64)
    edges = 0
    for first in order:
        if edge[first] >= 0:
            continue
        for other in range(count):
            if edge[other] >= 0 or polarity[other] != polarity[first]:
                continue
            by_tilt, by_roll = per_mount[other] - per_mount[first]
            by_mount = mount_cov[0, 0] * by_tilt**2 + 2 * mount_cov[0, 1] * by_tilt * by_roll
            by_mount += mount_cov[1, 1] * by_roll**2
            allowed = gate_sigma * np.sqrt(variance[first] + variance[other] + by_mount)
            common = min(extent[first, 1], extent[other, 1]) - max(extent[first, 0], extent[other, 0])
            shorter = min(extent[first, 1] - extent[first, 0], extent[other, 1] - extent[other, 0])
            if common > beside_share * shorter:
                scatter = np.hypot(told_apart[first, 1], told_apart[other, 1])
                allowed = min(allowed, max(told_apart[other, 0], scatter))
            if abs(bearing[other] - bearing[first]) <= allowed:
                edge[other] = edges
        edges += 1
    return edge
