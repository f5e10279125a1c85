"""Image lines as planes through the camera's centre, and the tilt and roll that most of them agree on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import ArrayLike, NDArray

from localiser.camera import Camera
from localiser.edges import Edges
from localiser.geometry import Array

_END_SIGMA_PX = 0.5
"""Error across the line of an end of a segment that was rejected and so not measured further."""
_SHORTEST_PX = 2.0
PRIOR_SIGMA_RAD = np.deg2rad([5.0, 3.0])
"""How far stated tilt and roll are off at most, one sigma: so wide that it decides only what no edge tells."""
REACH_SIGMA = 2.5
"""Down is looked for as many of these sigmas around what is stated."""
_GRID_RAD = np.deg2rad(0.5)
_WIDEST_MISS_RAD = np.deg2rad(10.0)
"""Lines that are no vertical edges miss down by anything up to this, each value as likely."""
_LEAST_PLUMB_RAD = np.deg2rad(0.02)
"""Nothing is built, and no lens calibrated, better than this."""
_ITERATIONS = 100
_CONVERGED_RAD = 1e-7


@dataclass(frozen=True, slots=True, eq=False)
class Lines:
    """Lines of the images of one camera, K of them, each as the plane through it and the camera's centre.

    normal: (K, 3) unit normals in the camera's axes (right, up, backward). per_turn: (K, 3) by how much the normal
    moves per radian that the line turns about its middle, in the image. sigma: (K,) rad, error of that direction.
    frame: (K,) index of the image.
    """

    normal: Array
    per_turn: Array
    sigma: Array
    frame: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.sigma)

    def take(self, index: NDArray[np.bool_] | NDArray[np.int64]) -> Lines:
        """Return some of the lines."""
        return Lines(*(getattr(self, column.name)[index] for column in fields(self)))

    @classmethod
    def together(cls, parts: Sequence[Lines]) -> Lines:
        """Return the lines of all parts."""
        if not parts:
            return cls(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0), np.zeros(0, dtype=np.int64))
        return cls(*(np.concatenate([getattr(part, column.name) for part in parts]) for column in fields(cls)))

    def misses(self, mount: ArrayLike) -> tuple[Array, Array, Array]:
        """Return by how much (K,) rad lines miss the down of tilt and roll (2,), its derivative (K, 2), its sigma (K,).

        A vertical edge lies in a plane that holds the direction of down: normal · down = 0.
        """
        down = down_in_camera(mount)
        return self.normal @ down, self.normal @ _down_per_mount(mount), self.sigma * np.abs(self.per_turn @ down)


def lines_of(edges: Edges, camera: Camera, frame: int = 0) -> Lines:
    """Return all lines of one image: its edges, and those that were rejected as not vertical.

    Both, so that a wrong tilt does not choose the lines that agree with it; the mount of `camera` has no say. Edges
    that were not measured in an image, whose ends are nan, are left out. Lines of an image with a mount of its own are
    turned into the axes of the usual one, so that all images show the same error of it.
    """
    ends = camera.image_from_pixels(np.concatenate([edges.ends_px, edges.rejected_px]))
    along = ends[:, 1] - ends[:, 0]
    length = np.hypot(*along.T)
    of_ends = np.sqrt(2.0) * _END_SIGMA_PX / camera.focal_px / np.maximum(length, 1e-9)
    sigma = np.concatenate([edges.lean_sigma, of_ends[len(edges) :]])
    known = np.isfinite(ends).all(axis=(1, 2)) & (length * camera.focal_px > _SHORTEST_PX) & np.isfinite(sigma)
    ends, direction = ends[known], along[known] / length[known, None]
    zero = np.zeros((len(ends), 1))
    middle = np.concatenate([ends.mean(axis=1), zero - 1], axis=1)
    normal = np.cross(middle, np.concatenate([direction, zero], axis=1))
    per_turn = np.cross(middle, np.concatenate([-direction[:, 1:], direction[:, :1], zero], axis=1))
    size = np.linalg.norm(normal, axis=1, keepdims=True)
    if edges.mount is not None:
        mounted = camera.level_from_camera.T @ camera.at(edges.mount).level_from_camera
        normal, per_turn = normal @ mounted.T, per_turn @ mounted.T
    return Lines(normal / size, per_turn / size, sigma[known], np.full(len(ends), frame, dtype=np.int64))


def down_in_camera(mount: ArrayLike) -> Array:
    """Return the unit vector (..., 3) that points down, in the camera's axes, for tilt and roll (..., 2)."""
    tilt, roll = np.moveaxis(np.asarray(mount, dtype=np.float64), -1, 0)
    return np.stack([np.cos(tilt) * np.sin(roll), -np.cos(tilt) * np.cos(roll), -np.sin(tilt)], axis=-1)


def mount_from_down(down: ArrayLike) -> Array:
    """Return tilt and roll (..., 2) for which the unit vector (..., 3) points down; inverse of `down_in_camera`."""
    right, up, back = np.moveaxis(np.asarray(down, dtype=np.float64), -1, 0)
    return np.stack([np.arctan2(-back, np.hypot(right, up)), np.arctan2(right, -up)], axis=-1)


def _down_per_mount(mount: ArrayLike) -> Array:
    """Return the derivative (3, 2) of `down_in_camera` by tilt and roll."""
    tilt, roll = np.asarray(mount, dtype=np.float64)
    by_tilt = [-np.sin(tilt) * np.sin(roll), np.sin(tilt) * np.cos(roll), -np.cos(tilt)]
    by_roll = [np.cos(tilt) * np.cos(roll), np.cos(tilt) * np.sin(roll), 0.0]
    return np.stack([by_tilt, by_roll], axis=-1)


# -- tilt and roll -----------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, eq=False)
class Plumb:
    """What lines (K) say about tilt and roll.

    mount: (2,) rad, cov: (2, 2) as if lines erred independently. plumb_sigma: rad, how far vertical edges are from
    plumb beyond the error of measuring them. vertical: (K,) probability that a line is a vertical edge.
    """

    mount: Array
    cov: Array
    plumb_sigma: float
    vertical: Array


def vote_mount(lines: Lines, stated: Array) -> Array:
    """Return the tilt and roll (2,) around the stated, on a grid of half a degree, that most lines (K) agree with."""
    reach = np.floor(REACH_SIGMA * PRIOR_SIGMA_RAD / _GRID_RAD)
    tilt, roll = (stated[i] + _GRID_RAD * np.arange(-reach[i], reach[i] + 1) for i in range(2))
    candidates = np.stack(np.meshgrid(tilt, roll, indexing="ij"), axis=-1).reshape(-1, 2)
    down = down_in_camera(candidates).T
    votes = np.zeros(len(candidates))
    for part in np.array_split(np.arange(len(lines)), len(lines) // 500 + 1):
        some = lines.take(part)
        sigma = np.hypot(some.sigma[:, None] * (some.per_turn @ down), _GRID_RAD)
        # An uncertain line agrees with much, so its voice counts less in each place.
        votes += (np.exp(-((some.normal @ down / sigma) ** 2) / 2) / sigma).sum(axis=0)
    return np.asarray(candidates[np.argmax(votes)])


def fit_mount(lines: Lines, stated: Array, start: Array, plumb_sigma: float | None = None) -> Plumb:
    """Return what lines (K) say about tilt and roll, from a `start` (2,) near it, with the prior N(stated, PRIOR²).

    p(miss) = v N(0, sigma² + plumb_sigma²) + (1 - v) uniform, by expectation maximisation over which lines are
    vertical; v and, when not given, plumb_sigma are found as well. With known weights this is design equation 10: the
    direction whose squared misses sum to the least.
    """
    prior = np.diag(PRIOR_SIGMA_RAD**-2)
    mount, share = start, 0.5
    plumb = plumb_sigma or _GRID_RAD / 2
    for _ in range(_ITERATIONS):
        miss, per_mount, sigma = lines.misses(mount)
        variance = sigma**2 + plumb**2
        density = np.exp(-(miss**2) / (2 * variance)) / np.sqrt(2 * np.pi * variance)
        vertical = share * density / (share * density + (1 - share) / (2 * _WIDEST_MISS_RAD))
        weight = vertical / variance
        cov = np.asarray(np.linalg.inv(prior + per_mount.T @ (weight[:, None] * per_mount)))
        step = cov @ (prior @ (stated - mount) - per_mount.T @ (weight * miss))
        mount = mount + step
        if len(lines):
            share = float(np.clip(vertical.mean(), 0.01, 0.99))
        if len(lines) and plumb_sigma is None:
            precise = vertical / variance**2
            excess = float((precise * (miss**2 - sigma**2)).sum() / max(float(precise.sum()), 1e-300))
            plumb = float(np.sqrt(max(excess, _LEAST_PLUMB_RAD**2)))
        if np.abs(step).max() < _CONVERGED_RAD:
            break
    return Plumb(mount, cov, plumb, vertical)
