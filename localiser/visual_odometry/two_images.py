"""Two images of one camera: where their edges stand, and which of them may be one edge (docs/visual_odometry.md).

Grey values agree on at least one side of an edge, because the background on the other side changes.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from localiser.camera import Camera
from localiser.edges import FOOT_SIGMA_PX, TURN_RATE, Edges
from localiser.geometry import Array
from localiser.landmarks import field_of_view_rad

FOLLOWED_SHARE = 0.7  # of the edges of an image, seen in the one before, where that is not learnt
TYPICAL_INVERSE_RANGE, TYPICAL_SPREAD = 0.4, 0.3  # 1/m: rooms are some metres wide, and edges stand all over them
FOOT_HEIGHT_SIGMA_M = 0.05  # of how far above the floor lower ends are: thresholds, plinths, skirting boards
LOOK_SIGMA = 12.0  # grey levels that an unchanged side of an edge differs by
LOOK_FLOOR = 0.1  # likelihood of an edge whose both sides changed, beside one that did not
# An edge that is found to end this close to the border may be cut off by it: no foot, though it looks like one in each
# image.
RUNS_OUT_PX = 4.0 * FOOT_SIGMA_PX
APART_RAD = np.deg2rad(3.0)  # edges closer together than this are likely of one thing: a door, a poster, a shelf
GROUP_POWER = 0.5  # edges of one thing err together: n of them say as much as n^(1 - power) of their own


class SeenEdges(NamedTuple):
    """What one image says about where its edges (E) stand.

    measured: (E, 2) bearing (rad) and inverse range (1/m); the latter nan where no foot is seen. variance: (E, 2) of
    their own errors. common: (E, 2) variance of those by what is wrong with all edges at once: the mount's errors, and
    how far above the floor feet end.
    """

    measured: Array
    variance: Array
    common: Array

    @classmethod
    def of(cls, edges: Edges, camera: Camera) -> SeenEdges:
        """Return what these edges say, seen by this camera."""
        height_m, last = camera.at(edges.mount).mount.height_m, np.array([camera.width, camera.height]) - 1
        foot_px = edges.ends_px[:, 0]  # nan where unknown
        runs_out = (np.minimum(foot_px, last - foot_px) < RUNS_OUT_PX).any(axis=-1)
        inverse = 1.0 / np.where(runs_out, np.nan, edges.foot_range_m)
        # What turns the line of sight down by dδ adds (1/h + h ρ²) dδ to ρ, since tan δ = h ρ.
        by_depression = 1.0 / height_m + height_m * inverse**2
        of_foot = {
            "tilt": by_depression * np.cos(edges.bearing),
            "roll": by_depression * np.sin(edges.bearing),
            "height": -inverse / height_m,
        }
        by_mount = np.zeros((len(edges), 2, len(edges.common.names)))
        by_mount[:, 0] = edges.common.bearing_from_line
        for column, name in enumerate(edges.common.names):
            by_mount[:, 1, column] = of_foot.get(name, 0.0)
        common = np.einsum("eik,kl,eil->ei", by_mount, edges.common.cov, by_mount)
        common[:, 1] += (inverse * FOOT_HEIGHT_SIGMA_M / height_m) ** 2
        sigma = np.stack([edges.bearing_sigma, inverse**2 * edges.foot_range_sigma_m], axis=-1)
        return cls(np.stack([edges.bearing, inverse], axis=-1), sigma**2, common)


class TwoImages(NamedTuple):
    """Two images, made ready once to ask how likely one motion or another is.

    pairs: (P, 2) of edges of known bearing whose polarities do not contradict each other. look: (P,) how alike they
    are, 0 … 1, over the density of new edges in bearing, and over the odds that an edge is none. weight: (F,) of the
    edges of the second image. mounts: (2, 3) floor poses of the camera on the robot.
    """

    one: SeenEdges
    two: SeenEdges
    pairs: NDArray[np.int64]
    look: Array
    weight: Array
    mounts: Array

    @classmethod
    def of(cls, before: Edges, after: Edges, camera: Camera, followed: float = FOLLOWED_SHARE) -> TwoImages:
        """Return two images of one camera, whose mount may vary. followed: the fraction of edges that continue one."""
        one, two = SeenEdges.of(before, camera), SeenEdges.of(after, camera)
        measured = any(edges.mount is not None and edges.mount.sigma is not None for edges in (before, after))
        if measured or TURN_RATE in before.common.names or before.common.names != after.common.names:
            for image in (one, two):  # what is wrong differs from one image to the other
                image.variance[:, 0] += image.common[:, 0]
        is_pair = np.isfinite(before.bearing[:, None] + after.bearing)
        is_pair &= before.polarity[:, None].astype(int) * after.polarity >= 0
        pairs = np.ascontiguousarray(np.argwhere(is_pair))
        new_density = (1.0 - followed) / followed * max(len(before), 1) / field_of_view_rad(camera)
        look = how_alike(before.profile, after.profile)[is_pair] / new_density
        order = np.argsort(after.bearing)
        group = np.cumsum(~(np.diff(after.bearing[order], prepend=-np.inf) <= APART_RAD))
        weight = np.asarray((np.bincount(group)[group] ** -GROUP_POWER)[np.argsort(order)])
        mounts = np.array([camera.at(edges.mount).robot_from_level for edges in (before, after)])
        return cls(one, two, pairs, look, weight, mounts)


def how_alike(before: Array, after: Array) -> Array:
    """Return how alike (E, F) profiles (E, P) and (F, P) are, 0 … 1: the side that changed less; 1 where unknown."""
    if before.shape[1] == 0 or before.shape[1] != after.shape[1]:
        return np.ones((len(before), len(after)))
    square = (before[:, None] - after) ** 2
    half = square.shape[-1] // 2
    nearer = np.minimum(square[..., :half].mean(axis=-1), square[..., -half:].mean(axis=-1))
    return np.asarray(np.maximum(np.nan_to_num(np.exp(-0.5 * nearer / LOOK_SIGMA**2), nan=1.0), LOOK_FLOOR))
