"""Follow edges from image to image: how likely each edge is each landmark, a filter for each track, and parameters.

The score of a pair is a log-likelihood ratio. It compares two cases: the edge is of the landmark, or the landmark is
missed and the edge is of something unknown, anywhere in view. The score has two parts, the bearing and the appearance.

Appearance is polarity and the grey values left and right of the edge. The grey value of a surface does not change. But
at an outer corner one side shows what lies behind, and that depends on the viewpoint. So each side is similar with
some probability, and otherwise it can have any value.

A track is a Kalman filter of the inverse-depth model: a direction from where the edge was first seen, and an inverse
distance along it, which is nearly linear in what a camera measures, for near and far edges and for edges of unknown
distance [Civera, Davison, Montiel 2008].
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from localiser.geometry import Array, wrap_angle
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
    from localiser.mapping.tracks_kernel import follow_loop

    track, edges = np.full(len(sightings), -1, dtype=np.int64), np.diff(sightings.first)
    # Each track that is alive was seen in one of the latest images.
    alive = np.convolve(edges, np.ones(parameters.missed_most + 2, dtype=np.int64)).max(initial=0)
    follow_loop(
        sightings.first,
        np.ascontiguousarray(sightings.bearing, dtype=np.float64),
        np.ascontiguousarray(sightings.sigma, dtype=np.float64),
        sightings.polarity,
        np.ascontiguousarray(sightings.side, dtype=np.float64),
        np.ascontiguousarray(cameras, dtype=np.float64),
        np.ascontiguousarray(pose_sigma_rad, dtype=np.float64),
        parameters.found,
        parameters.new_share,
        parameters.gate_sigma,
        parameters.nearest_m,
        parameters.missed_most,
        float(margin),
        int(alive),
        int(edges.max(initial=0)),
        track,
    )
    return track
