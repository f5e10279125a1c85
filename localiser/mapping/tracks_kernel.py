"""The inner loop of `tracks`: prediction, scores, assignment and update for every image, as plain loops.

Scores are those of `association_scores`. Arrays of an image are small, so that calls of numpy would take most of the
time. A track's state is the heading under which its edge was first seen and the inverse distance from there, which is
between 1 / nearest_m and 0 within two sigmas at first.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from localiser.geometry import Array
from localiser.geometry.compiled import compiled, part
from localiser.mapping.sightings import Index
from localiser.mapping.tracks import GREY_SIGMA, GREY_SPAN, NARROWEST_SPAN_RAD, SAME_SIDE

Signs = NDArray[np.int8]

# Columns of a track's state: where the camera first saw it, heading, inverse distance, covariance of these two.
X, Z, HEADING, INVERSE, HH, HI, II = range(7)
# Columns of what is predicted of a track: its heading, the derivatives by both, the variance by the state.
AT, BY_HEADING, BY_INVERSE, VARIANCE = range(4)


@part
def _wrapped(angle: float) -> float:
    return (angle + np.pi) % (2 * np.pi) - np.pi


@part
def _predict(state: Array, camera: Array, count: int, expected: Array) -> None:
    """Write under which heading the camera (3,) should see tracks, and the derivatives of it by their states."""
    for k in range(count):
        sin, cos = np.sin(state[k, HEADING]), np.cos(state[k, HEADING])
        baseline_x, baseline_z = state[k, X] - camera[0], state[k, Z] - camera[1]
        x, z = state[k, INVERSE] * baseline_x - sin, state[k, INVERSE] * baseline_z - cos
        squared = max(x * x + z * z, 1e-12)
        expected[k, AT] = np.arctan2(-x, -z)
        a, b = (-z * cos - x * sin) / squared, (z * baseline_x - x * baseline_z) / squared
        expected[k, BY_HEADING], expected[k, BY_INVERSE] = a, b
        expected[k, VARIANCE] = a * a * state[k, HH] + 2 * a * b * state[k, HI] + b * b * state[k, II]


@part
def _looks(side: Array, polarity: Signs, one: int, other: int) -> float:
    """Return what `tracks.looks_alike` says of two sightings."""
    product = polarity[one] * polarity[other]
    if product < 0:
        return -np.inf
    looks = np.log(2.0) if product > 0 else 0.0
    for half in range(2):
        apart = (side[one, half] - side[other, half]) / GREY_SIGMA
        same = SAME_SIDE * np.exp(-0.5 * apart * apart) / (GREY_SIGMA * np.sqrt(2 * np.pi))
        if not np.isnan(apart):
            looks += np.log(same * GREY_SPAN + 1 - SAME_SIDE)
    return looks


@part
def _score(
    expected: Array,
    last: Index,
    count: int,
    heading: Array,
    sigma: Array,
    begin: int,
    edges: int,
    side: Array,
    polarity: Signs,
    found: float,
    new_share: float,
    gate: float,
    score: Array,
) -> None:
    """Write the scores (edges, tracks) of all pairs; see `tracks.association_scores`."""
    low, high = np.inf, -np.inf
    for e in range(edges):
        low, high = min(low, heading[e]), max(high, heading[e])
    odds = np.log(found / (1 - found) * max(high - low, NARROWEST_SPAN_RAD) / max(new_share * edges, 1.0))
    for k in range(count):
        for e in range(edges):
            innovation = _wrapped(heading[e] - expected[k, AT])
            variance = expected[k, VARIANCE] + sigma[e] * sigma[e]
            score[e, k] = -np.inf
            if innovation * innovation <= gate * gate * variance:
                fit = -0.5 * innovation * innovation / variance - 0.5 * np.log(2 * np.pi * variance)
                score[e, k] = fit + odds + _looks(side, polarity, last[k], begin + e)


@part
def _step(
    score: Array, count: int, columns: int, price: Array, own: int, here: int, least: Array, way: Index, done: Index
) -> tuple[int, float]:
    """Return the next column of the shortest path, and how much longer it is; `own` is the edge of column `here`."""
    following, step = 0, np.inf
    for j in range(1, columns):
        if done[j] == 0:
            gain = max(score[own, j - 1], 0.0) if j <= count else 0.0
            left = -gain - price[0, own] - price[1, j]
            if left < least[j]:
                least[j], way[j] = left, here
            if least[j] < step:
                following, step = j, least[j]
    return following, step


@part
def _augment(
    score: Array, count: int, columns: int, price: Array, least: Array, owner: Index, way: Index, done: Index
) -> None:
    """Give a column to the edge of column 0, along the shortest path through the columns of others."""
    for j in range(columns):
        least[j], done[j] = np.inf, 0
    here = 0
    while owner[here] >= 0:
        done[here] = 1
        following, step = _step(score, count, columns, price, owner[here], here, least, way, done)
        for j in range(columns):
            if done[j] == 1:
                price[0, owner[j]] += step
                price[1, j] -= step
            else:
                least[j] -= step
        here = following
    while here != 0:
        owner[here] = owner[way[here]]
        here = way[here]


@part
def _assign(
    score: Array,
    edges: int,
    count: int,
    price: Array,
    least: Array,
    owner: Index,
    way: Index,
    done: Index,
    match: Index,
) -> None:
    """Write the track of each edge, -1 for none, so that the sum of the scores is largest; see `association.assign`.

    Shortest augmenting paths [Jonker, Volgenant 1987]: each edge begins one. Column 0 is where a path begins, columns
    beyond the tracks mean no track. price (2, ·): of edges and columns. least, owner, way, done: of columns.
    """
    columns = count + edges + 1
    for j in range(columns):
        price[1, j], owner[j] = 0.0, -1
    for e in range(edges):
        price[0, e], owner[0], match[e] = 0.0, e, -1
        _augment(score, count, columns, price, least, owner, way, done)
    for j in range(1, count + 1):
        if owner[j] >= 0 and score[owner[j], j - 1] > 0:
            match[owner[j]] = j - 1


@part
def _keep_clear(score: Array, edges: int, count: int, margin: float, match: Index, clear: Index) -> None:
    """Take back the matches that are not better by `margin` than all pairs of edge or track that are no match."""
    for e in range(edges):
        clear[e] = match[e]
        for k in range(count if match[e] >= 0 else 0):
            if k != match[e] and score[e, match[e]] <= score[e, k] + margin:
                clear[e] = -1
        for other in range(edges if match[e] >= 0 else 0):
            if other != e and score[e, match[e]] <= score[other, match[e]] + margin:
                clear[e] = -1
    for e in range(edges):
        match[e] = clear[e]


@part
def _update(state: Array, expected: Array, k: int, heading: float, sigma: float) -> None:
    """Update one track by one bearing; see `update_states`."""
    a, b = expected[k, BY_HEADING], expected[k, BY_INVERSE]
    hh, hi, ii = state[k, HH], state[k, HI], state[k, II]
    by_h, by_i = hh * a + hi * b, hi * a + ii * b
    total = by_h * a + by_i * b + sigma * sigma
    by_h, by_i = by_h / total, by_i / total
    innovation = _wrapped(heading - expected[k, AT])
    state[k, HEADING] += by_h * innovation
    state[k, INVERSE] = max(state[k, INVERSE] + by_i * innovation, 0.0)
    # Joseph's form: M C Mᵀ + g gᵀ σ², with M = 1 - g jᵀ.
    m00, m01, m10, m11 = 1 - by_h * a, -by_h * b, -by_i * a, 1 - by_i * b
    c00, c01 = m00 * hh + m01 * hi, m00 * hi + m01 * ii
    c10, c11 = m10 * hh + m11 * hi, m10 * hi + m11 * ii
    state[k, HH] = c00 * m00 + c01 * m01 + by_h * by_h * sigma * sigma
    state[k, HI] = c00 * m10 + c01 * m11 + by_h * by_i * sigma * sigma
    state[k, II] = c10 * m10 + c11 * m11 + by_i * by_i * sigma * sigma


@compiled
def follow_loop(
    first: Index,
    bearing: Array,
    stated: Array,
    polarity: Signs,
    side: Array,
    cameras: Array,
    pose_sigma_rad: Array,
    found: float,
    new_share: float,
    gate: float,
    nearest_m: float,
    missed_most: int,
    margin: float,
    alive_most: int,
    edges_most: int,
    track: Index,
) -> None:
    """Write the track (S,) of each sighting; see `tracks.follow`.

    first (T + 1,), bearing, stated (S,) sigma, polarity, side (S, 2): see `Sightings`. alive_most, edges_most: of
    tracks and edges at one time.
    """
    state, expected = np.empty((alive_most, 7)), np.empty((alive_most, 4))
    score, price = np.empty((edges_most, alive_most)), np.empty((2, alive_most + edges_most + 1))
    least, heading, sigma = np.empty(alive_most + edges_most + 1), np.empty(edges_most), np.empty(edges_most)
    whole = np.empty((3, alive_most + edges_most + 1), dtype=np.int64)
    last, missed, number = np.empty((3, alive_most), dtype=np.int64)
    match, clear = np.empty((2, edges_most), dtype=np.int64)
    alive, tracks = 0, 0
    for frame in range(len(cameras)):
        camera, begin = cameras[frame], first[frame]
        edges = first[frame + 1] - begin
        for e in range(edges):
            heading[e] = camera[2] - bearing[begin + e]
            sigma[e] = np.sqrt(stated[begin + e] ** 2 + pose_sigma_rad[frame] ** 2)
            match[e] = -1
        if alive > 0 and edges > 0:
            _predict(state, camera, alive, expected)
            _score(expected, last, alive, heading, sigma, begin, edges, side, polarity, found, new_share, gate, score)
            _assign(score, edges, alive, price, least, whole[0], whole[1], whole[2], match)
            if margin > 0:
                _keep_clear(score, edges, alive, margin, match, clear)
        for k in range(alive):
            missed[k] += 1
        for e in range(edges):
            k = match[e]
            if k >= 0:
                _update(state, expected, k, heading[e], sigma[e])
                last[k], missed[k], track[begin + e] = begin + e, 0, number[k]
        kept = 0
        for k in range(alive):
            if missed[k] <= missed_most:
                for column in range(7):
                    state[kept, column] = state[k, column]
                last[kept], missed[kept], number[kept] = last[k], missed[k], number[k]
                kept += 1
        alive = kept
        for e in range(edges):
            if match[e] < 0:
                state[alive, X], state[alive, Z] = camera[0], camera[1]
                state[alive, HEADING], state[alive, INVERSE] = heading[e], 1 / (3 * nearest_m)
                state[alive, HH], state[alive, HI] = sigma[e] ** 2, 0.0
                state[alive, II] = state[alive, INVERSE] ** 2
                last[alive], missed[alive], number[alive] = begin + e, 0, tracks
                track[begin + e] = tracks
                alive, tracks = alive + 1, tracks + 1
