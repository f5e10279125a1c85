"""Two views of one vertical edge: where the second sees it, and the derivatives of that.

An edge stands at bearing b and inverse range ρ (1/m) from the first camera. Inverse, because the foot of an edge is
seen at a depression whose tangent is h ρ, so that its error is one of ρ; and because ρ = 0 is a far edge like any
other, which shows the turn and nothing else.

    d = (sin b, -cos b) - ρ c      c: where the second camera stands, from the first
    b' = atan2(d_x, -d_z) + turn,  ρ' = ρ / |d|

With c = 0 that is [Taylor06] eq. 13, with no turn and c along the axis it is eq. 9-11.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from localiser import geometry
from localiser.camera import Camera
from localiser.edges import Edges
from localiser.edges.measure import FOOT_SIGMA_PX
from localiser.geometry import Array

FOOT_HEIGHT_SIGMA_M = 0.03
"""How far above the floor the lower ends of a building's edges may be: thresholds, skirting boards."""
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
        """Return what these edges say, seen by this camera."""
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
        by_foot_height = np.zeros((len(edges), 2, 1))
        by_foot_height[:, 1, 0] = inverse * FOOT_HEIGHT_SIGMA_M / height_m
        return cls(
            np.stack([edges.bearing, inverse], axis=-1),
            np.stack([edges.bearing_sigma, inverse_sigma], axis=-1),
            np.nan_to_num(np.concatenate([by_mount @ _root(mount.cov), by_foot_height], axis=-1)),
        )

    def take(self, index: NDArray[np.int64]) -> Sights:
        """Return what is said of the edges at `index`."""
        return Sights(self.measured[index], self.sigma[index], self.common[index])


def _runs_out(end_px: Array, camera: Camera) -> NDArray[np.bool_]:
    """Whether edges that end at pixels (E, 2), nan where unknown, may as well go on outside the image."""
    last = np.array([camera.width, camera.height]) - 1
    return np.asarray((np.minimum(end_px, last - end_px) < _RUNS_OUT_PX).any(axis=-1))


def _root(cov: Array) -> Array:
    """Return R with R Rᵀ = cov (K, K), which may be singular."""
    variance, axes = np.linalg.eigh(cov)
    return np.asarray(axes * np.sqrt(np.maximum(variance, 0.0)))


def camera_motion(motion: Array, camera: Camera) -> tuple[Array, Array]:
    """Return how the camera moves (3,) when the robot moves by `motion` (3,), and the derivative (3, 3) of that."""
    mount = camera.robot_from_level
    moved = geometry.between(mount, geometry.compose(motion, mount))
    cos, sin = np.cos(motion[2]), np.sin(motion[2])
    lever = np.array([[-sin, cos], [-cos, -sin]]) @ mount[:2]
    jac = np.eye(3)
    jac[:2, :2] = geometry.robot_from_map([0.0, 0.0, mount[2]], np.eye(2)).T
    jac[:2, 2] = geometry.robot_from_map([0.0, 0.0, mount[2]], lever)
    return moved, jac


@dataclass(frozen=True, slots=True, eq=False)
class Prediction:
    """Where the second camera sees edges (E): bearing, inverse_range (E,), and their derivatives.

    by_edge: (E, 2, 2) of (bearing, inverse range) there by (bearing, inverse range) here. by_motion: (E, 2, 3) by the
    camera's motion.
    """

    bearing: Array
    inverse_range: Array
    by_edge: Array
    by_motion: Array


def predicted(bearing: Array, inverse_range: Array, moved: Array) -> Prediction:
    """Return how a camera that moved by (3,) sees edges (E,) that the camera before saw here."""
    ray = np.stack([np.sin(bearing), -np.cos(bearing)], axis=-1)
    along = np.stack([np.cos(bearing), np.sin(bearing)], axis=-1)
    d = ray - inverse_range[:, None] * moved[:2]
    square = np.maximum((d**2).sum(axis=-1), 1e-12)
    distance = np.sqrt(square)
    # Derivatives of both results by d (E, 2, 2), and of d by the edge (E, 2, 2) and by the camera's position.
    across = np.stack([-d[:, 1], d[:, 0]], axis=-1) / square[:, None]
    shrink = -d * (inverse_range / (square * distance))[:, None]
    by_d = np.stack([across, shrink], axis=1)
    d_by_edge = np.stack([along, np.broadcast_to(-moved[:2], along.shape)], axis=-1)
    by_edge = by_d @ d_by_edge
    by_edge[:, 1, 1] += 1.0 / distance
    by_motion = np.zeros((len(bearing), 2, 3))
    by_motion[:, :, :2] = -by_d * inverse_range[:, None, None]
    by_motion[:, 0, 2] = 1.0
    seen = geometry.wrap_angle(np.arctan2(d[:, 0], -d[:, 1]) + moved[2])
    return Prediction(seen, inverse_range / distance, by_edge, by_motion)
