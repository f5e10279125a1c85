"""Pose hypotheses: poses at which chosen edges would be chosen landmarks, by two feet or by three bearings.

Each function draws as many hypotheses as requested, at random among all combinations that do not contradict the
measurements. A random part of a large set keeps one image cheap; the next image draws another part.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from localiser.geometry import Array
from localiser.relocalisation.places import BOTTOM_STEP_M, Indices, Places
from localiser.relocalisation.resection import from_three_bearings, from_two_bearings
from localiser.relocalisation.views import View

GATE_SIGMAS = 1.0  # narrow: more pairs of edges can be tried, which finds more than it loses
MOST_TRIPLES = 10  # times as many of landmarks as are tried: beyond that a right one is hardly ever among them
AT_ONCE = 8  # pairs of edges looked up together
NARROWEST_RAD = np.radians(3.0)  # between two bearings: below it they fix hardly more than one does
FEWEST_TRIED = 4  # pairs of edges, on such a map
# Part of the pairs, and of the triples, of edges that are all landmarks and pass the gates at the true pose.
BOTH_RIGHT, ALL_RIGHT = 0.3, 0.16
WORST_RANGE = 0.25  # relative error of a range that still tells something


def from_feet(view: View, places: Places, count: int, rng: np.random.Generator) -> tuple[Array, float]:
    """Return robot poses (K ≤ count, 3) at which two edges, with the ranges of their feet, are two landmarks.

    Two edges with ranges make two points, and only pairs of landmarks as far apart as these can be them. The bearings
    are then held exactly; of the ranges only the ratio counts. The second value is how many of the poses are expected
    to be the true one: `BOTH_RIGHT` of the pairs of edges, times the part of their pairs of landmarks that is tried.
    """
    i, j = _wide_pairs(view, np.flatnonzero(~view.cut & np.isfinite(view.foot)))
    if len(i) == 0 or count == 0:
        return np.zeros((0, 3)), 0.0
    ranges, sigmas = _foot_ranges(view, places)
    pairs, merit = np.stack([i, j], axis=-1), _merit(view, sigmas, i, j)
    if places.are_many:
        cameras, part = _from_rare_pairs(view, places, pairs, merit, ranges, sigmas, count, rng)
        return view.robot_poses(cameras), BOTH_RIGHT * len(pairs) * part
    order = np.argsort(rng.exponential(size=len(i)) / merit)
    found, total, tried = [], 0, 0.0
    for chunk in np.array_split(order, -(-len(order) // AT_ONCE)):
        queries = _queries(view, places, pairs[chunk], ranges, sigmas)
        able = queries.last - queries.first
        query, entry = _entries(queries.first, _at_most(able, count - total))
        found.append(queries.poses(view, places, query, entry))
        total, tried = total + len(entry), tried + len(chunk) * len(entry) / max(int(able.sum()), 1)
        if total >= count:
            break
    return view.robot_poses(np.concatenate(found)[:count]), BOTH_RIGHT * tried


def _from_rare_pairs(
    view: View,
    places: Places,
    pairs: Indices,
    merit: Array,
    ranges: Array,
    sigmas: Array,
    count: int,
    rng: np.random.Generator,
) -> tuple[Array, float]:
    """Return `count` camera poses (K ≤ count, 3) from pairs of edges (P, 2) that few pairs of landmarks can be.

    On a large map most pairs of edges can be more landmarks than an image can try. Those that can be few tell more for
    the same work. Of what can be still more, a random part is tried. The second value is the part tried of all.
    """
    queries = _queries(view, places, pairs, ranges, sigmas)
    each = queries.last - queries.first
    able = np.bincount(queries.pair, each, minlength=len(pairs))
    order = np.argsort(rng.exponential(size=len(pairs)) * able / merit)
    order = order[able[order] > 0]
    chosen = order[: np.searchsorted(np.cumsum(np.minimum(able[order], count / FEWEST_TRIED)), count) + 1]
    keep = np.flatnonzero(np.isin(queries.pair, chosen))
    part = np.minimum(1.0, count / FEWEST_TRIED / able[queries.pair[keep]])
    tried = np.floor(each[keep] * part + rng.random(len(keep))).astype(np.int64)
    query, entry = _entries(queries.first[keep], tried)
    spread = ((entry - queries.first[keep][query] + rng.random(len(entry))) / part[query]).astype(np.int64)
    entry = queries.first[keep][query] + np.minimum(spread, each[keep][query] - 1)
    some = rng.permutation(len(entry))[:count]
    part_tried = len(some) / max(int(each.sum()), 1)
    return queries.poses(view, places, keep[query[some]], entry[some]), part_tried


def _merit(view: View, sigmas: Array, i: Indices, j: Indices) -> Array:
    """Return how soon each pair of edges (P,) is to be tried: long edges, which are rarely clutter, with sure ranges.

    An exponential draw over this, sorted, is a draw without putting back with chances in proportion to it.
    """
    told = np.isfinite(sigmas)
    sigma = np.where(told, sigmas, 0.0).sum(axis=1) / np.maximum(told.sum(axis=1), 1)
    sigma = np.where(told.any(axis=1), sigma, sigma.max(initial=1.0))
    return np.asarray(np.sqrt(view.length_px[i] * view.length_px[j]) / (sigma[i] + sigma[j]))


@dataclass(frozen=True, slots=True, eq=False)
class _Queries:
    """Which pairs of landmarks pairs of edges (P, 2) may be, Q queries: one for every pair and heights of its feet.

    edges: (P, 2). pair: (Q,) index into edges. first, last: (Q,) slice of the places' pairs. ranges: (Q, 2) m.
    """

    edges: Indices
    pair: Indices
    first: Indices
    last: Indices
    ranges: Array

    def poses(self, view: View, places: Places, query: Indices, entry: Indices) -> Array:
        """Return the camera poses (K, 3) at which the edges of query (K,) are the pair of landmarks at entry (K,)."""
        landmarks = places.pair[entry]
        return from_two_bearings(
            places.points[landmarks[:, 0]],
            places.points[landmarks[:, 1]],
            view.bearing[self.edges[self.pair[query]]],
            self.ranges[query],
        )


def _queries(view: View, places: Places, edges: Indices, ranges: Array, sigmas: Array) -> _Queries:
    """Return which pairs of landmarks are as far apart as pairs of edges (P, 2) with feet are."""
    groups = len(places.class_m)
    r_i, r_j = ranges[edges[:, 0], :, None], ranges[edges[:, 1], None, :]
    s_i, s_j = sigmas[edges[:, 0], :, None], sigmas[edges[:, 1], None, :]
    cos = np.cos(view.bearing[edges[:, 1]] - view.bearing[edges[:, 0]])[:, None, None]
    apart = np.sqrt(r_i**2 + r_j**2 - 2 * r_i * r_j * cos)
    # The distance of the feet by their ranges, to first order.
    sigma = np.hypot(s_i * (r_i - r_j * cos), s_j * (r_j - r_i * cos)) / np.maximum(apart, 1e-6)
    pair, one, other = np.nonzero(np.isfinite(apart))
    apart, slack = apart[pair, one, other], GATE_SIGMAS * sigma[pair, one, other] + 3 * places.sigma_max_m
    first, last = places.pairs_between(one * groups + other, apart - slack, apart + slack)
    measured = np.stack([ranges[edges[pair, 0], one], ranges[edges[pair, 1], other]], axis=-1)
    return _Queries(edges, pair, first, last, measured)


def _at_most(each: Indices, most: int) -> Indices:
    """Return how many of each (Q,) there are among the first so many of all."""
    return each - np.clip(np.cumsum(each) - most, 0, each)


def _entries(first: Indices, each: Indices) -> tuple[Indices, Indices]:
    """Return for slices that begin at first (Q,) and have so many entries (Q,) the slice and entry, (K,) each."""
    query = np.repeat(np.arange(len(first)), each)
    return query, np.arange(len(query)) - np.repeat(np.cumsum(each) - each, each) + first[query]


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


def from_bearings(view: View, places: Places, count: int, rng: np.random.Generator) -> tuple[Array, float]:
    """Return robot poses (K ≤ count, 3) at which three edges are three landmarks, and how many are expected to be true.

    None where the map is so large that three right edges would hardly ever be drawn with their three landmarks.
    """
    if len(places) ** 3 > MOST_TRIPLES * count:
        return np.zeros((0, 3)), 0.0
    if len(view) < 3 or len(places) < 3:
        return np.zeros((0, 3)), 0.0
    edges = _distinct(len(view), 3, count, rng)
    landmarks, triples = _neighbours(places, len(edges), rng)
    cameras = from_three_bearings(places.points[landmarks], view.bearing[edges])
    return view.robot_poses(cameras[np.isfinite(cameras).all(axis=1)]), ALL_RIGHT * len(landmarks) / max(triples, 1)


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


def _neighbours(places: Places, count: int, rng: np.random.Generator) -> tuple[Indices, int]:
    """Return `count` triples (count, 3) of distinct landmarks, of which the last two are paired with the first.

    The second value is how many such triples there are.
    """
    order = np.argsort(places.pair[:, 0], kind="stable")
    first = np.searchsorted(places.pair[order, 0], np.arange(len(places) + 1))
    degree = np.diff(first)
    able = np.flatnonzero(degree >= 2)
    if len(able) == 0:
        return np.zeros((0, 3), dtype=np.int64), 0
    centre = able[rng.integers(0, len(able), count)]
    one = (rng.random(count) * degree[centre]).astype(np.int64)
    other = (one + 1 + (rng.random(count) * (degree[centre] - 1)).astype(np.int64)) % degree[centre]
    beside = places.pair[order, 1]
    drawn = np.stack([centre, beside[first[centre] + one], beside[first[centre] + other]], axis=-1)
    return drawn, int((degree * np.maximum(degree - 1, 0)).sum())
