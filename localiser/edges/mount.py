"""Tilt and roll of the camera from the vertical edges of one image."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from localiser import geometry
from localiser.camera import Camera
from localiser.edges.loops import compiled, mount_loop
from localiser.edges.segments import Segments
from localiser.edges.types import Edges
from localiser.edges.undistort import ideal_camera
from localiser.geometry import Array

_TUKEY = 4.0
"""Segments further from the common direction than this many sigmas have no say."""
_TUKEY_VARIANCE = 0.77
"""Share of the variance of Gaussian errors that remains when they are weighed so."""
_STRAIGHT_PX = 0.35
"""Error of an edge's ends across it that is none of measuring: real edges and lenses are no straighter. It turns a
short edge far and a long one hardly, so that many short edges do not outvote few long ones."""


_PRIOR_EDGES = 2.0
"""As how many edges it counts that edges are as crooked as is stated, when an image's own say how crooked they are."""
_SCATTER_ROUNDS = 12


@dataclass(frozen=True, slots=True, eq=False)
class MountError:
    """By how much tilt and roll differ from what is stated: mean (2,) rad and covariance (2, 2).

    crooked: how crooked edges are over what was stated of it, a factor of standard deviations.
    """

    mean: Array
    cov: Array
    crooked: float = 1.0


@dataclass(frozen=True, slots=True, eq=False)
class NadirMiss:
    """The angle between segments (S) and the lines from their middles to the nadir point.

    angle: (S,) rad, positive when the upper end lies to the right. per_mount: (S, 2) its derivative by tilt and roll.
    sigma: (S,) error of the segments' own directions.
    """

    angle: Array
    per_mount: Array
    sigma: Array

    def corrected(self, mount: MountError) -> tuple[Array, Array]:
        """Return the angle (S,) under the corrected mount, and its variance by what remains uncertain of that."""
        remaining = ((self.per_mount @ mount.cov) * self.per_mount).sum(axis=1)
        return self.angle + self.per_mount @ mount.mean, remaining

    def take(self, index: NDArray[np.bool_]) -> NadirMiss:
        """Return the angles of some segments."""
        return NadirMiss(self.angle[index], self.per_mount[index], self.sigma[index])


def nadir_miss(segments: Segments, camera: Camera) -> NadirMiss:
    """Return how far segments (S) are from pointing at the nadir point of `camera`.

    The nadir point moves by δθ / s² along e and by δρ c / s along a; seen from (a, e) it turns by a / q² δθ and
    c (c + e s) / q² δρ, where q² = (a s)² + (c + e s)². Also right when the tilt is 0.
    """
    support = ideal_camera(camera).upright_from_pixels(segments.support_px)
    across, up = (support[:, 1] - support[:, 0]).T
    a, e = support.mean(axis=1).T
    s, c = np.sin(camera.mount.tilt_rad), np.cos(camera.mount.tilt_rad)
    depth = c + e * s
    angle = np.sin(geometry.wrap_half_turn(np.arctan2(across, up) - np.arctan2(a * s, depth)))
    per_mount = np.stack([-a, c * depth], axis=-1) / ((a * s) ** 2 + depth**2)[:, None]
    length_px = np.linalg.norm(segments.support_px[:, 1] - segments.support_px[:, 0], axis=-1)
    return NadirMiss(angle, per_mount, np.sqrt(2.0) * segments.end_sigma_px / length_px)


def mount_error(miss: NadirMiss, prior_sigma_rad: Array, plumb_sigma_rad: float, iterations: int = 5) -> MountError:
    """Return the error of the stated tilt and roll that makes segments (S) point at the nadir point best.

    Robust least squares (Tukey's weights) with the prior N(0, prior_sigma²) for tilt and roll, and `plumb_sigma_rad`
    for how far real edges are from plumb. Without segments: the prior.
    """
    prior_variance = np.maximum(prior_sigma_rad, 1e-9) ** 2
    variance = miss.sigma**2 + plumb_sigma_rad**2
    return MountError(*compiled(mount_loop)(miss.angle, miss.per_mount, variance, prior_variance, _TUKEY, iterations))


def mount_error_of_edges(edges: Edges, camera: Camera, prior_sigma_rad: Array, plumb_sigma_rad: float) -> MountError:
    """Return the error of the stated tilt and roll of `camera` that one image's edges (E) tell; see `mount_error`.

    `plumb_sigma_rad` is the same for edges of any length; that they are not straight counts for more in shorter ones.
    How large both are is learnt with the mount, by expectation maximisation: walls that agree to hundredths of a degree
    tell the tilt as well as that, although none is stated to be built so.
    """
    pointing, crooked_rad = pointing_of_edges(edges, camera, plumb_sigma_rad)
    error = MountError(np.zeros(2), np.diag(prior_sigma_rad**2))
    for _ in range(_SCATTER_ROUNDS):
        sigma = np.hypot(pointing.sigma, error.crooked * crooked_rad)
        error = replace(mount_error(replace(pointing, sigma=sigma), prior_sigma_rad, 0.0), crooked=error.crooked)
        error = replace(error, crooked=_crooked(pointing, crooked_rad, error))
    return error


def pointing_of_edges(edges: Edges, camera: Camera, plumb_sigma_rad: float) -> tuple[NadirMiss, Array]:
    """Return how far edges (E) are from pointing at the nadir point, and how crooked (E,) rad they are stated to be."""
    ideal_px = ideal_camera(camera).pixels_from_image(camera.image_from_pixels(edges.ends_px))
    pointing = nadir_miss(Segments.of_ends(ideal_px, _STRAIGHT_PX), camera)
    return replace(pointing, sigma=edges.lean_sigma), np.hypot(pointing.sigma, plumb_sigma_rad)


def _crooked(pointing: NadirMiss, crooked_rad: Array, mount: MountError) -> float:
    """Return how crooked edges (E) are over what is stated, a mount (2,) given: one step of the maximisation."""
    angle, by_mount = pointing.corrected(mount)
    own = (mount.crooked * crooked_rad) ** 2
    variance = own + pointing.sigma**2
    says = np.maximum(1 - angle**2 / (_TUKEY**2 * (variance + by_mount)), 0.0) ** 2
    share = own / variance
    expected = share**2 * (angle**2 + by_mount) + share * pointing.sigma**2
    total = _PRIOR_EDGES + float((says * expected / crooked_rad**2).sum()) / _TUKEY_VARIANCE
    return float(np.sqrt(total / (_PRIOR_EDGES + float(says.sum()))))
