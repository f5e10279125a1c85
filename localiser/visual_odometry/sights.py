"""The edges of one image for visual odometry, and how alike those of two images are that may be one edge.

An edge of the second image continues one of the n edges of the first with probability w, each equally likely; otherwise
it is new. Polarities must agree. Grey values agree on at least one side, because the background on the other side
changes. Given a motion, the bearing is predicted for two cases of the edge's lower end:

- it is the foot, where the edge meets the floor, and determines the range, or
- it is not (a window, a skirting board, something in front), and the edge is at any shorter range.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from localiser.camera import Camera
from localiser.edges import FOOT_SIGMA_PX, TURN_RATE, Edges
from localiser.geometry import Array

FOLLOWED_SHARE = 0.7  # of the edges of an image, seen in the one before
HUNG_SHARE = 0.5  # of lower ends that are no feet, that hang at a height of their own; something hides the rest
TYPICAL_INVERSE_RANGE, TYPICAL_SPREAD = 0.4, 0.3  # 1/m: rooms are some metres wide, and edges stand all over them
FOOT_UNEVEN_SIGMA_M = 0.04  # of how far above the floor the lower end of each edge is: thresholds, plinths
_FOOT_HEIGHT_SIGMA_M = 0.03  # and those of a building all alike: skirting boards
FLOOR_SHARE = 0.5  # of the lower ends that are feet
_LOOK_SIGMA = 12.0  # grey levels that an unchanged side of an edge differs by
_LOOK_FLOOR = 0.1  # likelihood of an edge whose both sides changed, beside one that did not
_RUNS_OUT_PX = 4.0 * FOOT_SIGMA_PX
"""An edge that is found to end this close to the border may be cut off by it: no foot, though it looks like one in each
frame."""


class Sights(NamedTuple):
    """What one frame says about where its edges (E) stand.

    measured, sigma: (E, 2) bearing (rad) and inverse range (1/m); the latter nan where no foot is seen.
    common: (E, 2, K) derivatives of these by what is wrong with all edges at once, each in units of its prior sigma:
        the mount's errors, and how far above the floor feet end.
    """

    measured: Array
    sigma: Array
    common: Array

    @classmethod
    def of(cls, edges: Edges, camera: Camera) -> Sights:
        """Return what these edges say, seen by this camera. Bearings are from the axis of its usual mount."""
        yaw_rad, camera = camera.mount.yaw_rad, camera.at(edges.mount)
        height_m, last = camera.mount.height_m, np.array([camera.width, camera.height]) - 1
        foot_px = edges.ends_px[:, 0]  # nan where unknown
        runs_out = (np.minimum(foot_px, last - foot_px) < _RUNS_OUT_PX).any(axis=-1)
        inverse = 1.0 / np.where(runs_out, np.nan, edges.foot_range_m)
        names = edges.common.names
        by_mount = np.zeros((len(edges), 2, len(names)))
        by_mount[:, 0] = edges.common.bearing_from_line
        # What turns the line of sight down by dδ adds (1/h + h ρ²) dδ to ρ, since tan δ = h ρ.
        by_depression = 1.0 / height_m + height_m * inverse**2
        of_foot = {
            "tilt": by_depression * np.cos(edges.bearing),
            "roll": by_depression * np.sin(edges.bearing),
            "height": -inverse / height_m,
        }
        for column, name in enumerate(names):
            by_mount[:, 1, column] = of_foot.get(name, 0.0)
        variance, axes = np.linalg.eigh(edges.common.cov)
        by_foot_height = np.zeros((len(edges), 2, 1))
        by_foot_height[:, 1, 0] = inverse * _FOOT_HEIGHT_SIGMA_M / height_m
        common = np.concatenate([by_mount @ (axes * np.sqrt(np.maximum(variance, 0.0))), by_foot_height], axis=-1)
        return cls(
            np.stack([edges.bearing + (yaw_rad - camera.mount.yaw_rad), inverse], axis=-1),
            np.stack([edges.bearing_sigma, inverse**2 * edges.foot_range_sigma_m], axis=-1),
            np.nan_to_num(common),
        )


def with_errors_apart(one: Sights, two: Sights, before: Edges, after: Edges) -> tuple[Sights, Sights]:
    """Return two frames, whose mounts err each in its own way where they were measured or turned for each image.

    By how much feet end too high is the same in both.
    """
    measured = any(edges.mount is not None and edges.mount.sigma is not None for edges in (before, after))
    if not (measured or TURN_RATE in before.common.names or before.common.names != after.common.names):
        return one, two
    no_one, no_two = (np.zeros((len(b.common), 2, a.common.shape[2] - 1)) for a, b in ((one, two), (two, one)))
    first = np.concatenate([one.common[..., :-1], no_two, one.common[..., -1:]], axis=-1)
    return one._replace(common=first), two._replace(common=np.concatenate([no_one, two.common], axis=-1))


def how_alike(before: Array, after: Array) -> Array:
    """Return how alike (E, F) profiles (E, P) and (F, P) are, 0 … 1: the side that changed less; 1 where unknown."""
    if before.shape[1] == 0 or before.shape[1] != after.shape[1]:
        return np.ones((len(before), len(after)))
    square = (before[:, None] - after) ** 2
    half = square.shape[-1] // 2
    nearer = np.minimum(square[..., :half].mean(axis=-1), square[..., -half:].mean(axis=-1))
    return np.asarray(np.maximum(np.nan_to_num(np.exp(-0.5 * nearer / _LOOK_SIGMA**2), nan=1.0), _LOOK_FLOOR))
