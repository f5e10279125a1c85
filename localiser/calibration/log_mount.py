"""Tilt and roll over a log: all lines of all images together, with a sigma that counts what leans together once."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from localiser.calibration.lean import mount_with_leans
from localiser.calibration.lines import Lines, lines_of
from localiser.calibration.plumb import PRIOR_SIGMA_RAD, REACH_SIGMA, fitted, voted
from localiser.camera import Camera
from localiser.edges import EdgeParameters, find_edges
from localiser.geometry import Array, Twist, wrap_angle

_COARSE_IMAGES = 60
_COARSE_PASSES = 4
_SETTLED_RAD = np.deg2rad(0.1)
"""A mount this near shows the edge detector the same lines."""
_NEW_VIEW_M, _NEW_VIEW_RAD = 1.0, np.deg2rad(30.0)
"""After moving or turning this far most edges in view are other ones, or are seen elsewhere in the image."""
_FEWEST_VIEWS = 5
_VAGUE_RAD = np.deg2rad(0.5)
"""A mount measured by hand is as certain as this."""
_BORDER_SHARE = 0.9
_TELLS = 0.5
"""An image whose sigma is this share of the prior's tells little but the prior."""
_WILD = 5.0
"""An image that is off by more than this many sigmas took something else for vertical, and speaks for no other."""

LoadImage = Callable[[int], NDArray[np.uint8]]


@dataclass(frozen=True, slots=True, eq=False)
class LogMount:
    """Tilt and roll over F images: (2,) rad each.

    cov: (2, 2). image_mount, image_cov: (F, 2), (F, 2, 2) what each image says by itself, as certain as images prove to
    be; where it says nothing, the mean over all with the sigma of the prior. lines, vertical: how many lines there
    were, and how many of them are vertical edges. plumb_sigma: rad, how far edges are from plumb. row_sigma: rad, how
    far all that stands in one row is, one sigma for each direction. views: number of different views.
    """

    stated: Array
    mount: Array
    cov: Array
    image_mount: Array
    image_cov: Array
    lines: int
    vertical: float
    plumb_sigma: float
    row_sigma: float
    views: int

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

    poses: (F, 3) of the robot, as odometry has them: what is seen from one place shares its lean. The detector looks
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
        before, present = present, fitted(lines, stated, voted(lines, stated)).mount
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
    whole = fitted(lines, stated, voted(lines, stated))
    leaning = mount_with_leans(lines, whole, poses, camera, stated)
    views, count = views_of(poses), len(poses)
    each = [fitted(lines.take(lines.frame == i), leaning.mount, leaning.mount, whole.plumb_sigma) for i in range(count)]
    image_mount = np.array([image.mount for image in each]).reshape(-1, 2)
    image_cov = np.array([image.cov for image in each]).reshape(-1, 2, 2)
    return LogMount(
        stated=stated,
        mount=leaning.mount,
        cov=leaning.cov,
        image_mount=image_mount,
        image_cov=as_scattered(image_mount - leaning.mount, image_cov, views),
        lines=len(lines),
        vertical=float(whole.vertical.sum()),
        plumb_sigma=whole.plumb_sigma,
        row_sigma=leaning.row,
        views=len(np.unique(views)),
    )


def as_scattered(off: Array, cov: Array, views: NDArray[np.int64]) -> Array:
    """Return the covariances (F, 2, 2) of images, grown alike until they cover how far images are off (F, 2) the mean.

    Both sides of a post or a door's frame err alike, and furniture tapers, so that the few long lines that decide in
    one image err by more than each by itself. How much more is the building's: it is seen where there are views enough.
    """
    sigma = np.sqrt(np.diagonal(cov, axis1=1, axis2=2))
    tells = np.asarray(np.all(sigma < _TELLS * PRIOR_SIGMA_RAD, axis=1))
    if len(np.unique(views[tells])) < _FEWEST_VIEWS:
        return cov
    squared = np.minimum((off[tells] / sigma[tells]) ** 2, _WILD**2)
    growth = np.sqrt(np.maximum(squared.mean(axis=0), 1.0))
    return np.asarray(np.where(tells[:, None, None], cov * np.outer(growth, growth), cov))


def views_of(poses: Array) -> NDArray[np.int64]:
    """Return which view (F,) images belong to that were taken at poses (F, 3): a new one begins after moving on."""
    views = np.zeros(len(poses), dtype=np.int64)
    since = 0
    for i in range(1, len(poses)):
        moved = np.hypot(*(poses[i, :2] - poses[since, :2]))
        turned = abs(float(wrap_angle(poses[i, 2] - poses[since, 2])))
        views[i] = views[i - 1]
        if moved > _NEW_VIEW_M or turned > _NEW_VIEW_RAD:
            views[i] += 1
            since = i
    return views


def spread(count: int, most: int) -> list[int]:
    """Return at most `most` indices, evenly spread over 0 … count - 1."""
    return [int(i) for i in np.unique(np.linspace(0, count - 1, min(count, most)).round())]
