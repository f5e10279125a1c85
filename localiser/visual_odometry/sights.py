"""The edges of one image for visual odometry: bearings, inverse ranges, and the errors that all of them share."""

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
