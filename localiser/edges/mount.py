"""Tilt and roll of the camera from the vertical edges of one image."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from localiser import geometry
from localiser.camera import Camera
from localiser.edges.mount_kernel import mount_loop
from localiser.edges.segments import Segments
from localiser.edges.types import TURN_RATE, Edges
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
_NEAR_RAD = np.radians(1.0)
"""How far from the truth least squares may begin."""
_GRID, _GRID_SIGMAS = 17, 2.5
"""Steps of the grid to either side, and how many sigmas of the prior it covers."""
_EVERY_RAD = np.radians(2.5)
"""Range of directions over which a segment that is no vertical edge counts as spread."""
_FIRST_ITERATIONS, _SCATTER_ITERATIONS = 5, 30


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
    sigma: (S,) error of the segments' own directions. crooked: (S,) by how much the edges themselves are stated to be
    out of plumb, and not straight.
    """

    angle: Array
    per_mount: Array
    sigma: Array
    crooked: Array

    def corrected(self, mount: MountError) -> tuple[Array, Array]:
        """Return the angle (S,) under the corrected mount, and its variance by what remains uncertain of that."""
        remaining = ((self.per_mount @ mount.cov) * self.per_mount).sum(axis=1)
        return self.angle + self.per_mount @ mount.mean, remaining

    def turned(self, mount_rad: Array) -> NadirMiss:
        """Return the angles for a camera with this much more tilt and roll (2,)."""
        return replace(self, angle=self.angle + self.per_mount @ mount_rad)

    def take(self, index: NDArray[np.bool_]) -> NadirMiss:
        """Return the angles of some segments."""
        return NadirMiss(self.angle[index], self.per_mount[index], self.sigma[index], self.crooked[index])


def nadir_miss(segments: Segments, camera: Camera, plumb_sigma_rad: float) -> NadirMiss:
    """Return how far segments (S) are from pointing at the nadir point of `camera`.

    plumb_sigma_rad: how far real edges are from plumb. The nadir point moves by δθ / s² along e and by δρ c / s along
    a; seen from (a, e) it turns by a / q² δθ and c (c + e s) / q² δρ, where q² = (a s)² + (c + e s)². Also right when
    the tilt is 0.
    """
    support = ideal_camera(camera).upright_from_pixels(segments.support_px)
    across, up = (support[:, 1] - support[:, 0]).T
    a, e = support.mean(axis=1).T
    s, c = np.sin(camera.mount.tilt_rad), np.cos(camera.mount.tilt_rad)
    depth = c + e * s
    angle = np.sin(geometry.wrap_half_turn(np.arctan2(across, up) - np.arctan2(a * s, depth)))
    per_mount = np.stack([-a, c * depth], axis=-1) / ((a * s) ** 2 + depth**2)[:, None]
    length_px = np.linalg.norm(segments.support_px[:, 1] - segments.support_px[:, 0], axis=-1)
    sigma = np.sqrt(2.0) * segments.end_sigma_px / length_px
    return NadirMiss(angle, per_mount, sigma, np.full(len(angle), plumb_sigma_rad))


def nadir_miss_of_edges(edges: Edges, camera: Camera, plumb_sigma_rad: float) -> NadirMiss:
    """Return how far edges (E) are from pointing at the nadir point; short ones are stated to be more crooked."""
    ideal_px = ideal_camera(camera).pixels_from_image(camera.image_from_pixels(edges.ends_px))
    miss = nadir_miss(Segments.of_ends(ideal_px, _STRAIGHT_PX), camera, plumb_sigma_rad)
    sigma = edges.lean_sigma
    if TURN_RATE in edges.common.names:
        sigma = np.hypot(sigma, _turned_alike(edges, camera))
    return replace(miss, sigma=sigma, crooked=np.hypot(miss.sigma, plumb_sigma_rad))


def _turned_alike(edges: Edges, camera: Camera) -> Array:
    """Return how far (E,) rad an error of the turn rate turns edges, so that their number does not average it."""
    tilt_rad = camera.mount.tilt_rad
    if tilt_rad == 0:
        return np.zeros(len(edges))
    by_lean = edges.common.bearing_from_lean[:, edges.common.names.index(TURN_RATE)]
    lean = by_lean / geometry.bearing_per_lean(edges.bearing, tilt_rad)
    return np.asarray(np.sqrt(len(edges)) * edges.common.sigma_of(TURN_RATE) * np.abs(lean))


def fit_mount(miss: NadirMiss, prior_sigma_rad: Array, *, learn_crooked: bool = False) -> MountError:
    """Return the error of the stated tilt and roll that makes segments (S) point at the nadir point best.

    Robust least squares (Tukey's weights) with the prior N(0, prior_sigma²) for tilt and roll. Without segments: the
    prior. Least squares end at the nearest optimum, so where the prior is wider than a degree they begin at the
    likeliest point of a grid. learn_crooked: find by expectation maximisation how crooked edges are, as a factor of
    what is stated: walls that agree to hundredths of a degree tell the tilt as well as that, although none is stated
    to be built so.
    """
    if prior_sigma_rad.max() > _NEAR_RAD and len(miss.angle):
        start, narrow = _likeliest(miss, prior_sigma_rad), np.minimum(prior_sigma_rad, _NEAR_RAD)
        near = fit_mount(miss.turned(start), narrow, learn_crooked=learn_crooked)
        # What the segments tell of it is `certain` without the narrow prior; the one that is stated takes its place.
        certain, prior = np.linalg.inv(near.cov), np.diag(prior_sigma_rad**-2.0)
        cov = np.asarray(np.linalg.inv(certain - np.diag(narrow**-2.0) + prior), dtype=np.float64)
        return replace(near, mean=start + cov @ (certain @ near.mean - prior @ start), cov=cov)
    variance, crooked_variance = miss.sigma**2, miss.crooked**2
    if not learn_crooked:
        variance, crooked_variance = variance + crooked_variance, np.zeros(len(variance))
    prior_variance = np.maximum(prior_sigma_rad, 1e-9) ** 2
    tukey = (_TUKEY, _TUKEY_VARIANCE)
    iterations = (_FIRST_ITERATIONS, _SCATTER_ITERATIONS if learn_crooked else 0)
    mean, cov, factor = compiled(mount_loop)(
        miss.angle, miss.per_mount, variance, crooked_variance, prior_variance, tukey, _PRIOR_EDGES, iterations
    )
    return MountError(mean, cov, float(np.sqrt(factor)))


def _likeliest(miss: NadirMiss, prior_sigma_rad: Array) -> Array:
    """Return the tilt and roll (2,) of a grid of 2.5 prior sigmas that most segments and the prior speak for.

    A segment is vertical or, as likely, one of clutter, whose directions are spread evenly.
    """
    steps = np.arange(-_GRID, _GRID + 1) / _GRID * _GRID_SIGMAS
    grid = np.stack(np.meshgrid(*(steps * sigma for sigma in prior_sigma_rad), indexing="ij"), axis=-1).reshape(-1, 2)
    step_rad = _GRID_SIGMAS / _GRID * prior_sigma_rad.max()
    variance = miss.sigma**2 + miss.crooked**2 + step_rad**2 / 12
    squared = (miss.angle[:, None] + miss.per_mount @ grid.T) ** 2 / variance[:, None]
    density = np.exp(-0.5 * squared) / np.sqrt(2 * np.pi * variance)[:, None]
    score = np.log1p(density * _EVERY_RAD).sum(axis=0) - 0.5 * ((grid / prior_sigma_rad) ** 2).sum(axis=1)
    return np.asarray(grid[int(score.argmax())])


def mount_error_of_edges(edges: Edges, camera: Camera, prior_sigma_rad: Array, plumb_sigma_rad: float) -> MountError:
    """Return the error of the stated tilt and roll of `camera` that one image's edges (E) tell; see `fit_mount`.

    `plumb_sigma_rad` is the same for edges of any length; that they are not straight counts for more in shorter ones.
    """
    return fit_mount(nadir_miss_of_edges(edges, camera, plumb_sigma_rad), prior_sigma_rad, learn_crooked=True)
