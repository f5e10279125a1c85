"""Tilt and roll over a log: all lines of all images together, with a sigma that counts what stands together once.

Things that stand together lean together: books on a shelf, posts of a rack. However many images show them, their lean
is one error. So lines are put into clusters by the place where what they show stands, and the covariance is that of
the cluster-robust (sandwich) estimator in the form of the delete-a-cluster jackknife [Cameron, Miller 2015], plus the
covariance of the lines themselves with each cluster counted as one image of it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from localiser.calibration.lines import PRIOR_SIGMA_RAD, REACH_SIGMA, Lines, Plumb, fit_mount, lines_of, vote_mount
from localiser.camera import Camera
from localiser.edges import EdgeParameters, Edges, find_edges
from localiser.geometry import Array, Twist

_COARSE_IMAGES = 60
_COARSE_PASSES = 4
_SETTLED_RAD = np.deg2rad(0.1)
"""A mount this near shows the edge detector the same lines."""
_RANGE_M = 2.5
"""How far away things are that a camera which looks at the floor sees."""
_CLUSTER_M = 3.0
"""Things within cells of this size lean together: longer than a shelf, so that neighbours hardly share their lean."""
_VAGUE_RAD = np.deg2rad(0.5)
"""A mount measured by hand is as certain as this."""
_BORDER_SHARE = 0.9
_MOST_CHECKED = 500
_SURE = 13.8  # squared Mahalanobis distance in two dimensions that chance exceeds in 0.1 % of the cases
_BELIEVED = 1.0  # within one sigma of what is believed the filter reckons with the error

LoadImage = Callable[[int], NDArray[np.uint8]]


@dataclass(frozen=True, slots=True, eq=False)
class LogMount:
    """Tilt and roll over F images: (2,) rad each, cov: (2, 2).

    lines, vertical: how many lines there were, and how many of them are vertical edges. plumb_sigma: rad, how far
    edges are from plumb. places: number of clusters that count as independent.
    """

    stated: Array
    mount: Array
    cov: Array
    lines: int
    vertical: float
    plumb_sigma: float
    places: int

    @property
    def sigma(self) -> Array:
        """The sigma (2,) of tilt and roll."""
        return np.sqrt(np.diag(self.cov))

    @property
    def problem(self) -> str:
        """What is doubtful about the result, for people; empty when nothing is."""
        vague = [name for name, sigma in zip(("tilt", "roll"), self.sigma, strict=True) if sigma > _VAGUE_RAD]
        if vague:
            return (
                f"The images hardly tell the {' and the '.join(vague)}: that needs vertical edges, for the tilt some "
                "far to the left and right in the image."
            )
        if np.any(np.abs(self.mount - self.stated) > _BORDER_SHARE * REACH_SIGMA * PRIOR_SIGMA_RAD):
            return "This is at the limit of the search: state a tilt and roll nearer to this, and look once more."
        return ""


def mount_of_images(
    load: LoadImage,
    poses: Array,
    camera: Camera,
    parameters: EdgeParameters,
    progress: Callable[[], None] = lambda: None,
    twist_of: Callable[[int], Twist | None] = lambda _: None,
) -> LogMount:
    """Return tilt and roll of `camera` over images 0 … F - 1, starting from a stated mount that may be degrees off.

    poses: (F, 3) of the robot, as odometry has them: what stands at one place shares its lean. The detector looks
    along the columns of an image from which the stated mount is undone, so that is brought up to date on a few images
    first. `progress` is called once per image of the last pass. twist_of: how the robot moved at an image, see
    `find_edges`.
    """
    stated = np.array([camera.mount.tilt_rad, camera.mount.roll_rad])
    few = spread(len(poses), _COARSE_IMAGES)
    wide = np.rad2deg(PRIOR_SIGMA_RAD)
    searching = replace(parameters, tilt_sigma_deg=float(wide[0]), roll_sigma_deg=float(wide[1]))
    present = stated
    for _ in range(_COARSE_PASSES):
        lines = _lines_at(present, load, few, camera, searching, twist_of=twist_of)
        before, present = present, fit_mount(lines, stated, vote_mount(lines, stated)).mount
        if np.abs(present - before).max() < _SETTLED_RAD:
            break
    lines = _lines_at(present, load, range(len(poses)), camera, parameters, progress, twist_of)
    return mount_of_lines(lines, poses, camera, stated)


def _lines_at(
    mount: Array,
    load: LoadImage,
    images: Sequence[int],
    camera: Camera,
    parameters: EdgeParameters,
    progress: Callable[[], None] = lambda: None,
    twist_of: Callable[[int], Twist | None] = lambda _: None,
) -> Lines:
    """Return the lines of some images as the detector finds them with the tilt and roll (2,)."""
    turned = camera.with_mount(tilt_rad=float(mount[0]), roll_rad=float(mount[1]))
    parts = []
    for i in images:
        parts.append(lines_of(find_edges(load(i), turned, parameters, twist=twist_of(i)), turned, i))
        progress()
    return Lines.together(parts)


def mount_of_lines(lines: Lines, poses: Array, camera: Camera, stated: Array) -> LogMount:
    """Return tilt and roll from the lines (K) of F images, around the stated (2,).

    poses: (F, 3) of the robot, as odometry has them. camera: where it sits on the robot counts, and not its mount's
    tilt and roll.
    """
    plumb = fit_mount(lines, stated, vote_mount(lines, stated))
    cluster = _cluster_of(
        lines, poses, camera.with_mount(tilt_rad=float(plumb.mount[0]), roll_rad=float(plumb.mount[1]))
    )
    mount, cov = _robust(lines, plumb, cluster)
    return LogMount(
        stated=stated,
        mount=mount,
        cov=cov,
        lines=len(lines),
        vertical=float(plumb.vertical.sum()),
        plumb_sigma=plumb.plumb_sigma,
        places=int(cluster.max(initial=-1)) + 1,
    )


def _cluster_of(lines: Lines, poses: Array, camera: Camera) -> NDArray[np.int64]:
    """Return the cluster (K,) of each line: the cell of the floor, `_RANGE_M` along its ray, where its edge stands."""
    if not len(lines):
        return np.zeros(0, dtype=np.int64)
    eyes = camera.pose_in_map(poses)[lines.frame]
    right, _, back = (lines.normal @ camera.level_from_camera.T).T
    cos, sin = np.cos(eyes[:, 2]), np.sin(eyes[:, 2])
    ahead = np.stack([cos * back - sin * right, -cos * right - sin * back], axis=-1)
    ahead *= np.where(right < 0, -1.0, 1.0)[:, None] / np.maximum(np.hypot(right, back), 1e-12)[:, None]
    cell = np.floor((eyes[:, :2] + _RANGE_M * ahead) / _CLUSTER_M).astype(np.int64)
    return np.unique(cell, axis=0, return_inverse=True)[1].reshape(-1)


def _robust(lines: Lines, plumb: Plumb, cluster: NDArray[np.int64]) -> tuple[Array, Array]:
    """Return tilt and roll (2,) with each cluster counted as one image of it, and their covariance (2, 2).

    With c a cluster, G of them, J the derivative of the misses, w their weights: I = prior + Σ w J Jᵀ, and δ_c the
    step of tilt and roll when c is left out; cov = (G - 1) / G Σ δ_c δ_cᵀ + I⁻¹.
    """
    count = int(cluster.max(initial=-1)) + 1
    images = np.bincount(np.unique(np.stack([cluster, lines.frame]), axis=1)[0], minlength=count)
    miss, per_mount, sigma = lines.misses(plumb.mount)
    weight = plumb.vertical / (sigma**2 + plumb.plumb_sigma**2) / images[cluster]
    own = np.zeros((count, 2, 2))
    np.add.at(own, cluster, weight[:, None, None] * per_mount[:, :, None] * per_mount[:, None, :])
    information = np.diag(PRIOR_SIGMA_RAD**-2) + own.sum(axis=0)
    cov = np.asarray(np.linalg.inv(information))
    step = -cov @ per_mount.T @ (weight * miss)
    left = weight * (miss + per_mount @ step)
    pull = np.stack([np.bincount(cluster, left * by, count) for by in per_mount.T], axis=-1)
    without = np.linalg.solve(information - own, pull[:, :, None])[:, :, 0]
    return plumb.mount + step, cov + without.T @ without * (count - 1) / max(count, 1)


def spread(count: int, most: int) -> list[int]:
    """Return at most `most` indices, evenly spread over 0 … count - 1."""
    return [int(i) for i in np.unique(np.linspace(0, count - 1, min(count, most)).round())]


# -- the check of a run -----------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, eq=False)
class MountCheck:
    """What the edges of a run say about tilt and roll: stated (2,), found (2,), cov (2, 2), rad.

    disagrees: that stated and found differ is sure, and it is more than the sigma of the stated one.
    """

    stated: Array
    found: Array
    cov: Array
    disagrees: bool

    @property
    def sigma(self) -> Array:
        """The sigma (2,) of what was found."""
        return np.sqrt(np.diag(self.cov))

    def warning(self, log: Path) -> str | None:
        """Return what to tell people of the log at a path, None where found and stated agree."""
        if not self.disagrees:
            return None
        stated, found, sigma = (np.rad2deg(values) for values in (self.stated, self.found, self.sigma))
        return (
            f"The edges say that the camera's tilt is {found[0]:.2f}° ± {sigma[0]:.2f}° and its roll {found[1]:.2f}° ± "
            f"{sigma[1]:.2f}°; stated are {stated[0]:.2f}° and {stated[1]:.2f}°. See `localiser camera tilt {log}`."
        )


def check_mount(frames: Sequence[Edges], poses: Array, camera: Camera, stated_sigma_rad: Array) -> MountCheck:
    """Return what the edges of F images, taken at poses (F, 3) of the odometry, say about the mount of `camera`.

    stated_sigma_rad: (2,) how certain the stated tilt and roll are taken to be.
    """
    stated = np.array([camera.mount.tilt_rad, camera.mount.roll_rad])
    used = spread(len(frames), _MOST_CHECKED) if frames else []
    lines = Lines.together([lines_of(frames[image], camera, index) for index, image in enumerate(used)])
    found = mount_of_lines(lines, poses[used], camera, stated)
    off = found.mount - stated
    sure = off @ np.linalg.solve(found.cov, off) > _SURE
    beyond = off @ np.linalg.solve(found.cov + np.diag(stated_sigma_rad**2), off) > _BELIEVED
    return MountCheck(stated, found.mount, found.cov, bool(sure and beyond))
