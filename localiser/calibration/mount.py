"""Tilt and roll from image lines: the direction of down that most of them agree on, over all images of a log.

Things that stand together lean together: books on a shelf, posts of a rack. However many images show them, their lean
is one error. So lines are put into clusters by the place where what they show stands, and the covariance is that of
the cluster-robust (sandwich) estimator in the form of the delete-a-cluster jackknife [Cameron, Miller 2015], plus the
covariance of the lines themselves with each cluster counted as one image of it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from localiser.camera import Camera
from localiser.edges import EdgeParameters, Edges, find_edges
from localiser.geometry import Array, Twist

# -- lines as planes through the camera's centre ----------------------------------------------------------------------

_END_SIGMA_PX = 0.5  # error across the line of an end of a segment that was rejected and so not measured further
_SHORTEST_PX = 2.0
PRIOR_SIGMA_RAD = np.deg2rad([5.0, 3.0])
"""How far stated tilt and roll are off at most, one sigma: so wide that it decides only what no edge tells."""
REACH_SIGMA = 2.5
"""Down is looked for as many of these sigmas around what is stated."""
_GRID_RAD = np.deg2rad(0.5)
_WIDEST_MISS_RAD = np.deg2rad(10.0)
"""Lines that are no vertical edges miss down by anything up to this, each value as likely."""
_LEAST_PLUMB_RAD = np.deg2rad(0.02)  # nothing is built, and no lens calibrated, better than this
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
        tilt, roll = np.asarray(mount, dtype=np.float64)
        by_tilt = [-np.sin(tilt) * np.sin(roll), np.sin(tilt) * np.cos(roll), -np.cos(tilt)]
        by_roll = [np.cos(tilt) * np.cos(roll), np.cos(tilt) * np.sin(roll), 0.0]
        down, per_mount = down_in_camera(mount), np.stack([by_tilt, by_roll], axis=-1)
        return self.normal @ down, self.normal @ per_mount, self.sigma * np.abs(self.per_turn @ down)


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


# -- tilt and roll -----------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, eq=False)
class Plumb:
    """What lines (K) say about tilt and roll.

    mount: (2,) rad. plumb_sigma: rad, how far vertical edges are from plumb beyond the error of measuring them.
    vertical: (K,) probability that a line is a vertical edge.
    """

    mount: Array
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


def fit_mount(lines: Lines, stated: Array, start: Array) -> Plumb:
    """Return what lines (K) say about tilt and roll, from a `start` (2,) near it, with the prior N(stated, PRIOR²).

    p(miss) = v N(0, sigma² + plumb_sigma²) + (1 - v) uniform, by expectation maximisation over which lines are
    vertical; v and plumb_sigma are found as well. With known weights this is design equation 10: the direction whose
    squared misses sum to the least.
    """
    prior = np.diag(PRIOR_SIGMA_RAD**-2)
    mount, share, plumb = start, 0.5, _GRID_RAD / 2
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
            precise = vertical / variance**2
            excess = float((precise * (miss**2 - sigma**2)).sum() / max(float(precise.sum()), 1e-300))
            plumb = float(np.sqrt(max(excess, _LEAST_PLUMB_RAD**2)))
        if np.abs(step).max() < _CONVERGED_RAD:
            break
    return Plumb(mount, plumb, vertical)


# -- all images of a log ----------------------------------------------------------------------------------------------

_COARSE_IMAGES = 60
_COARSE_PASSES = 4
_SETTLED_RAD = np.deg2rad(0.1)  # a mount this near shows the edge detector the same lines
_RANGE_M = 2.5  # how far away things are that a camera which looks at the floor sees
_CLUSTER_M = 3.0
"""Things within cells of this size lean together: longer than a shelf, so that neighbours hardly share their lean."""
_VAGUE_RAD = np.deg2rad(0.5)  # a mount measured by hand is as certain as this
_BORDER_SHARE = 0.9
_MOST_CHECKED = 500
_SURE = 13.8  # squared Mahalanobis distance in two dimensions that chance exceeds in 0.1 % of the cases
_BELIEVED = 1.0  # within one sigma of what is believed the filter reckons with the error

LoadImage = Callable[[int], NDArray[np.uint8]]


@dataclass(frozen=True, slots=True, eq=False)
class LogMount:
    """Tilt and roll over F images: (2,) rad each, cov: (2, 2).

    lines, vertical: how many lines there were, and how many of them are vertical edges. places: number of clusters that
    count as independent. disagrees: that this and what is stated differ is sure, and it is more than the sigma of the
    stated one; see `check_mount`.
    """

    stated: Array
    mount: Array
    cov: Array
    lines: int
    vertical: float
    places: int
    disagrees: bool = False

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

    def warning(self, log: Path) -> str | None:
        """Return what to tell people of the log at a path, None where found and stated agree."""
        if not self.disagrees:
            return None
        stated, found, sigma = (np.rad2deg(values) for values in (self.stated, self.mount, self.sigma))
        return (
            f"The edges say that the camera's tilt is {found[0]:.2f}° ± {sigma[0]:.2f}° and its roll {found[1]:.2f}° ± "
            f"{sigma[1]:.2f}°; stated are {stated[0]:.2f}° and {stated[1]:.2f}°. See `localiser camera tilt {log}`."
        )


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
    camera = camera.with_mount(tilt_rad=float(plumb.mount[0]), roll_rad=float(plumb.mount[1]))
    # The cell of the floor, `_RANGE_M` along the ray of each line (K,), where its edge stands.
    eyes = camera.pose_in_map(poses)[lines.frame]
    right, _, back = (lines.normal @ camera.level_from_camera.T).T
    cos, sin = np.cos(eyes[:, 2]), np.sin(eyes[:, 2])
    ahead = np.stack([cos * back - sin * right, -cos * right - sin * back], axis=-1)
    ahead *= np.where(right < 0, -1.0, 1.0)[:, None] / np.maximum(np.hypot(right, back), 1e-12)[:, None]
    cell = np.floor((eyes[:, :2] + _RANGE_M * ahead) / _CLUSTER_M).astype(np.int64)
    cluster = np.unique(cell, axis=0, return_inverse=True)[1].reshape(-1)
    mount, cov = _robust(lines, plumb, cluster)
    return LogMount(
        stated=stated,
        mount=mount,
        cov=cov,
        lines=len(lines),
        vertical=float(plumb.vertical.sum()),
        places=int(cluster.max(initial=-1)) + 1,
    )


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


def check_mount(edges_of: Callable[[int], Edges], poses: Array, camera: Camera, stated_sigma_rad: Array) -> LogMount:
    """Return what the edges of F images, taken at poses (F, 3) of the odometry, say about the mount of `camera`.

    edges_of: gives the edges of an image by its index. stated_sigma_rad: (2,) how certain the stated tilt and roll are
    taken to be.
    """
    stated = np.array([camera.mount.tilt_rad, camera.mount.roll_rad])
    used = spread(len(poses), _MOST_CHECKED) if len(poses) else []
    lines = Lines.together([lines_of(edges_of(image), camera, index) for index, image in enumerate(used)])
    found = mount_of_lines(lines, poses[used], camera, stated)
    off = found.mount - stated
    sure = off @ np.linalg.solve(found.cov, off) > _SURE
    beyond = off @ np.linalg.solve(found.cov + np.diag(stated_sigma_rad**2), off) > _BELIEVED
    return replace(found, disagrees=bool(sure and beyond))
