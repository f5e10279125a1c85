"""Two images of one camera: where their edges stand, and which of them may be one edge.

An edge of the second image continues one of the n edges of the first with probability w, each equally likely; otherwise
it is new. Polarities must agree. Grey values agree on at least one side, because the background on the other side
changes. The lower end of an edge is its foot, where it meets the floor, and determines the range. Or it is not (a
window, a skirting board, something in front), and the edge is at any shorter range.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from localiser.camera import Camera
from localiser.edges import FOOT_SIGMA_PX, TURN_RATE, Edges
from localiser.geometry import Array
from localiser.landmarks import field_of_view_rad

FOLLOWED_SHARE = 0.7  # of the edges of an image, seen in the one before
TYPICAL_INVERSE_RANGE, TYPICAL_SPREAD = 0.4, 0.3  # 1/m: rooms are some metres wide, and edges stand all over them
FOOT_UNEVEN_SIGMA_M = 0.04  # of how far above the floor the lower end of each edge is: thresholds, plinths
FOOT_HEIGHT_SIGMA_M = 0.03  # and those of a building all alike: skirting boards
LOOK_SIGMA = 12.0  # grey levels that an unchanged side of an edge differs by
LOOK_FLOOR = 0.1  # likelihood of an edge whose both sides changed, beside one that did not
# An edge that is found to end this close to the border may be cut off by it: no foot, though it looks like one in each
# image.
RUNS_OUT_PX = 4.0 * FOOT_SIGMA_PX
APART_RAD = np.deg2rad(3.0)  # edges closer together than this are likely of one thing: a door, a poster, a shelf


class SeenEdges(NamedTuple):
    """What one image says about where its edges (E) stand.

    measured, sigma: (E, 2) bearing (rad) and inverse range (1/m); the latter nan where no foot is seen.
    common: (E, 2, K) derivatives of these by what is wrong with all edges at once, each in units of its prior sigma:
        the mount's errors, and how far above the floor feet end.
    """

    measured: Array
    sigma: Array
    common: Array

    @classmethod
    def of(cls, edges: Edges, camera: Camera) -> SeenEdges:
        """Return what these edges say, seen by this camera. Bearings are from the axis of its usual mount."""
        yaw_rad, camera = camera.mount.yaw_rad, camera.at(edges.mount)
        height_m, last = camera.mount.height_m, np.array([camera.width, camera.height]) - 1
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
        variance, axes = np.linalg.eigh(edges.common.cov)
        by_foot_height = np.zeros((len(edges), 2, 1))
        by_foot_height[:, 1, 0] = inverse * FOOT_HEIGHT_SIGMA_M / height_m
        common = np.concatenate([by_mount @ (axes * np.sqrt(np.maximum(variance, 0.0))), by_foot_height], axis=-1)
        return cls(
            np.stack([edges.bearing + (yaw_rad - camera.mount.yaw_rad), inverse], axis=-1),
            np.stack([edges.bearing_sigma, inverse**2 * edges.foot_range_sigma_m], axis=-1),
            np.nan_to_num(common),
        )


class TwoImages(NamedTuple):
    """Two images, made ready once to be followed with one prior or another.

    pairs: (P, 2) of edges whose polarities do not contradict each other. look: (P,) how alike they are, 0 … 1.
    mount: (5,) of the camera, see `twist_kernel.camera_moved`. uneven: sigma of the height of feet, each its own, over
    the camera's height. new_density: of the second bearing of an edge that is new, over the odds that it is not.
    """

    one: SeenEdges
    two: SeenEdges
    pairs: NDArray[np.int64]
    look: Array
    mount: Array
    uneven: float
    new_density: float

    @classmethod
    def of(cls, before: Edges, after: Edges, camera: Camera) -> TwoImages:
        """Return the images with these edges, seen by one camera, whose mount may differ from one to the other."""
        one, two = SeenEdges.of(before, camera), SeenEdges.of(after, camera)
        measured = any(edges.mount is not None and edges.mount.sigma is not None for edges in (before, after))
        names = before.common.names
        if len(before) and len(after) and (measured or TURN_RATE in names or names != after.common.names):
            # Mounts err each in its own way; by how much feet end too high is the same in both.
            mine, other = one.common, two.common
            no_two, no_one = (np.zeros((len(a), 2, b.shape[2] - 1)) for a, b in ((mine, other), (other, mine)))
            one = one._replace(common=np.concatenate([mine[..., :-1], no_two, mine[..., -1:]], axis=-1))
            two = two._replace(common=np.concatenate([no_one, other], axis=-1))
        first, second = (camera.at(edges.mount).robot_from_level[:2] for edges in (before, after))
        pairs = np.ascontiguousarray(np.argwhere(before.polarity[:, None].astype(int) * after.polarity >= 0))
        look = how_alike(before.profile, after.profile)[pairs[:, 0], pairs[:, 1]]
        mount = np.array([*first, camera.mount.yaw_rad, *(second - first)])
        new_share = (1.0 - FOLLOWED_SHARE) / (FOLLOWED_SHARE / max(len(before), 1))
        uneven, new_density = FOOT_UNEVEN_SIGMA_M / camera.mount.height_m, new_share / field_of_view_rad(camera)
        return cls(one, two, pairs, look, mount, uneven, new_density)

    def groups(self, chosen: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return the group (M,) of each of the pairs: edges less than 3° from the next are the sides of one thing."""
        bearing = self.one.measured[self.pairs[chosen, 0], 0]
        order = np.argsort(bearing)
        group = np.empty(len(bearing), dtype=np.int64)
        group[order] = np.cumsum(np.diff(bearing[order], prepend=-np.inf) > APART_RAD) - 1
        return group


def how_alike(before: Array, after: Array) -> Array:
    """Return how alike (E, F) profiles (E, P) and (F, P) are, 0 … 1: the side that changed less; 1 where unknown."""
    if before.shape[1] == 0 or before.shape[1] != after.shape[1]:
        return np.ones((len(before), len(after)))
    square = (before[:, None] - after) ** 2
    half = square.shape[-1] // 2
    nearer = np.minimum(square[..., :half].mean(axis=-1), square[..., -half:].mean(axis=-1))
    return np.asarray(np.maximum(np.nan_to_num(np.exp(-0.5 * nearer / LOOK_SIGMA**2), nan=1.0), LOOK_FLOOR))
