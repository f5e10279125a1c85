"""Focal length, principal point and lens distortion from views of a board, with what is uncertain about them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from localiser.calibration.board import BoardView
from localiser.calibration.lines import mount_from_down
from localiser.camera import Camera, Mount
from localiser.errors import InputError
from localiser.geometry import Array

FEWEST_VIEWS = 3
_COEFFICIENTS = {
    "none": (),
    "plumb_bob": ("k1", "k2", "p1", "p2", "k3"),
    "rational_polynomial": ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"),
    "equidistant": ("k1", "k2", "k3", "k4"),
}
_NO_LENS = cv2.CALIB_ZERO_TANGENT_DIST | cv2.CALIB_FIX_K1 | cv2.CALIB_FIX_K2 | cv2.CALIB_FIX_K3
_EARNS_ITS_PLACE_SIGMA = 3.0
_VAGUE_FOCAL = 0.05
_OUTLIER_RATIO = 3.0
_STEP = 1e-6


@dataclass(frozen=True, slots=True, eq=False)
class Intrinsics:
    """A camera from V views. camera: its mount means nothing. parameters, values, sigma: (P,) what was found, in px.

    poses: (V, 6) rotation vector and position (m) of the board in OpenCV's camera frame (right, down, forward).
    cov: (P + 6V, P + 6V) of parameters and poses. rms_px: of all corners; view_rms_px: (V,) of each view's.
    reach: how far from the centre corners were seen, as a share of the distance to the image's furthest corner.
    """

    camera: Camera
    views: tuple[BoardView, ...]
    parameters: tuple[str, ...]
    values: Array
    poses: Array
    cov: Array
    rms_px: float
    view_rms_px: Array
    reach: float

    @property
    def sigma(self) -> Array:
        """The sigma (P,) of the parameters."""
        return np.sqrt(np.diag(self.cov)[: len(self.parameters)])

    @property
    def outliers(self) -> list[str]:
        """The names of the views that fit much worse than the others."""
        limit = _OUTLIER_RATIO * float(np.median(self.view_rms_px))
        return [view.name for view, rms in zip(self.views, self.view_rms_px, strict=True) if rms > limit]


def calibrated(views: Sequence[BoardView], size: tuple[int, int], lens: str = "plumb_bob") -> Intrinsics:
    """Return the camera that took the views of a board, size: (width, height) px, lens: as ROS names it, or none.

    The highest coefficient of plumb_bob, k3, is 0 unless the views tell it: it would bend the image's corners.
    Raises InputError when there are too few views or they do not tell the focal length.
    """
    if len(views) < FEWEST_VIEWS:
        raise InputError(f"expected the board in at least {FEWEST_VIEWS} images, found it in {len(views)}")
    found = _calibrated(tuple(views), size, lens, _COEFFICIENTS[lens])
    if lens == "plumb_bob" and not abs(found.values[-1]) > _EARNS_ITS_PLACE_SIGMA * found.sigma[-1]:
        found = _calibrated(tuple(views), size, lens, _COEFFICIENTS[lens][:-1])
    share = found.sigma[:2] / found.values[:2]
    if not np.all(share < _VAGUE_FOCAL):
        raise InputError(
            f"the views do not tell the focal length: it would be certain to {100 * np.nanmax(share):.0f} % only; take "
            "images with the board turned by 20° to 50° to the left, right, forward and back"
        )
    return found


def _calibrated(
    views: tuple[BoardView, ...], size: tuple[int, int], lens: str, coefficients: tuple[str, ...]
) -> Intrinsics:
    try:
        matrix, distortion, poses = _minimised(views, size, lens, coefficients)
    except cv2.error as error:
        problem = f"the views do not tell the camera ({' '.join(str(error.err).split())}); take others, at more angles"
        raise InputError(problem) from None
    parameters = ("fx", "fy", "cx", "cy", *coefficients)
    values = np.array([matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2], *distortion[: len(coefficients)]])
    camera = _camera(values, size, lens)
    residuals = [_projected(camera, view, pose) - view.corners_px for view, pose in zip(views, poses, strict=True)]
    squares = np.array([float((residual**2).sum(axis=1).mean()) for residual in residuals])
    corners = np.array([len(view.corners_px) for view in views])
    degrees_of_freedom = max(2 * int(corners.sum()) - len(parameters) - 6 * len(views), 1)
    variance = float(squares @ corners) / degrees_of_freedom
    return Intrinsics(
        camera=camera,
        views=views,
        parameters=parameters,
        values=values,
        poses=poses,
        cov=variance * _inverse_information(values, poses, views, size, lens),
        rms_px=float(np.sqrt(squares @ corners / corners.sum())),
        view_rms_px=np.sqrt(squares),
        reach=_reach(views, camera),
    )


def _minimised(
    views: tuple[BoardView, ...], size: tuple[int, int], lens: str, coefficients: tuple[str, ...]
) -> tuple[Array, Array, Array]:
    """Return camera matrix (3, 3), coefficients (D,) and board poses (V, 6) with the least squared error."""
    if lens == "equidistant":
        on_board = [view.corners_m.reshape(1, -1, 3) for view in views]
        in_image = [view.corners_px.reshape(1, -1, 2) for view in views]
        flags = _fisheye_flag("CALIB_RECOMPUTE_EXTRINSIC") | _fisheye_flag("CALIB_FIX_SKEW")
        _, matrix, distortion, turns, places = cv2.fisheye.calibrate(
            on_board, in_image, size, np.eye(3), np.zeros((4, 1)), flags=flags
        )
    else:
        flags = {"none": _NO_LENS, "rational_polynomial": cv2.CALIB_RATIONAL_MODEL}.get(lens, 0)
        flags |= 0 if "k3" in coefficients else cv2.CALIB_FIX_K3
        _, matrix, distortion, turns, places = cv2.calibrateCamera(
            [view.corners_m.astype(np.float32) for view in views],
            [view.corners_px.astype(np.float32) for view in views],
            size,
            np.eye(3),
            np.zeros(5),
            flags=flags,
        )
    poses = np.concatenate([np.reshape(turns, (-1, 3)), np.reshape(places, (-1, 3))], axis=1)
    return np.asarray(matrix), np.ravel(distortion), poses


def _fisheye_flag(name: str) -> int:
    # OpenCV 5 has one set of flags, 4 another one for cv2.fisheye.
    return int(getattr(cv2.fisheye, name, None) or getattr(cv2, name))


def _camera(values: Array, size: tuple[int, int], lens: str) -> Camera:
    fx, fy, cx, cy, *found = (float(value) for value in values)
    missing = len(_COEFFICIENTS[lens]) - len(found)
    anywhere = Mount(tilt_rad=0.0, height_m=1.0)
    return Camera(*size, fx, fy, cx, cy, anywhere, lens, (*found, *[0.0] * missing))


def _projected(camera: Camera, view: BoardView, pose: Array) -> Array:
    """Return the pixels (C, 2) at which `camera` sees the corners of a board at `pose` (6,)."""
    points = view.corners_m @ cv2.Rodrigues(pose[:3])[0].T + pose[3:]
    return camera.pixels_from_image(points[:, :2] / points[:, 2:] * [1.0, -1.0])


def _inverse_information(
    values: Array, poses: Array, views: tuple[BoardView, ...], size: tuple[int, int], lens: str
) -> Array:
    """Return (JᵀJ)⁻¹ of all corners by parameters and poses; J by central differences, each view on its own."""
    count, total = len(values), len(values) + poses.size
    information = np.zeros((total, total))
    for index, (view, pose) in enumerate(zip(views, poses, strict=True)):
        theta = np.concatenate([values, pose])

        def seen(moved: Array, view: BoardView = view) -> Array:
            return _projected(_camera(moved[:count], size, lens), view, moved[count:]).ravel()

        jacobian = _jacobian(seen, theta)
        own = np.r_[:count, count + 6 * index : count + 6 * index + 6]
        information[np.ix_(own, own)] += jacobian.T @ jacobian
    scale = 1 / np.sqrt(np.maximum(np.diag(information), 1e-300))
    return np.asarray(np.linalg.pinv(information * np.outer(scale, scale), hermitian=True) * np.outer(scale, scale))


def _jacobian(function: Callable[[Array], Array], at: Array) -> Array:
    """Return the derivative (F, P) of values (F,) by P parameters, by central differences."""
    steps = np.diag(_STEP * np.maximum(np.abs(at), 1.0))
    return np.stack([(function(at + step) - function(at - step)) / (2 * step.sum()) for step in steps], axis=-1)


def _reach(views: tuple[BoardView, ...], camera: Camera) -> float:
    centre = np.array([camera.cx, camera.cy])
    corners = np.array([[u, v] for u in (0, camera.width - 1) for v in (0, camera.height - 1)])
    seen = max(float(np.linalg.norm(view.corners_px - centre, axis=1).max()) for view in views)
    return seen / float(np.linalg.norm(corners - centre, axis=1).max())


@dataclass(frozen=True, slots=True, eq=False)
class FloorMount:
    """Where the camera is above a board that lies on the floor. values: tilt, roll (rad), height (m); cov: (3, 3)."""

    values: Array
    cov: Array

    @property
    def sigma(self) -> Array:
        """The sigma (3,) of tilt, roll (rad) and height (m)."""
        return np.sqrt(np.diag(self.cov))


def mount_over_board(intrinsics: Intrinsics, view: int) -> FloorMount:
    """Return tilt, roll and height of the camera over the board of one view, which lies flat on the floor.

    Its sigmas hold those of the intrinsics.
    """
    at = len(intrinsics.parameters) + 6 * view
    pose, cov = intrinsics.poses[view], intrinsics.cov[at : at + 6, at : at + 6]
    jacobian = _jacobian(_over_board, pose)
    return FloorMount(_over_board(pose), jacobian @ cov @ jacobian.T)


def _over_board(pose: Array) -> Array:
    """Return tilt, roll and height (3,) over a board at `pose` (6,): down is its normal, away from the camera."""
    normal = cv2.Rodrigues(pose[:3])[0][:, 2]
    height = float(normal @ pose[3:])
    down = np.sign(height) * normal * [1.0, -1.0, -1.0]
    return np.array([*mount_from_down(down), abs(height)])
