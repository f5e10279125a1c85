"""The edges of one image for visual odometry, and pairs of edges of two images that may be one edge.

An edge of the second image continues one of the n edges of the first with probability w, each equally likely; otherwise
it is new. Polarities must agree. Grey values agree on at least one side, because the background on the other side
changes. Given a motion, the bearing is predicted for two cases of the edge's lower end:

- it is the foot, where the edge meets the floor, and determines the range, or
- it is not (a window, a skirting board, something in front), and the edge is at any shorter range.

The bearing itself may also be that of a neighbouring edge, a few pixels away, when each image shows only one of the
two. Such a pair is not a new edge, but it gives no information.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from localiser.camera import Camera
from localiser.edges import FOOT_SIGMA_PX, TURN_RATE, Edges
from localiser.geometry import Array

FOOT_HEIGHT_SIGMA_M = 0.03
"""How far above the floor the lower ends of a building's edges may be, all alike: skirting boards."""
FOOT_UNEVEN_SIGMA_M = 0.04
"""And each of its own: thresholds, plinths."""
_RUNS_OUT_PX = 4.0 * FOOT_SIGMA_PX
"""An edge that is found to end this close to the border may be cut off by it: no foot, though it looks like one in each
frame."""


@dataclass(frozen=True, slots=True, eq=False)
class Sights:
    """What one frame says about where its edges (E) stand.

    measured, sigma: (E, 2) bearing (rad) and inverse range (1/m); the latter nan where no foot is seen.
    common: (E, 2, K) derivatives of these by what is wrong with all edges at once, each in units of its prior sigma:
        the mount's errors, and how far above the floor feet end.
    """

    measured: Array
    sigma: Array
    common: Array

    @property
    def bearing(self) -> Array:
        """Bearings (E,), rad."""
        return np.asarray(self.measured[:, 0])

    @property
    def inverse_range(self) -> Array:
        """Inverse ranges (E,), 1/m."""
        return np.asarray(self.measured[:, 1])

    @classmethod
    def of(cls, edges: Edges, camera: Camera) -> Sights:
        """Return what these edges say, seen by this camera. Bearings are from the axis of its usual mount."""
        yaw_rad, camera = camera.mount.yaw_rad, camera.at(edges.mount)
        height_m = camera.mount.height_m
        inverse = 1.0 / np.where(_runs_out(edges.ends_px[:, 0], camera), np.nan, edges.foot_range_m)
        inverse_sigma = inverse**2 * edges.foot_range_sigma_m
        # What turns the line of sight down by dδ adds (1/h + h ρ²) dδ to ρ, since tan δ = h ρ.
        per_depression = 1.0 / height_m + height_m * inverse**2
        mount = edges.common
        by_mount = np.zeros((len(edges), 2, len(mount.names)))
        by_mount[:, 0] = mount.bearing_from_line
        depression = {"tilt": np.cos(edges.bearing), "roll": np.sin(edges.bearing)}
        for column, name in enumerate(mount.names):
            by_mount[:, 1, column] = per_depression * depression.get(name, 0.0)
            if name == "height":
                by_mount[:, 1, column] = -inverse / height_m
        by_foot_height = np.zeros((len(edges), 2, 1))
        by_foot_height[:, 1, 0] = inverse * FOOT_HEIGHT_SIGMA_M / height_m
        bearing = edges.bearing + (yaw_rad - camera.mount.yaw_rad)
        return cls(
            np.stack([bearing, inverse], axis=-1),
            np.stack([edges.bearing_sigma, inverse_sigma], axis=-1),
            np.nan_to_num(np.concatenate([by_mount @ _root(mount.cov), by_foot_height], axis=-1)),
        )


def errs_apart(before: Edges, after: Edges) -> bool:
    """Return whether common errors differ between two images: of a mount measured for each, and of a turn rate."""
    measured = any(edges.mount is not None and edges.mount.sigma is not None for edges in (before, after))
    turns = TURN_RATE in before.common.names
    return measured or turns or before.common.names != after.common.names


def with_errors_apart(one: Sights, two: Sights) -> tuple[Sights, Sights]:
    """Return two frames whose mounts err each in its own way; by how much feet end too high is the same in both."""

    def wider(sights: Sights, left: int, right: int) -> Sights:
        own, feet = sights.common[:, :, :-1], sights.common[:, :, -1:]
        no_left, no_right = (np.zeros((len(own), 2, count)) for count in (left, right))
        return replace(sights, common=np.concatenate([no_left, own, no_right, feet], axis=-1))

    return wider(one, 0, two.common.shape[2] - 1), wider(two, one.common.shape[2] - 1, 0)


def _runs_out(end_px: Array, camera: Camera) -> NDArray[np.bool_]:
    """Whether edges that end at pixels (E, 2), nan where unknown, may as well go on outside the image."""
    last = np.array([camera.width, camera.height]) - 1
    return np.asarray((np.minimum(end_px, last - end_px) < _RUNS_OUT_PX).any(axis=-1))


def _root(cov: Array) -> Array:
    """Return R with R Rᵀ = cov (K, K), which may be singular."""
    variance, axes = np.linalg.eigh(cov)
    return np.asarray(axes * np.sqrt(np.maximum(variance, 0.0)))


# -- pairs ------------------------------------------------------------------------------------------------------------

FOLLOWED_SHARE = 0.7  # of the edges of an image, seen in the one before
FLOOR_SHARE = 0.5  # of the lower ends that are feet
HUNG_SHARE = 0.5  # of the others, that hang at a height of their own; the rest is hidden by something in front
TYPICAL_INVERSE_RANGE, TYPICAL_SPREAD = 0.4, 0.3  # 1/m: rooms are some metres wide, and edges stand all over them
NEIGHBOUR_SHARE = 0.15  # of pairs whose bearings are of two edges beside each other
NEIGHBOUR_SIGMA_RAD = np.deg2rad(0.3)  # how far apart
LOOK_SIGMA = 12.0  # grey levels that an unchanged side of an edge differs by
LOOK_FLOOR = 0.1  # likelihood of an edge whose both sides changed, beside one that did not


@dataclass(frozen=True, slots=True, eq=False)
class Pairs:
    """P pairs that may be one edge: first, second (P,) indices of edges. look: (P,) how alike, 0 … 1."""

    first: NDArray[np.int64]
    second: NDArray[np.int64]
    look: Array


def candidates(before: Edges, after: Edges) -> Pairs:
    """Return all pairs of edges with polarities that do not contradict each other."""
    product = before.polarity[:, None].astype(int) * after.polarity
    first, second = np.nonzero(product >= 0)
    return Pairs(first, second, _look(before.profile, after.profile)[first, second])


def _look(before: Array, after: Array) -> Array:
    """Return how alike (E, F) profiles (E, P) and (F, P) are: the side that changed less decides; 1 where unknown."""
    if before.shape[1] == 0 or before.shape[1] != after.shape[1]:
        return np.ones((len(before), len(after)))
    square = (before[:, None] - after) ** 2
    half = square.shape[-1] // 2
    nearer = np.minimum(square[..., :half].mean(axis=-1), square[..., -half:].mean(axis=-1))
    return np.asarray(np.maximum(np.nan_to_num(np.exp(-0.5 * nearer / LOOK_SIGMA**2), nan=1.0), LOOK_FLOOR))


def _floor_shares() -> tuple[Array, Array]:
    """Return a table of inverse ranges ρ (1/m), and how likely a lower end that would be a foot there is one.

    With p(ρ) what is typical, a foot is there with p(ρ), and an end at any height up to the camera's, which looks
    farther than it is, with ∫ p(r)/r dr from ρ on: near the horizon hardly anything stands on the floor.
    """
    inverse = np.geomspace(1e-3, TYPICAL_INVERSE_RANGE + 6.0 * TYPICAL_SPREAD, 200)
    feet = np.exp(-0.5 * ((inverse - TYPICAL_INVERSE_RANGE) / TYPICAL_SPREAD) ** 2)
    steps = 0.5 * (feet[1:] + feet[:-1]) * np.diff(np.log(inverse))  # dr/r = d log r
    hanging = np.append(np.cumsum(steps[::-1])[::-1], 0.0)
    return inverse, FLOOR_SHARE * feet / (FLOOR_SHARE * feet + (1.0 - FLOOR_SHARE) * hanging)


FLOOR_SHARES = _floor_shares()
