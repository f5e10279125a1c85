"""Persistent clutter: something that is not on the map is expected where the last image showed it.

A mixture with uniform clutter treats every image of the same thing as new evidence. Something that is not on the map,
and is seen a hundred times near the expected place of a landmark, would then be taken for that landmark with certainty.
But an edge that continues an edge of the last image has a known place, also when it is clutter. Its bearing is then
that of the last image, turned with the robot and shifted by the parallax of an unknown distance r, with 1/r uniform
between 0 and 1/near:

    b' = b + turn - across / r,   across = m_right cos b + m_back sin b.

The bearing of a landmark must be likelier than this density, and not than a uniform one over the width of the image.
How an edge moves while the robot passes still identifies the landmark. Seeing it once more does not.

The cost: a known landmark that is tracked also gives less information. Whether an edge is clutter is decided again in
each image; the result of earlier images is not kept.
"""

from __future__ import annotations

import numpy as np

from localiser.geometry import Array, wrap_angle

NEAR_M = 1.0  # things on no map are farther away
_GATE = 3.0  # sigmas within which an edge may continue another


def errors_of_continuing(
    bearing: Array, sigma: Array, before: Array, before_sigma: Array, motion: Array, turn_var: float
) -> tuple[Array, Array]:
    """Return by how much each bearing (E,) misses that of each earlier edge (B,), moved, and its variance, (E, B).

    The rest as for `clutter_density`.
    """
    right, back, turn = motion
    across = right * np.cos(before) + back * np.sin(before)
    expected = before + turn - across / (2 * NEAR_M)
    variance = before_sigma**2 + turn_var + (across / NEAR_M) ** 2 / 12 + sigma[:, None] ** 2
    return np.asarray(wrap_angle(bearing[:, None] - expected)), variance


def clutter_density(
    bearing: Array, sigma: Array, before: Array, before_sigma: Array, motion: Array, turn_var: float, span: float
) -> Array:
    """Return how much denser clutter is at each edge (E,) than spread over the image, at least 1; all angles in rad.

    bearing, sigma: (E,) of the edges; before, before_sigma: (B,) of those of the last image. motion: (3,) of the camera
    since, in its own frame then. turn_var: variance of its turn (rad²). span: angle that clutter is spread over. Denser
    only where just one edge of the last image may be continued, and by one edge: else nothing is known of where a
    single one would be.
    """
    density = np.ones(len(bearing))
    if not len(bearing) or not len(before):
        return density
    error, variance = errors_of_continuing(bearing, sigma, before, before_sigma, motion, turn_var)
    square = error**2 / variance
    may = square < _GATE**2
    one = may & (may.sum(axis=0) == 1) & (may.sum(axis=1) == 1)[:, None]
    edge, of = np.nonzero(one)
    peak = np.exp(-0.5 * square[edge, of]) / np.sqrt(2 * np.pi * variance[edge, of])
    density[edge] = np.maximum(span * peak, 1.0)
    return density
