"""Calibration by a board, chessboard or ChArUco: its corners in images, and the camera that saw them so.

A ChArUco board, a chessboard with markers, may be seen in part. The camera is focal length, principal point and lens
distortion, with what is uncertain about them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from localiser.calibration.mount import mount_from_down
from localiser.camera import Camera, Mount
from localiser.errors import InputError
from localiser.geometry import Array

# -- the board --------------------------------------------------------------------------------------------------------

BoardKind = Literal["charuco", "chessboard"]
FEWEST_CORNERS = 8
"""A view with fewer corners than this says hardly more than where the board is."""
_MARGIN_SQUARES = 0.5
_UNTIL = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 50, 1e-4)
_DICTIONARY_PREFIX = "DICT_"


@dataclass(frozen=True, slots=True, eq=False)
class BoardView:
    """Corners of the board in one image. corners_m: (C, 3) on the board, z = 0; corners_px: (C, 2) in the image."""

    name: str
    corners_m: Array
    corners_px: Array


@dataclass(frozen=True, slots=True)
class Board:
    """A board of columns × rows squares; the chessboard's corners are those inside, (columns - 1) × (rows - 1).

    square_m: side of a square. marker_m: side of a ChArUco marker, dictionary: which markers, such as 5X5_100;
    legacy: pattern of OpenCV before 4.6. Raises InputError for a board that does not exist.
    """

    kind: BoardKind
    columns: int
    rows: int
    square_m: float
    marker_m: float = 0.0
    dictionary: str = "5X5_100"
    legacy: bool = False

    def __post_init__(self) -> None:
        if min(self.columns, self.rows) < 3 or max(self.columns, self.rows) > 100:
            raise InputError(f"expected 3 to 100 squares each way, found {self.size}", field="--squares")
        if not 1e-4 <= self.square_m <= 10:
            raise InputError(f"expected 0.0001 to 10 m, found {self.square_m:g}", field="--square-m")
        if self.kind == "chessboard":
            return
        if not 0 < self.marker_m < self.square_m:
            problem = f"expected more than 0 and less than a square's {self.square_m:g} m, found {self.marker_m:g}"
            raise InputError(problem, field="--marker-m")
        names = dictionaries()
        if self.dictionary not in names:
            raise InputError(f"expected one of {', '.join(names)}, found {self.dictionary!r}", field="--dictionary")
        have, need = len(self._markers().bytesList), self.columns * self.rows // 2
        if have < need:
            problem = f"expected at least {need} markers for {self.size} squares, found {have} in {self.dictionary}"
            raise InputError(problem, field="--dictionary")

    @property
    def size(self) -> str:
        """Columns × rows as people write it."""
        return f"{self.columns}x{self.rows}"

    def find(self, image: NDArray[np.uint8], name: str = "") -> BoardView | None:
        """Return the board's corners in a grey image (H, W), or None when there are too few to be of use."""
        corners_m, corners_px = self._charuco(image) if self.kind == "charuco" else self._chessboard(image)
        return BoardView(name, corners_m, corners_px) if len(corners_px) >= FEWEST_CORNERS else None

    def picture(self, square_px: int) -> NDArray[np.uint8]:
        """Return the board as a picture with a white margin of half a square around it. Raises InputError."""
        margin = round(_MARGIN_SQUARES * square_px)
        if self.kind == "charuco":
            size = (self.columns * square_px, self.rows * square_px)
            try:
                board = np.asarray(self._charuco_board().generateImage(size, marginSize=0), dtype=np.uint8)
            except cv2.error:  # too few pixels for a marker's cells, or one that it rounds out of its square
                problem = f"expected markers that OpenCV can draw, such as of {0.75 * self.square_m:g} m"
                raise InputError(f"{problem}, found {self.marker_m:g}", field="--marker-m") from None
        else:
            odd = np.add.outer(np.arange(self.rows), np.arange(self.columns)) % 2
            board = np.kron(odd, np.ones((square_px, square_px))).astype(np.uint8) * 255
        return np.pad(board, margin, constant_values=255)

    def picture_size_m(self) -> tuple[float, float]:
        """Return width and height of the picture, margin included."""
        return (self.columns + 2 * _MARGIN_SQUARES) * self.square_m, (self.rows + 2 * _MARGIN_SQUARES) * self.square_m

    def _chessboard(self, image: NDArray[np.uint8]) -> tuple[Array, Array]:
        size = (self.columns - 1, self.rows - 1)
        flags = cv2.CALIB_CB_EXHAUSTIVE | cv2.CALIB_CB_ACCURACY | cv2.CALIB_CB_NORMALIZE_IMAGE
        found, corners = cv2.findChessboardCornersSB(image, size, flags=flags)
        if not found:
            return np.zeros((0, 3)), np.zeros((0, 2))
        column, row = np.meshgrid(np.arange(1, self.columns), np.arange(1, self.rows))
        on_board = np.stack([column, row, np.zeros_like(column)], axis=-1).reshape(-1, 3).astype(np.float64)
        return on_board * self.square_m, np.asarray(corners, dtype=np.float64).reshape(-1, 2)

    def _charuco(self, image: NDArray[np.uint8]) -> tuple[Array, Array]:
        board = self._charuco_board()
        corners, ids, _, _ = cv2.aruco.CharucoDetector(board).detectBoard(image)
        if ids is None or len(ids) == 0:
            return np.zeros((0, 3)), np.zeros((0, 2))
        on_board = np.asarray(board.getChessboardCorners(), dtype=np.float64)[np.ravel(ids)]
        return on_board, self._refined(np.asarray(corners, dtype=np.float64).reshape(-1, 2), image)

    def _refined(self, corners_px: Array, image: NDArray[np.uint8]) -> Array:
        """Return corners (C, 2) where the gradients around them say, from no further than the markers are.

        Measured on rendered views this leaves a fifth of the error of the detector's own refinement.
        """
        apart = np.linalg.norm(corners_px[:, None] - corners_px, axis=-1) + np.diag(np.full(len(corners_px), np.inf))
        square_px = float(np.quantile(apart.min(axis=1), 0.1)) if len(corners_px) > 1 else 0.0
        gap_px = square_px * (1 - self.marker_m / self.square_m) / 2
        reach = int(np.clip(gap_px, 2, 6))
        found = cv2.cornerSubPix(image, corners_px.astype(np.float32), (reach, reach), (-1, -1), _UNTIL)
        return np.asarray(found, dtype=np.float64).reshape(-1, 2)

    def _charuco_board(self) -> Any:
        board = cv2.aruco.CharucoBoard((self.columns, self.rows), self.square_m, self.marker_m, self._markers())
        board.setLegacyPattern(self.legacy)
        return board

    def _markers(self) -> Any:
        return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, _DICTIONARY_PREFIX + self.dictionary))


def dictionaries() -> list[str]:
    """Return the names of the known sets of markers."""
    names = (name.removeprefix(_DICTIONARY_PREFIX) for name in dir(cv2.aruco) if name.startswith(_DICTIONARY_PREFIX))
    return sorted({name.replace("h", "H") if name.startswith("APRILTAG") else name for name in names})


# -- the camera -------------------------------------------------------------------------------------------------------

FEWEST_VIEWS = 3
_COEFFICIENTS = {
    "none": (),
    "plumb_bob": ("k1", "k2", "p1", "p2", "k3"),
    "rational_polynomial": ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"),
    "equidistant": ("k1", "k2", "k3", "k4"),
}
_NO_LENS = cv2.CALIB_ZERO_TANGENT_DIST | cv2.CALIB_FIX_K1 | cv2.CALIB_FIX_K2 | cv2.CALIB_FIX_K3
_EARNS_ITS_PLACE_SIGMA = 3.0
_LEAST_TURNED_DEG = 10.0
"""A board that faces the camera looks the same from near through a short lens and from far through a long one."""
_OUTLIER_RATIO = 3.0
_STEP = 1e-6


@dataclass(frozen=True, slots=True, eq=False)
class Intrinsics:
    """A camera from V views. camera: its mount means nothing. parameters, values, sigma: (P,) what was found, in px.

    poses, pose_sigma: (V, 6) rotation vector and position (m) of the board in OpenCV's camera frame (right, down,
    forward). Sigmas are nan for a fisheye lens. rms_px: of all corners; view_rms_px: (V,) of each view's.
    reach: how far from the centre corners were seen, as a share of the distance to the image's furthest corner.
    """

    camera: Camera
    views: tuple[BoardView, ...]
    parameters: tuple[str, ...]
    values: Array
    sigma: Array
    poses: Array
    pose_sigma: Array
    rms_px: float
    view_rms_px: Array
    reach: float

    @property
    def outliers(self) -> list[str]:
        """The names of the views that fit much worse than the others."""
        limit = _OUTLIER_RATIO * float(np.median(self.view_rms_px))
        return [view.name for view, rms in zip(self.views, self.view_rms_px, strict=True) if rms > limit]


def calibrate(views: Sequence[BoardView], size: tuple[int, int], lens: str = "plumb_bob") -> Intrinsics:
    """Return the camera that took the views of a board, size: (width, height) px, lens: as ROS names it, or none.

    The highest coefficient of plumb_bob, k3, is 0 unless the views tell it: it would bend the image's corners.
    Raises InputError when there are too few views or they do not tell the focal length.
    """
    if len(views) < FEWEST_VIEWS:
        raise InputError(f"expected the board in at least {FEWEST_VIEWS} images, found it in {len(views)}")
    found = _calibrated(tuple(views), size, lens, _COEFFICIENTS[lens])
    if lens == "plumb_bob" and not abs(found.values[-1]) > _EARNS_ITS_PLACE_SIGMA * found.sigma[-1]:
        found = _calibrated(tuple(views), size, lens, _COEFFICIENTS[lens][:-1])
    normals = np.array([cv2.Rodrigues(pose[:3])[0][:, 2] for pose in found.poses])
    turned_deg = float(np.rad2deg(np.arccos(np.clip((normals @ normals.T).min(), -1.0, 1.0))))
    if turned_deg < _LEAST_TURNED_DEG:
        raise InputError(
            f"the views do not tell the focal length: the board is turned by {turned_deg:.1f}° at most; take images "
            "with the board turned by 20° to 50° to the left, right, forward and back"
        )
    return found


def _calibrated(
    views: tuple[BoardView, ...], size: tuple[int, int], lens: str, coefficients: tuple[str, ...]
) -> Intrinsics:
    threads = cv2.getNumThreads()
    cv2.setNumThreads(1)  # several add up in another order each time
    try:
        matrix, distortion, poses, sigma, pose_sigma = _minimised(views, size, lens, coefficients)
    except cv2.error as error:
        problem = f"the views do not tell the camera ({' '.join(str(error.err).split())}); take others, at more angles"
        raise InputError(problem) from None
    finally:
        cv2.setNumThreads(threads)
    parameters = ("fx", "fy", "cx", "cy", *coefficients)
    values = np.array([matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2], *distortion[: len(coefficients)]])
    fx, fy, cx, cy, *found = (float(value) for value in values)
    missing = len(_COEFFICIENTS[lens]) - len(found)
    camera = Camera(*size, fx, fy, cx, cy, Mount(tilt_rad=0.0, height_m=1.0), lens, (*found, *[0.0] * missing))
    squares = np.empty(len(views))
    for index, (view, pose) in enumerate(zip(views, poses, strict=True)):
        points = view.corners_m @ cv2.Rodrigues(pose[:3])[0].T + pose[3:]
        off_px = camera.pixels_from_image(points[:, :2] / points[:, 2:] * [1.0, -1.0]) - view.corners_px
        squares[index] = (off_px**2).sum(axis=1).mean()
    corners = np.array([len(view.corners_px) for view in views])
    centre = np.array([camera.cx, camera.cy])
    rim = np.array([[u, v] for u in (0, camera.width - 1) for v in (0, camera.height - 1)])
    seen = max(float(np.linalg.norm(view.corners_px - centre, axis=1).max()) for view in views)
    return Intrinsics(
        camera=camera,
        views=views,
        parameters=parameters,
        values=values,
        sigma=sigma[: len(parameters)],
        poses=poses,
        pose_sigma=pose_sigma,
        rms_px=float(np.sqrt(squares @ corners / corners.sum())),
        view_rms_px=np.sqrt(squares),
        reach=seen / float(np.linalg.norm(rim - centre, axis=1).max()),
    )


def _minimised(
    views: tuple[BoardView, ...], size: tuple[int, int], lens: str, coefficients: tuple[str, ...]
) -> tuple[Array, Array, Array, Array, Array]:
    """Return camera matrix (3, 3), coefficients (D,), board poses (V, 6), and the sigmas of parameters and poses."""
    if lens == "equidistant":
        on_board = [view.corners_m.reshape(1, -1, 3) for view in views]
        in_image = [view.corners_px.reshape(1, -1, 2) for view in views]
        flags = _fisheye_flag("CALIB_RECOMPUTE_EXTRINSIC") | _fisheye_flag("CALIB_FIX_SKEW")
        _, matrix, distortion, turns, places = cv2.fisheye.calibrate(
            on_board, in_image, size, np.eye(3), np.zeros((4, 1)), flags=flags
        )
        sigma, pose_sigma = np.full(4 + len(coefficients), np.nan), np.full((len(views), 6), np.nan)
    else:
        flags = {"none": _NO_LENS, "rational_polynomial": cv2.CALIB_RATIONAL_MODEL}.get(lens, 0)
        flags |= 0 if "k3" in coefficients else cv2.CALIB_FIX_K3
        _, matrix, distortion, turns, places, sigma, pose_sigma, _ = cv2.calibrateCameraExtended(
            [view.corners_m.astype(np.float32) for view in views],
            [view.corners_px.astype(np.float32) for view in views],
            size,
            np.eye(3),
            np.zeros(5),
            flags=flags,
        )
    poses = np.concatenate([np.reshape(turns, (-1, 3)), np.reshape(places, (-1, 3))], axis=1)
    return np.asarray(matrix), np.ravel(distortion), poses, np.ravel(sigma), np.reshape(pose_sigma, (-1, 6))


def _fisheye_flag(name: str) -> int:
    # OpenCV 5 has one set of flags, 4 another one for cv2.fisheye.
    return int(getattr(cv2.fisheye, name, None) or getattr(cv2, name))


@dataclass(frozen=True, slots=True, eq=False)
class FloorMount:
    """Where the camera is above a board that lies on the floor: tilt, roll (rad), height (m), values and sigma (3,)."""

    values: Array
    sigma: Array


def mount_over_board(intrinsics: Intrinsics, view: int) -> FloorMount:
    """Return tilt, roll and height of the camera over the board of one view, which lies flat on the floor."""
    pose, sigma = intrinsics.poses[view], intrinsics.pose_sigma[view]
    steps = np.diag(_STEP * np.maximum(np.abs(pose), 1.0))
    by_pose = np.stack([(_over_board(pose + step) - _over_board(pose - step)) / (2 * step.sum()) for step in steps])
    return FloorMount(_over_board(pose), np.sqrt((sigma**2) @ by_pose**2))


def _over_board(pose: Array) -> Array:
    """Return tilt, roll and height (3,) over a board at `pose` (6,): down is its normal, away from the camera."""
    normal = cv2.Rodrigues(pose[:3])[0][:, 2]
    height = float(normal @ pose[3:])
    down = np.sign(height) * normal * [1.0, -1.0, -1.0]
    return np.array([*mount_from_down(down), abs(height)])
