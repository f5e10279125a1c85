"""Tilt and roll of the camera from the vertical edges of one image."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from localiser import geometry
from localiser.camera import Camera
from localiser.edges.types import TURN_RATE, Edges, Segments
from localiser.geometry import Array
from localiser.geometry.compiled import compiled

_TUKEY = 4.0  # segments further from the common direction than this many sigmas have no say
_TUKEY_VARIANCE = 0.77  # share of the variance of Gaussian errors that remains when they are weighed so
_STRAIGHT_PX = 0.35
"""Error of an edge's ends across it that is none of measuring: real edges and lenses are no straighter. It turns a
short edge far and a long one hardly, so that many short edges do not outvote few long ones."""
_PRIOR_EDGES = 2.0  # edges, as which it counts that edges are as crooked as is stated
NEAR_RAD = np.radians(1.0)  # how far from the truth least squares may begin
_GRID, _GRID_SIGMAS = 17, 2.5  # steps of the grid to either side, and how many sigmas of the prior it covers
_EVERY_RAD = np.radians(2.5)  # range of directions over which a segment that is no vertical edge counts as spread
_FIRST_ITERATIONS, _SCATTER_ITERATIONS = 5, 30
_SETTLED = 1e-5  # changes of the factor on crookedness that are smaller than this fraction move nothing
LENS_SIGMA = 0.02
"""By what fraction of its distance from the principal point a lens of which no distortion is stated may move the
image's corner: lenses of one or two per cent are sold as free of it."""


class MountError(NamedTuple):
    """By how much tilt, roll (rad) and lens (sigmas) differ from what is stated: state (3,) with covariance (3, 3).

    crooked: how crooked edges are over what was stated of it, a factor of standard deviations.
    """

    state: Array
    state_cov: Array
    crooked: float = 1.0

    @property
    def mean(self) -> Array:
        """The errors (2,) of tilt and roll, rad."""
        return self.state[:2]

    @property
    def cov(self) -> Array:
        """Their covariance (2, 2), rad²; that the lens is not quite known is part of it."""
        return self.state_cov[:2, :2]


class NadirMiss(NamedTuple):
    """The angle between segments (S) and the lines from their middles to the nadir point.

    angle: (S,) rad, positive when the upper end lies to the right. per_mount: (S, 3) its derivative by `MountError`'s
    state. sigma: (S,) error of the segments' own directions. crooked: (S,) by how much the edges themselves are stated
    to be out of plumb, and not straight.
    """

    angle: Array
    per_mount: Array
    sigma: Array
    crooked: Array


def nadir_miss(segments: Segments, camera: Camera, plumb_sigma_rad: float, *, lens_sigma: float = 0.0) -> NadirMiss:
    """Return how far segments (S) are from pointing at the nadir point of `camera`.

    plumb_sigma_rad: how far real edges are from plumb. lens_sigma: how far a lens may move the corner, over its
    distance from the principal point, where the camera states no lens model. The nadir point moves by δθ / s² along e
    and by δρ c / s along a; seen from (a, e) it turns by a / q² δθ and c (c + e s) / q² δρ, where q² = (a s)² +
    (c + e s)². Also right when the tilt is 0.
    """
    support = camera.ideal.upright_from_pixels(segments.support_px)
    (across, up), (a, e) = (support[:, 1] - support[:, 0]).T, (support[:, 0] + support[:, 1]).T / 2
    s, c = np.sin(camera.mount.tilt_rad), np.cos(camera.mount.tilt_rad)
    depth = c + e * s
    angle = np.sin(geometry.wrap_half_turn(np.arctan2(across, up) - np.arctan2(a * s, depth)))
    squared = (a * s) ** 2 + depth**2
    per_mount = np.stack([-a / squared, c * depth / squared, _per_lens(support, camera, lens_sigma)], axis=-1)
    length_px = np.sqrt(((segments.support_px[:, 1] - segments.support_px[:, 0]) ** 2).sum(axis=-1))
    sigma = np.sqrt(2.0) * segments.end_sigma_px / length_px
    return NadirMiss(angle, per_mount, sigma, np.full(len(angle), plumb_sigma_rad))


def _per_lens(support: Array, camera: Camera, lens_sigma: float) -> Array:
    """Return the derivative (S,) of the miss by a radial distortion of which the camera states none, in its sigmas.

    support: (S, 2, 2) upright image coordinates p. A distortion κ moves p by -κ r² p; κ = lens_sigma / r² of the
    image's corner. A line at the image's side turns by some 2 κ a e, the other way above and below the middle.
    """
    if camera.is_distorted or lens_sigma == 0:
        return np.zeros(len(support))
    corner = (np.array([camera.width, camera.height]) - 1) / 2 / camera.focal_px
    moved = -lens_sigma / (corner @ corner) * (support**2).sum(axis=-1, keepdims=True) * support
    along, turned = support[:, 1] - support[:, 0], moved[:, 1] - moved[:, 0]
    middle, shifted = support.mean(axis=1), moved.mean(axis=1)
    s, c = np.sin(camera.mount.tilt_rad), np.cos(camera.mount.tilt_rad)
    from_nadir = middle * s + np.array([0.0, c])  # times s, and so is how it moves
    return _turn(along, turned) - _turn(from_nadir, s * shifted)


def _turn(direction: Array, by: Array) -> Array:
    """Return by how much (S,) rad a direction (S, 2) turns rightwards when a small vector (S, 2) is added to it."""
    return np.asarray((by[:, 0] * direction[:, 1] - by[:, 1] * direction[:, 0]) / (direction**2).sum(axis=1))


def fit_mount(miss: NadirMiss, prior_sigma_rad: Array, *, learn_crooked: bool = False) -> MountError:
    """Return the error of the stated tilt and roll that makes segments (S) point at the nadir point best.

    Robust least squares (Tukey's weights) with the prior N(0, prior_sigma²) for tilt and roll, which is returned where
    there are no segments. Where the lens may err, a radial distortion is estimated with them: it turns edges on both
    sides of the image, as a tilt does, and the other way in its upper and its lower half. Least squares end at the
    nearest optimum, so where the prior is wider than a degree they begin at the likeliest point of a grid.
    learn_crooked: find by expectation maximisation how crooked edges are, as a factor of what is stated: walls that
    agree to hundredths of a degree tell the tilt as well as that, although none is stated to be built so.
    """
    prior_sigma_rad = np.maximum(prior_sigma_rad, 1e-9)
    if prior_sigma_rad.max() > NEAR_RAD and len(miss.angle):
        start, narrow = _likeliest(miss, prior_sigma_rad), np.minimum(prior_sigma_rad, NEAR_RAD)
        turned = miss._replace(angle=miss.angle + miss.per_mount[:, :2] @ start)
        near = fit_mount(turned, narrow, learn_crooked=learn_crooked)
        # What the segments tell is `certain` without the narrow prior; the one that is stated takes its place.
        certain, prior = np.linalg.inv(near.state_cov), np.diag(np.append(prior_sigma_rad, 1.0) ** -2.0)
        cov = np.asarray(np.linalg.inv(certain - np.diag(np.append(narrow, 1.0) ** -2.0) + prior), dtype=np.float64)
        begun = np.append(start, 0.0)
        return near._replace(state=begun + cov @ (certain @ near.state - prior @ begun), state_cov=cov)
    prior_variance = np.append(prior_sigma_rad, 1.0) ** 2
    arguments = miss.angle, miss.per_mount, miss.sigma**2, miss.crooked**2, prior_variance
    state, cov, factor = compiled(mount_loop)(*arguments, _SCATTER_ITERATIONS if learn_crooked else 0)
    return MountError(state, cov, float(np.sqrt(factor)))


def _likeliest(miss: NadirMiss, prior_sigma_rad: Array) -> Array:
    """Return the tilt and roll (2,) of a grid that most segments, each vertical or clutter, and the prior speak for."""
    steps = np.arange(-_GRID, _GRID + 1) / _GRID * _GRID_SIGMAS
    grid = np.stack(np.meshgrid(*(steps * sigma for sigma in prior_sigma_rad), indexing="ij"), axis=-1).reshape(-1, 2)
    step_rad = _GRID_SIGMAS / _GRID * prior_sigma_rad.max()
    variance = miss.sigma**2 + miss.crooked**2 + step_rad**2 / 12
    squared = (miss.angle[:, None] + miss.per_mount[:, :2] @ grid.T) ** 2 / variance[:, None]
    density = np.exp(-0.5 * squared) / np.sqrt(2 * np.pi * variance)[:, None]
    score = np.log1p(density * _EVERY_RAD).sum(axis=0) - 0.5 * ((grid / prior_sigma_rad) ** 2).sum(axis=1)
    return np.asarray(grid[int(score.argmax())])


def mount_error_of_edges(
    edges: Edges, ends: Array, camera: Camera, prior_sigma_rad: Array, plumb_sigma_rad: float, *, lens_sigma: float
) -> MountError:
    """Return the error of the stated tilt and roll of `camera` that one image's edges (E) tell; see `fit_mount`.

    ends: (E, 2, 2) of the edges in image coordinates. `plumb_sigma_rad` is the same for edges of any length; that they
    are not straight counts for more in shorter ones. lens_sigma: see `nadir_miss`. 0 where many images follow each
    other: an error of the lens is the same in all of them, and one that is estimated anew in each is not.
    """
    ideal_px = camera.ideal.pixels_from_image(ends)
    miss = nadir_miss(Segments.of_ends(ideal_px, _STRAIGHT_PX), camera, plumb_sigma_rad, lens_sigma=lens_sigma)
    sigma, tilt_rad = edges.lean_sigma, camera.mount.tilt_rad
    if TURN_RATE in edges.common.names and not geometry.is_level(tilt_rad):
        # An error of the turn rate turns all edges alike, so that their number does not average it.
        by_rate = edges.common.bearing_from_lean[:, edges.common.names.index(TURN_RATE)]
        turned = by_rate / geometry.bearing_per_lean(edges.bearing, tilt_rad) * edges.common.sigma_of(TURN_RATE)
        sigma = np.hypot(sigma, np.sqrt(len(edges)) * np.abs(turned))
    miss = miss._replace(sigma=sigma, crooked=np.hypot(miss.sigma, plumb_sigma_rad))
    return fit_mount(miss, prior_sigma_rad, learn_crooked=True)


def mount_loop(
    angle: Array,
    per_mount: Array,
    variance: Array,
    crooked_variance: Array,
    prior_variance: Array,
    more_iterations: int,
) -> tuple[Array, Array, float]:
    """Return tilt, roll and lens (3,) with covariance (3, 3) that angles (S,) tell, and a factor on crooked_variance.

    more_iterations: with a factor that is learnt, until it changes by less than the fraction `_SETTLED`.
    """
    state, cov, factor = np.zeros(3), np.diag(prior_variance), 1.0
    for iteration in range(_FIRST_ITERATIONS + more_iterations):
        says = crooked = 0.0
        information, pull = np.diag(1 / prior_variance), np.zeros(3)
        for k in range(len(angle)):
            by = per_mount[k]
            miss, remaining = angle[k], 0.0
            for i in range(3):
                miss += by[i] * state[i]
                for j in range(3):
                    remaining += cov[i, j] * by[i] * by[j]
            own = factor * crooked_variance[k]
            total = own + variance[k]
            trust = max(1 - miss**2 / (_TUKEY**2 * (total + remaining)), 0.0) ** 2
            weight = trust / total
            says += trust
            if own > 0:
                part = own / total
                crooked += trust * (part**2 * (miss**2 + remaining) + part * variance[k]) / crooked_variance[k]
            for i in range(3):
                pull[i] -= weight * by[i] * angle[k]
                for j in range(3):
                    information[i, j] += weight * by[i] * by[j]
        # The inverse of a symmetric 3 × 3 matrix by its cofactors.
        for i in range(3):
            for j in range(3):
                a, b, c, d = (i + 1) % 3, (i + 2) % 3, (j + 1) % 3, (j + 2) % 3
                cov[i, j] = information[a, c] * information[b, d] - information[a, d] * information[b, c]
        cov /= information[0, 0] * cov[0, 0] + information[0, 1] * cov[0, 1] + information[0, 2] * cov[0, 2]
        for i in range(3):
            state[i] = cov[i, 0] * pull[0] + cov[i, 1] * pull[1] + cov[i, 2] * pull[2]
        if _FIRST_ITERATIONS - 1 <= iteration < _FIRST_ITERATIONS + more_iterations - 1:
            before, factor = factor, (_PRIOR_EDGES + crooked / _TUKEY_VARIANCE) / (_PRIOR_EDGES + says)
            if abs(factor - before) < _SETTLED * before:
                break
    return state, cov, factor
