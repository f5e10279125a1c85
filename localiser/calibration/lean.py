"""Tilt and roll when things lean: what stands in one place, or in one row, leans in one direction.

Books on a shelf lean against each other, and a shelf stands as its floor does. So edges that are seen in one place
share an error, in however many images they are seen. Their lean is a latent variable of the place: a Gaussian process
over the floor, with two components. Things lean by themselves, within less than a metre, and they lean with their row.
How much they lean is found from the log as well. A row is taken to lean as much as the things and edges in it scatter,
or more: they lean because they stand against each other, and a lean that all rows in view share cannot be told from an
error of the mount.

Edges are not followed. Where one stands is known by the ray along which it was seen, and by how far away things are
that a camera which looks at the floor sees. The correlation of two leans is that of the process, averaged over both
rays.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from localiser.calibration.lines import Lines
from localiser.calibration.plumb import PRIOR_SIGMA_RAD, Plumb
from localiser.camera import Camera
from localiser.geometry import Array

_THING_M, _ROW_M = 0.7, 4.0
"""How far the lean of a thing reaches, and that of a row: a box or chair, a wall of shelves."""
_RANGE_M, _RANGE_SIGMA_M = 2.5, 1.5
"""How far away things are that a camera which looks at the floor sees."""
_LEANS_RAD = np.deg2rad(0.01 * 2.0 ** np.arange(7))
"""How much things and rows may lean, each value as likely: from what masons do at best to what falls over."""
_PATCH_M, _PATCH_RAD = 1.0, np.deg2rad(30.0)
"""Images from one place in one direction show the same things."""
_MOST_PATCHES, _COARSER = 250, 1.4
_LEAST_EDGES = 0.5
_SINGULAR = 1e-9


@dataclass(frozen=True, slots=True, eq=False)
class Leaning:
    """Tilt and roll (2,) rad with the covariance (2, 2) that leaning things leave.

    thing, row: rad, how much things lean by themselves, and with their row (one sigma for each direction).
    """

    mount: Array
    cov: Array
    thing: float
    row: float


@dataclass(frozen=True, slots=True, eq=False)
class _Rays:
    """Lines (K) on the floor: miss (K,) = -per_mount (K, 2) · error of the mount - across (K, 2) · lean + noise.

    across: in the map, to the right of the line of sight. ahead: (K, 2) the unit vector along that. eye: (K, 2) m.
    weight: (K,) 1/rad².
    """

    miss: Array
    per_mount: Array
    across: Array
    ahead: Array
    eye: Array
    weight: Array
    frame: NDArray[np.int64]


@dataclass(frozen=True, slots=True, eq=False)
class _Patches:
    """What the lines of C patches tell, a patch being what is seen from one place in one direction.

    root: (C, 2, 2) symmetric square root of the information about the lean. scaled: (2C, 3) that of the lean with the
    mount, and the pull on the lean, divided by root. information: (2, 2) about the mount, and pull: (2,) on it, when
    nothing is known of the leans. middle, ahead: (C, 2) where the patch is seen from, and in which direction.
    """

    root: Array
    scaled: Array
    information: Array
    pull: Array
    middle: Array
    ahead: Array


def mount_with_leans(lines: Lines, plumb: Plumb, poses: Array, camera: Camera, stated: Array) -> Leaning:
    """Return tilt and roll from lines (K) of images that were taken at robot poses (F, 3), when things lean.

    plumb: what the lines say when leans are independent. stated: (2,) the middle of the prior. Poses may drift: only
    what is near matters. The posterior is averaged over how much things and rows lean.
    """
    if plumb.vertical.sum() <= _LEAST_EDGES:
        return Leaning(plumb.mount, plumb.cov, 0.0, 0.0)
    rays = _rays(lines, plumb, poses, camera)
    patch, count = _patch_of(rays, plumb.vertical)
    patches = _patches(rays, patch, count, stated - plumb.mount)
    thing, row = (_shared(patches, length_m) for length_m in (_THING_M, _ROW_M))
    rows = np.unique(np.maximum(_LEANS_RAD, plumb.plumb_sigma))
    leans = [(a, b) for a in _LEANS_RAD for b in rows if b >= a] or [(rows[-1], rows[-1])]
    found = [_given(patches, np.eye(2 * count) + a**2 * thing + b**2 * row) for a, b in leans]
    log_evidence = np.array([evidence for evidence, _, _ in found])
    probability = np.exp(log_evidence - log_evidence.max())
    probability /= probability.sum()
    steps = np.array([step for _, step, _ in found])
    mean = probability @ steps
    off = steps - mean
    cov = np.einsum("h,hij->ij", probability, np.array([cov for _, _, cov in found]) + off[:, :, None] * off[:, None])
    size = np.sqrt(probability @ np.square(leans))
    return Leaning(plumb.mount + mean, cov, float(size[0]), float(size[1]))


def _rays(lines: Lines, plumb: Plumb, poses: Array, camera: Camera) -> _Rays:
    """Return the lines (K) on the floor. A line that leans by l (2,) misses down by -across · l."""
    camera = camera.with_mount(tilt_rad=float(plumb.mount[0]), roll_rad=float(plumb.mount[1]))
    eyes = camera.pose_in_map(poses)[lines.frame]
    miss, per_mount, sigma = lines.misses(plumb.mount)
    right, _, back = (lines.normal @ camera.level_from_camera.T).T
    cos, sin = np.cos(eyes[:, 2]), np.sin(eyes[:, 2])
    across = np.stack([cos * right + sin * back, cos * back - sin * right], axis=-1)
    ahead = np.stack([across[:, 1], -across[:, 0]], axis=-1) * np.where(right < 0, -1.0, 1.0)[:, None]
    ahead = ahead / np.maximum(np.linalg.norm(ahead, axis=1, keepdims=True), 1e-12)
    weight = plumb.vertical / (sigma**2 + plumb.plumb_sigma**2)
    return _Rays(miss, per_mount, across, ahead, eyes[:, :2], weight, lines.frame)


def _patch_of(rays: _Rays, vertical: Array) -> tuple[NDArray[np.int64], int]:
    """Return the patch (K,) of each line, -1 for those without a vertical edge, and how many patches there are."""
    heading, step_m = np.arctan2(rays.ahead[:, 0], -rays.ahead[:, 1]), _PATCH_M
    while True:
        corner = np.column_stack([rays.eye / step_m, heading / _PATCH_RAD])
        patch = np.unique(np.floor(corner).astype(np.int64), axis=0, return_inverse=True)[1].reshape(-1)
        share = np.bincount(patch, vertical)
        used = share > min(_LEAST_EDGES, share.max() / 2)
        if used.sum() <= _MOST_PATCHES:
            return np.where(used, np.cumsum(used) - 1, -1)[patch], int(used.sum())
        step_m *= _COARSER


def _patches(rays: _Rays, patch: NDArray[np.int64], count: int, stated: Array) -> _Patches:
    """Return what the lines (K) of each patch tell; stated: (2,) the prior's middle, from the mount of the lines.

    All images of a patch show the same edges with the same errors, so they count as one of them.
    """
    used = patch >= 0
    patch, frame = patch[used], rays.frame[used]
    images = np.bincount(np.unique(np.stack([patch, frame]), axis=1)[0], minlength=count)
    weight = rays.weight[used] / images[patch]
    by = np.concatenate([rays.per_mount, rays.across], axis=1)[used]
    information, pull = np.zeros((count, 4, 4)), np.zeros((count, 4))
    np.add.at(information, patch, weight[:, None, None] * by[:, :, None] * by[:, None, :])
    np.add.at(pull, patch, -(weight * rays.miss[used])[:, None] * by)
    size, axes = np.linalg.eigh(information[:, 2:, 2:])
    root_size = np.sqrt(np.maximum(size, _SINGULAR * size.max()))
    root = np.einsum("cij,cj,ckj->cik", axes, root_size, axes)
    inverse = np.einsum("cij,cj,ckj->cik", axes, 1 / root_size, axes)
    scaled = inverse @ np.concatenate([information[:, 2:, :2], pull[:, 2:, None]], axis=2)
    scaled = scaled.reshape(2 * count, 3)
    prior = np.diag(PRIOR_SIGMA_RAD**-2)
    middle, ahead = np.zeros((count, 2)), np.zeros((count, 2))
    np.add.at(middle, patch, weight[:, None] * rays.eye[used])
    np.add.at(ahead, patch, weight[:, None] * rays.ahead[used])
    return _Patches(
        root=root,
        scaled=scaled,
        information=prior + information[:, :2, :2].sum(axis=0) - scaled[:, :2].T @ scaled[:, :2],
        pull=prior @ stated + pull[:, :2].sum(axis=0) - scaled[:, :2].T @ scaled[:, 2],
        middle=middle / np.bincount(patch, weight, count)[:, None],
        ahead=ahead / np.linalg.norm(ahead, axis=1, keepdims=True),
    )


def _shared(patches: _Patches, length_m: float) -> Array:
    """Return the covariance (2C, 2C) of leans of one rad that reach `length_m`, multiplied by `root` on both sides.

    Things of a patch stand along its ray, N(range, σ²). The correlation is the mean of exp(-d²/2 length²) over where
    the things of both patches stand, and 1 for a patch with itself.
    """
    place = patches.middle + _RANGE_M * patches.ahead
    along = _RANGE_SIGMA_M**2 * patches.ahead[:, :, None] * patches.ahead[:, None, :]
    spread = length_m**2 * np.eye(2) + along[:, None] + along[None]
    apart = place[:, None] - place[None]
    distance2 = np.einsum("abi,abij,abj->ab", apart, np.linalg.inv(spread), apart)
    mean = np.exp(-distance2 / 2) / np.sqrt(np.linalg.det(spread))
    own = np.sqrt(np.diag(mean))
    both = (mean / np.outer(own, own))[:, :, None, None] * np.einsum("aij,bjk->abik", patches.root, patches.root)
    return np.asarray(both.transpose(0, 2, 1, 3).reshape(2 * len(place), 2 * len(place)))


def _given(patches: _Patches, spread: Array) -> tuple[float, Array, Array]:
    """Return log-evidence, correction (2,) of the mount and its covariance (2, 2), with the leans integrated out.

    spread: (2C, 2C) one plus the leans' covariance scaled by the root of their information on both sides [Rasmussen06,
    eq. 2.40 ff.].
    """
    solved = np.linalg.solve(spread, patches.scaled)
    information = patches.information + patches.scaled[:, :2].T @ solved[:, :2]
    pull = patches.pull + patches.scaled[:, :2].T @ solved[:, 2]
    cov = np.asarray(np.linalg.inv(information))
    step = cov @ pull
    volume = np.log(np.diag(np.linalg.cholesky(spread))).sum() + np.linalg.slogdet(information)[1] / 2
    return float((pull @ step - patches.scaled[:, 2] @ solved[:, 2]) / 2 - volume), step, cov
