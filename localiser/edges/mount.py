"""Tilt and roll of the camera from the vertical edges of one image."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from localiser import geometry
from localiser.camera import Camera
from localiser.edges.mount_kernel import mount_loop
from localiser.edges.segments import Segments
from localiser.edges.types import Edges
from localiser.edges.undistort import ideal_camera
from localiser.geometry import Array
from localiser.geometry.compiled import compiled

_TUKEY = 4.0
"""Segments further from the common direction than this many sigmas have no say."""
_TUKEY_VARIANCE = 0.77
"""Share of the variance of Gaussian errors that remains when they are weighed so."""
_STRAIGHT_PX = 0.35
"""Error of an edge's ends across it that is none of measuring: real edges and lenses are no straighter. It turns a
short edge far and a long one hardly, so that many short edges do not outvote few long ones."""


_PRIOR_EDGES = 2.0
"""As how many edges it counts that edges are as crooked as is stated, when an image's own say how crooked they are."""
_SCATTER_ITERATIONS = 30


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
    variance = miss.sigma**2 + plumb_sigma_rad**2
    return _fitted(miss, variance, np.zeros(len(variance)), prior_sigma_rad, (iterations, 0))


def mount_error_of_edges(edges: Edges, camera: Camera, prior_sigma_rad: Array, plumb_sigma_rad: float) -> MountError:
    """Return the error of the stated tilt and roll of `camera` that one image's edges (E) tell; see `mount_error`.

    `plumb_sigma_rad` is the same for edges of any length; that they are not straight counts for more in shorter ones.
    How large both are is learnt with the mount, by expectation maximisation: walls that agree to hundredths of a degree
    tell the tilt as well as that, although none is stated to be built so.
    """
    return mount_error_of_pointing(*pointing_of_edges(edges, camera, plumb_sigma_rad), prior_sigma_rad)


def mount_error_of_pointing(pointing: NadirMiss, crooked_rad: Array, prior_sigma_rad: Array) -> MountError:
    """Return what `mount_error_of_edges` does, of edges (E) by what `pointing_of_edges` returns of them."""
    return _fitted(pointing, pointing.sigma**2, crooked_rad**2, prior_sigma_rad, (5, _SCATTER_ITERATIONS))


def pointing_of_edges(edges: Edges, camera: Camera, plumb_sigma_rad: float) -> tuple[NadirMiss, Array]:
    """Return how far edges (E) are from pointing at the nadir point, and how crooked (E,) rad they are stated to be."""
    ideal_px = ideal_camera(camera).pixels_from_image(camera.image_from_pixels(edges.ends_px))
    pointing = nadir_miss(Segments.of_ends(ideal_px, _STRAIGHT_PX), camera)
    return replace(pointing, sigma=edges.lean_sigma), np.hypot(pointing.sigma, plumb_sigma_rad)


def _fitted(
    miss: NadirMiss, variance: Array, crooked_variance: Array, prior_sigma_rad: Array, iterations: tuple[int, int]
) -> MountError:
    prior_variance = np.maximum(prior_sigma_rad, 1e-9) ** 2
    tukey = (_TUKEY, _TUKEY_VARIANCE)
    mean, cov, factor = compiled(mount_loop)(
        miss.angle, miss.per_mount, variance, crooked_variance, prior_variance, tukey, _PRIOR_EDGES, iterations
    )
    return MountError(mean, cov, float(np.sqrt(factor)))
