"""Images of a calibration board, cast ray by ray through a `Camera` with its lens."""

from functools import lru_cache

import cv2
import numpy as np

from localiser.calibration import Board
from localiser.camera import Camera

SQUARE_PX = 40
SUPERSAMPLING = 3


@lru_cache(maxsize=4)
def fine_rays(camera: Camera) -> np.ndarray:
    """Return rays (H k, W k, 3) through a k times finer grid of pixels: smooth, so interpolated from whole pixels."""
    k, beyond = SUPERSAMPLING, 2
    u, v = (np.arange(-beyond, n + beyond, dtype=np.float64) for n in (camera.width, camera.height))
    ahead = camera.image_from_pixels(np.stack(np.meshgrid(u, v), axis=-1)) * [1.0, -1.0]
    fine = cv2.resize(ahead, None, fx=k, fy=k, interpolation=cv2.INTER_CUBIC)[beyond * k : -beyond * k]
    fine = fine[:, beyond * k : -beyond * k]
    return np.concatenate([fine, np.ones_like(fine[..., :1])], axis=-1)


def board_image(camera: Camera, board: Board, pose, noise_sigma=2.0, seed=0) -> np.ndarray:
    """Return the (H, W) uint8 image of a board at `pose` (6,): rotation vector and place of its first corner.

    The frame is OpenCV's: right, down, forward. The board's x runs along its columns, its y down its rows.
    """
    pose = np.asarray(pose, dtype=np.float64)
    from_board = np.column_stack([cv2.Rodrigues(pose[:3])[0][:, :2], pose[3:]])
    k = SUPERSAMPLING
    on_board = fine_rays(camera) @ np.linalg.inv(from_board).T
    metres = np.where(on_board[..., 2:] > 0, on_board[..., :2] / on_board[..., 2:], -1e6)
    picture = board.picture(SQUARE_PX)
    # The centre of the top-left texel lies half a texel inside the margin, which is half a square wide.
    texel = ((metres / board.square_m + 0.5) * SQUARE_PX - 0.5).clip(-1e4, 1e4).astype(np.float32)
    fine = cv2.remap(picture, texel[..., 0], texel[..., 1], cv2.INTER_LINEAR, borderValue=120).astype(np.float64)
    image = fine.reshape(camera.height, k, camera.width, k).mean(axis=(1, 3)) * 0.7 + 30
    image += np.random.default_rng(seed).normal(0.0, noise_sigma, image.shape)
    return np.clip(np.rint(cv2.GaussianBlur(image, (0, 0), 0.6)), 0, 255).astype(np.uint8)


def poses_before(board: Board, count: int, seed=0, turn_rad=0.6) -> list[np.ndarray]:
    """Return poses (6,) of a board that fills much of the image, turned all ways, near its middle and its corners."""
    rng = np.random.default_rng(seed)
    poses = []
    middle = np.array([board.columns, board.rows, 0.0]) / 2 * board.square_m
    for _ in range(count):
        turn = np.append(rng.uniform(-turn_rad, turn_rad, 2), rng.uniform(-0.3, 0.3))
        far = rng.uniform(1.0, 1.6) * board.columns * board.square_m
        place = np.append(rng.uniform(-0.3, 0.3, 2) * [1, 0.75], 1.0) * far
        poses.append(np.concatenate([turn, place - cv2.Rodrigues(turn)[0] @ middle]))
    return poses


def floor_pose(camera: Camera, board: Board, ahead_m: float) -> np.ndarray:
    """Return the pose (6,) of a board that lies on the floor ahead of the camera, its rows across."""
    level_from_board = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
    corner = np.array([-board.columns * board.square_m / 2, -camera.mount.height_m, -ahead_m])
    cv_from_level = np.diag([1.0, -1.0, -1.0]) @ camera.level_from_camera.T
    turn = cv2.Rodrigues(cv_from_level @ level_from_board)[0].ravel()
    return np.concatenate([turn, cv_from_level @ corner])
