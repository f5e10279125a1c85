"""Follow edges from image to image: how likely each edge is each landmark, a filter for each track, and parameters.

The score of a pair is a log-likelihood ratio, by bearing and looks: the edge is of the landmark, or the landmark is
missed and the edge is of something unknown, anywhere in view. Looks are polarity and the grey values left and right of
the edge. At an outer corner one side shows what lies behind, so each side is similar with some probability, and can
have any value otherwise.

A track is a Kalman filter of the inverse-depth model: a direction from where the edge was first seen, and an inverse
distance along it, which is nearly linear in what a camera measures, for near and far edges and for edges of unknown
distance [Civera, Davison, Montiel 2008].
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from localiser.geometry import Array, wrap_angle
from localiser.geometry.compiled import compiled
from localiser.mapping.sightings import Index, Sightings

# -- data association -------------------------------------------------------------------------------------------------

Signs = NDArray[np.int8] | np.int8

NARROWEST_SPAN_RAD = np.deg2rad(20.0)
SAME_SIDE = 0.7  # share of sides that show the same surface again
GREY_SIGMA = 12.0  # how much that differs: light that falls otherwise, blur, noise
GREY_SPAN = 128.0  # over which the grey values of other edges spread


@dataclass(frozen=True, slots=True)
class TrackParameters:
    """How edges are followed."""

    nearest_m: Annotated[float, Field(gt=0, description="distance that few edges fall below (m)")] = 1.0
    found: Annotated[float, Field(gt=0, lt=1, description="chance that an edge is found again in the next image")] = 0.8
    new_share: Annotated[float, Field(gt=0, le=1, description="share of edges that the image before did not show")] = (
        0.3
    )
    missed_most: Annotated[int, Field(ge=0, description="images that a track may miss in a row")] = 4
    gate_sigma: Annotated[float, Field(gt=0, description="how far an edge may be from its prediction (sigmas)")] = 4.0


def association_scores(
    predicted: Array, own_variance: Array, heading: Array, sigma: Array, looks: Array, parameters: TrackParameters
) -> Array:
    """Return the log-likelihood ratios (A, B) of landmarks (A) showing in the edges (B) of one image.

    predicted, own_variance: (A,) rad, rad², headings under which landmarks are expected. heading, sigma: (B,) rad,
    of the edges. looks: (A, B), see `looks_alike`. -inf where
    an edge lies outside a landmark's gate.
    """
    innovation = wrap_angle(heading[None] - predicted[:, None])
    variance = own_variance[:, None] + sigma[None] ** 2
    fit = -0.5 * innovation**2 / variance - 0.5 * np.log(2 * np.pi * variance)
    span = max(float(np.ptp(heading)), NARROWEST_SPAN_RAD)
    odds = parameters.found / (1 - parameters.found)
    score = fit + looks + np.log(odds * span / max(parameters.new_share * len(heading), 1.0))
    return np.where(innovation**2 > parameters.gate_sigma**2 * variance, -np.inf, score)


def looks_alike(side: Array, polarity: Signs, other_side: Array, other_polarity: Signs) -> Array:
    """Return the log-likelihood ratio (...) of pairs of edges being one edge, by looks alone; arguments broadcast.

    side, other_side: (..., 2) grey values left and right, nan unknown. polarity, other_polarity: (...), 0 unknown.
    -inf where polarities contradict each other.
    """
    same = SAME_SIDE * np.exp(-0.5 * ((side - other_side) / GREY_SIGMA) ** 2) / (GREY_SIGMA * np.sqrt(2 * np.pi))
    ratio = np.log(same * GREY_SPAN + 1 - SAME_SIDE)
    looks = np.where(np.isnan(ratio), 0.0, ratio).sum(axis=-1)
    product = polarity * other_polarity
    return np.asarray(np.where(product < 0, -np.inf, looks + np.log(2.0) * (product > 0)))


def assign(score: Array, margin: float = 0.0) -> tuple[Index, Index]:
    """Return rows and columns (M,) of the matches with positive scores (A, B) whose sum is largest.

    -inf forbids a pair. margin: a match is left out unless every other match of its row or its column scores less by
    so much. A global nearest neighbour, solved as a linear assignment [Bar-Shalom, Li 1995].
    """
    from scipy.optimize import linear_sum_assignment

    gain = np.maximum(score, 0.0)
    row, column = linear_sum_assignment(gain, maximize=True)
    real = gain[row, column] > 0
    row, column = row[real], column[real]
    if not margin or not len(row):
        return row, column
    others = score.copy()
    others[row, column] = -np.inf
    rival = np.maximum(others.max(axis=1)[row], others.max(axis=0)[column])
    clear = score[row, column] > rival + margin
    return row[clear], column[clear]


# -- parameters of map building ---------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class MappingParameters:
    """How landmarks are built from edges."""

    parallax_min_deg: Annotated[
        float, Field(gt=0, lt=180, description="a landmark must be seen from directions this far apart (degrees)")
    ] = 6.0
    sightings_min: Annotated[int, Field(ge=2, description="images that must show a landmark")] = 5
    existence_min: Annotated[
        float, Field(ge=0, le=1, description="probability of being there that a landmark needs to be on the map")
    ] = 0.9
    range_max_m: Annotated[float, Field(gt=0, description="landmarks are not built farther away than this (m)")] = 15.0
    systematic_px: Annotated[
        float, Field(ge=0, description="error of where an edge is measured that more images do not average out (px)")
    ] = 0.1
    plumb_sigma_m: Annotated[
        float, Field(ge=0, description="how far apart two sightings of one edge may stand, beside noise (m)")
    ] = 0.003
    place_sigma_m: Annotated[
        float, Field(ge=0, description="error of a landmark's place that more images do not average out (m)")
    ] = 0.006
    tracks: TrackParameters = field(default_factory=TrackParameters)


# -- tracks -----------------------------------------------------------------------------------------------------------


def follow(
    sightings: Sightings, cameras: Array, pose_sigma_rad: Array, parameters: TrackParameters, margin: float = 0.0
) -> Index:
    """Return the track (S,) of each sighting, numbered from 0 in the order of their first sightings.

    cameras: (T, 3) floor poses of the camera; only their relation over a few frames matters. pose_sigma_rad: (T,)
    error of the turn since the frame before, as far as it is known.
    margin: see `assign`; an edge that is no clear match of one track begins another.
    """
    track, edges = np.full(len(sightings), -1, dtype=np.int64), np.diff(sightings.first)
    # Each track that is alive was seen in one of the latest images.
    most = int(np.convolve(edges, np.ones(parameters.missed_most + 2, dtype=np.int64)).max(initial=0))
    state, expected = np.empty((most, 7)), np.empty((most, 4))
    last, missed, number = np.empty((3, most), dtype=np.int64)
    side = np.ascontiguousarray(sightings.side)
    score_of: Any = compiled(score_loop)
    advance: Any = compiled(advance_loop)
    found, new_share, gate = parameters.found, parameters.new_share, parameters.gate_sigma
    alive, tracks = 0, 0
    for frame, camera in enumerate(np.ascontiguousarray(cameras)):
        begin, end = sightings.first[frame : frame + 2].tolist()
        heading = camera[2] - sightings.bearing[begin:end]
        sigma = np.sqrt(sightings.sigma[begin:end] ** 2 + pose_sigma_rad[frame] ** 2)
        match = np.full(end - begin, -1, dtype=np.int64)
        if alive and end > begin:
            seen = heading, sigma, begin, camera, side, sightings.polarity
            edge, own = assign(score_of(state, last, alive, *seen, found, new_share, gate, expected), margin)
            match[edge] = own
        kept = state, expected, last, missed, number, alive, tracks
        new = heading, sigma, match, begin, camera, 1 / (3 * parameters.nearest_m), parameters.missed_most
        alive, tracks = advance(*kept, *new, track)
    return track


# -- loops for numba to compile, when they are called: arrays of an image are small, and calls of numpy take long ------

# Columns of a track's state: where the camera first saw it, heading, inverse distance, covariance of these two.
X, Z, HEADING, INVERSE, HH, HI, II = range(7)
# Columns of what is predicted of a track: its heading, the derivatives by both, the variance by the state.
AT, BY_HEADING, BY_INVERSE, VARIANCE = range(4)


def score_loop(
    state: Array,
    last: Index,
    count: int,
    heading: Array,
    sigma: Array,
    begin: int,
    camera: Array,
    side: Array,
    polarity: NDArray[np.int8],
    found: float,
    new_share: float,
    gate: float,
    expected: Array,
) -> Array:
    """Return the scores (E, count) of all pairs of edges and tracks, as `association_scores` and `looks_alike` do.

    Written are the headings under which the camera (3,) should see tracks, their derivatives by the states, and their
    variances: `expected` (·, 4). last: (·,) the sighting that each track was seen in last.
    """
    score, odds = np.empty((len(heading), count)), np.log(found / (1 - found))
    odds += np.log(max(heading.max() - heading.min(), NARROWEST_SPAN_RAD) / max(new_share * len(heading), 1.0))
    for k in range(count):
        sin, cos = np.sin(state[k, HEADING]), np.cos(state[k, HEADING])
        baseline_x, baseline_z = state[k, X] - camera[0], state[k, Z] - camera[1]
        x, z = state[k, INVERSE] * baseline_x - sin, state[k, INVERSE] * baseline_z - cos
        squared = max(x * x + z * z, 1e-12)
        a, b = (-z * cos - x * sin) / squared, (z * baseline_x - x * baseline_z) / squared
        expected[k, AT], expected[k, BY_HEADING], expected[k, BY_INVERSE] = np.arctan2(-x, -z), a, b
        expected[k, VARIANCE] = a * a * state[k, HH] + 2 * a * b * state[k, HI] + b * b * state[k, II]
        for e in range(len(heading)):
            innovation = (heading[e] - expected[k, AT] + np.pi) % (2 * np.pi) - np.pi
            variance = expected[k, VARIANCE] + sigma[e] * sigma[e]
            product = polarity[last[k]] * polarity[begin + e]
            score[e, k] = -np.inf
            if product < 0 or innovation * innovation > gate * gate * variance:
                continue
            looks = np.log(2.0) if product > 0 else 0.0
            for half in range(2):
                apart = (side[last[k], half] - side[begin + e, half]) / GREY_SIGMA
                same = SAME_SIDE * np.exp(-0.5 * apart * apart) / (GREY_SIGMA * np.sqrt(2 * np.pi))
                if not np.isnan(apart):
                    looks += np.log(same * GREY_SPAN + 1 - SAME_SIDE)
            fit = -0.5 * innovation * innovation / variance - 0.5 * np.log(2 * np.pi * variance)
            score[e, k] = fit + odds + looks
    return score


def advance_loop(
    state: Array,
    expected: Array,
    last: Index,
    missed: Index,
    number: Index,
    alive: int,
    tracks: int,
    heading: Array,
    sigma: Array,
    match: Index,
    begin: int,
    camera: Array,
    inverse_m: float,
    missed_most: int,
    track: Index,
) -> tuple[int, int]:
    """Update tracks by their edges, drop those that were missed too often, begin one for each other edge.

    match: (E,) the track of each edge, -1 for none. A state is the heading under which the edge was first seen and the
    inverse distance from there, which is between 3 `inverse_m` and 0 within two sigmas at first. Return how many tracks
    are alive, and how many there were.
    """
    for k in range(alive):
        missed[k] += 1
    for e in range(len(heading)):
        k = match[e]
        if k < 0:
            continue
        a, b = expected[k, BY_HEADING], expected[k, BY_INVERSE]
        hh, hi, ii = state[k, HH], state[k, HI], state[k, II]
        by_h, by_i = hh * a + hi * b, hi * a + ii * b
        total = by_h * a + by_i * b + sigma[e] * sigma[e]
        by_h, by_i = by_h / total, by_i / total
        innovation = (heading[e] - expected[k, AT] + np.pi) % (2 * np.pi) - np.pi
        state[k, HEADING] += by_h * innovation
        state[k, INVERSE] = max(state[k, INVERSE] + by_i * innovation, 0.0)
        # Joseph's form: M C Mᵀ + g gᵀ σ², with M = 1 - g jᵀ.
        m00, m01, m10, m11 = 1 - by_h * a, -by_h * b, -by_i * a, 1 - by_i * b
        c00, c01 = m00 * hh + m01 * hi, m00 * hi + m01 * ii
        c10, c11 = m10 * hh + m11 * hi, m10 * hi + m11 * ii
        state[k, HH] = c00 * m00 + c01 * m01 + by_h * by_h * sigma[e] * sigma[e]
        state[k, HI] = c00 * m10 + c01 * m11 + by_h * by_i * sigma[e] * sigma[e]
        state[k, II] = c10 * m10 + c11 * m11 + by_i * by_i * sigma[e] * sigma[e]
        last[k], missed[k], track[begin + e] = begin + e, 0, number[k]
    kept = 0
    for k in range(alive):
        if missed[k] <= missed_most:
            state[kept], last[kept], missed[kept], number[kept] = state[k], last[k], missed[k], number[k]
            kept += 1
    for e in range(len(heading)):
        if match[e] < 0:
            state[kept, X], state[kept, Z] = camera[0], camera[1]
            state[kept, HEADING], state[kept, INVERSE] = heading[e], inverse_m
            state[kept, HH], state[kept, HI], state[kept, II] = sigma[e] ** 2, 0.0, inverse_m**2
            last[kept], missed[kept], number[kept], track[begin + e] = begin + e, 0, tracks, tracks
            kept, tracks = kept + 1, tracks + 1
    return kept, tracks
