"""Pose hypotheses: poses at which chosen edges would be chosen landmarks, by two feet or by three bearings.

Each function draws as many hypotheses as requested, at random among all combinations that do not contradict the
measurements. A random part of a large set keeps one image cheap; the next image draws another part.
"""

from __future__ import annotations

import numpy as np

from localiser.geometry import Array
from localiser.relocalisation.places import BOTTOM_STEP_M, Indices, Places
from localiser.relocalisation.resection import from_three_bearings, from_two_bearings
from localiser.relocalisation.views import View

GATE_SIGMAS = 1.0  # narrow: more pairs of edges can be tried, which finds more than it loses
MOST_TRIPLES = 10  # times as many of landmarks as are tried: beyond that a right one is hardly ever among them
AT_ONCE = 8  # pairs of edges looked up together
NARROWEST_RAD = np.radians(3.0)  # between two bearings: below it they fix hardly more than one does
WORST_RANGE = 0.25  # relative error of a range that still tells something


def from_feet(view: View, places: Places, count: int, rng: np.random.Generator) -> Array:
    """Return robot poses (K ≤ count, 3) at which two edges, with the ranges of their feet, are two landmarks.

    Two edges with ranges make two points, and only pairs of landmarks as far apart as these can be them. The bearings
    are then held exactly; of the ranges only the ratio counts.
    """
    i, j = _wide_pairs(view, np.flatnonzero(~view.cut & np.isfinite(view.foot)))
    if len(i) == 0 or count == 0:
        return np.zeros((0, 3))
    ranges, sigmas = _foot_ranges(view, places)
    order = np.argsort(rng.exponential(size=len(i)) / _merit(view, sigmas, i, j))
    found, total = [], 0
    for chunk in np.array_split(order, -(-len(order) // AT_ONCE)):
        found.append(_from_pairs(view, places, np.stack([i, j], axis=-1)[chunk], ranges, sigmas))
        total += len(found[-1])
        if total >= count:
            break
    cameras = np.concatenate(found)
    return view.robot_poses(cameras[:count])


def _merit(view: View, sigmas: Array, i: Indices, j: Indices) -> Array:
    """Return how soon each pair of edges (P,) is to be tried: long edges, which are rarely clutter, with sure ranges.

    An exponential draw over this, sorted, is a draw without putting back with chances in proportion to it.
    """
    told = np.isfinite(sigmas)
    sigma = np.where(told, sigmas, 0.0).sum(axis=1) / np.maximum(told.sum(axis=1), 1)
    sigma = np.where(told.any(axis=1), sigma, sigma.max(initial=1.0))
    return np.asarray(np.sqrt(view.length_px[i] * view.length_px[j]) / (sigma[i] + sigma[j]))


def _from_pairs(view: View, places: Places, edges: Indices, ranges: Array, sigmas: Array) -> Array:
    """Return all camera poses (K, 3) at which pairs of edges (P, 2) are landmarks at the distance of their feet."""
    groups = len(places.class_m)
    r_i, r_j = ranges[edges[:, 0], :, None], ranges[edges[:, 1], None, :]
    s_i, s_j = sigmas[edges[:, 0], :, None], sigmas[edges[:, 1], None, :]
    cos = np.cos(view.bearing[edges[:, 1]] - view.bearing[edges[:, 0]])[:, None, None]
    apart = np.sqrt(r_i**2 + r_j**2 - 2 * r_i * r_j * cos)
    # The distance of the feet by their ranges, to first order.
    sigma = np.hypot(s_i * (r_i - r_j * cos), s_j * (r_j - r_i * cos)) / np.maximum(apart, 1e-6)
    pair, one, other = np.nonzero(np.isfinite(apart))
    apart, slack = apart[pair, one, other], GATE_SIGMAS * sigma[pair, one, other] + 3 * places.sigma_m.max()
    first, last = places.pairs_between(one * groups + other, apart - slack, apart + slack)
    each = last - first
    query = np.repeat(np.arange(len(pair)), each)
    landmarks = places.pair[np.arange(len(query)) - np.repeat(np.cumsum(each) - each, each) + first[query]]
    measured = np.stack([ranges[edges[pair, 0], one], ranges[edges[pair, 1], other]], axis=-1)
    bearings = view.bearing[edges[pair]]
    return from_two_bearings(
        places.points[landmarks[:, 0]], places.points[landmarks[:, 1]], bearings[query], measured[query]
    )


def _foot_ranges(view: View, places: Places) -> tuple[Array, Array]:
    """Return range and its sigma (E, B), m, of every edge if its foot is at each of the heights; nan where unknown.

    The foot at the upright height e falls (s - e c) / (c + e s) per metre ahead of the camera, which has a known
    height.
    """
    tilt, height_m = view.camera.mount.tilt_rad, view.camera.mount.height_m
    s, c = np.sin(tilt), np.cos(tilt)
    drop = height_m - places.class_m
    fall = ((s - view.foot * c) / (c + view.foot * s))[:, None]
    per_e = (1.0 / (c + view.foot * s) ** 2)[:, None]
    with np.errstate(divide="ignore", invalid="ignore"):
        ahead = drop / fall
        relative = np.abs(per_e / fall) * view.foot_sigma
        # Heights within a group are even over one step.
        relative = np.hypot(relative, BOTTOM_STEP_M / np.sqrt(12) / np.abs(drop))
        range_m = ahead / np.cos(view.bearing)[:, None]
        told = (ahead > 0) & (relative < WORST_RANGE)
        told &= (range_m >= places.sight.range_min_m) & (range_m <= places.sight.range_max_m)
        sigma_m = range_m * relative
    return np.where(told, range_m, np.nan), np.where(told, sigma_m, np.nan)


def from_bearings(view: View, places: Places, count: int, rng: np.random.Generator) -> Array:
    """Return robot poses (K ≤ count, 3) at which three edges are three landmarks.

    None where the map is so large that three right edges would hardly ever be drawn with their three landmarks.
    """
    if len(places) ** 3 > MOST_TRIPLES * count:
        return np.zeros((0, 3))
    if len(view) < 3 or len(places) < 3:
        return np.zeros((0, 3))
    edges = _distinct(len(view), 3, count, rng)
    landmarks = _neighbours(places, len(edges), rng)
    cameras = from_three_bearings(places.points[landmarks], view.bearing[edges])
    return view.robot_poses(cameras[np.isfinite(cameras).all(axis=1)])


def _wide_pairs(view: View, usable: Indices) -> tuple[Indices, Indices]:
    """Return the pairs i, j (P,) of usable edges, i to the left of j, that are far enough apart."""
    one, other = np.triu_indices(len(usable), k=1)
    i, j = usable[one], usable[other]
    wide = view.bearing[j] - view.bearing[i] >= NARROWEST_RAD
    return i[wide], j[wide]


def _distinct(size: int, members: int, count: int, rng: np.random.Generator) -> Indices:
    """Return `count` combinations (count, members) of distinct indices below `size`, in random order."""
    keys = rng.random((count, min(size, 64)))
    subset = rng.permutation(size)[:64]
    return np.asarray(subset[np.argpartition(keys, members - 1, axis=1)[:, :members]])


def _neighbours(places: Places, count: int, rng: np.random.Generator) -> Indices:
    """Return `count` triples (count, 3) of distinct landmarks, of which the last two are paired with the first."""
    order = np.argsort(places.pair[:, 0], kind="stable")
    first = np.searchsorted(places.pair[order, 0], np.arange(len(places) + 1))
    degree = np.diff(first)
    able = np.flatnonzero(degree >= 2)
    if len(able) == 0:
        return np.zeros((0, 3), dtype=np.int64)
    centre = able[rng.integers(0, len(able), count)]
    one = (rng.random(count) * degree[centre]).astype(np.int64)
    other = (one + 1 + (rng.random(count) * (degree[centre] - 1)).astype(np.int64)) % degree[centre]
    beside = places.pair[order, 1]
    return np.stack([centre, beside[first[centre] + one], beside[first[centre] + other]], axis=-1)
