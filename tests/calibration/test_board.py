"""Intrinsics, and tilt, roll and height, from rendered views of a board whose truth is known."""

from dataclasses import replace
from functools import lru_cache

import cv2
import numpy as np
import pytest
from board_views import board_image, floor_pose, poses_before
from edge_images import camera_of

from localiser.calibration import Board, BoardView, calibrate, mount_over_board
from localiser.camera import Camera
from localiser.errors import InputError

CAMERA = camera_of(480, 360, tilt_deg=35.0, roll_deg=-1.5, k1=-0.2)
CHARUCO = Board("charuco", 8, 6, 0.03, 0.022)
CHESSBOARD = Board("chessboard", 8, 6, 0.03)
SIZE = (CAMERA.width, CAMERA.height)


@lru_cache(maxsize=2)
def views_of(board: Board, count: int = 8) -> tuple[BoardView, ...]:
    images = (board_image(CAMERA, board, pose, seed=i) for i, pose in enumerate(poses_before(board, count, seed=5)))
    return tuple(view for i, image in enumerate(images) if (view := board.find(image, f"{i}.png")) is not None)


def exact_views(camera: Camera, count=12, sigma_px=0.1, seed=0, turn_rad=0.6) -> list[BoardView]:
    """Return views of a board whose corners err by Gaussian noise."""
    board, rng = CHESSBOARD, np.random.default_rng(seed)
    column, row = np.meshgrid(np.arange(1, board.columns), np.arange(1, board.rows))
    corners = np.stack([column, row, 0 * column], axis=-1).reshape(-1, 3) * board.square_m
    views = []
    for i, pose in enumerate(poses_before(board, count, seed, turn_rad)):
        right, down, ahead = cv2.Rodrigues(pose[:3])[0] @ corners.T + pose[3:, None]
        seen = camera.pixels_from_image(np.stack([right / ahead, -down / ahead], axis=-1))
        views.append(BoardView(str(i), corners, seen + rng.normal(0, sigma_px, seen.shape)))
    return views


@pytest.mark.parametrize("board", [CHARUCO, pytest.param(CHESSBOARD, marks=pytest.mark.slow)])
def test_rendered_views_give_the_camera(board):
    found = calibrate(views_of(board), SIZE)
    truth = np.array([CAMERA.fx, CAMERA.fy, CAMERA.cx, CAMERA.cy])
    assert found.rms_px < 0.2 and found.reach > 0.6
    np.testing.assert_allclose(found.values[:2], truth[:2], rtol=0.01)
    np.testing.assert_allclose(found.values[2:4], truth[2:], atol=4.0)
    assert np.all(np.abs(found.values[:4] - truth) < 5 * found.sigma[:4])
    # The lens as a whole, where corners were seen: coefficients trade with each other.
    u, v = np.meshgrid(np.linspace(60, 420, 7), np.linspace(45, 315, 5))
    pixels = np.stack([u, v], axis=-1)
    error = found.camera.image_from_pixels(pixels) - CAMERA.image_from_pixels(pixels)
    tilted = error - error.mean(axis=(0, 1))  # a shifted principal point is mostly another pose of the board
    assert np.linalg.norm(tilted, axis=-1).max() * CAMERA.focal_px < 2.0


@pytest.mark.parametrize("board", [CHARUCO, CHESSBOARD])
def test_board_on_the_floor_gives_tilt_roll_and_height(board):
    large = replace(board, square_m=0.1, marker_m=0.075)
    floor = large.find(board_image(CAMERA, large, floor_pose(CAMERA, large, 1.3)), "floor.png")
    assert floor is not None
    views = [replace(view, corners_m=view.corners_m * (0.1 / 0.03)) for view in views_of(board)]
    mount = mount_over_board(calibrate([*views, floor], SIZE), len(views))
    error = mount.values - [np.deg2rad(35.0), np.deg2rad(-1.5), CAMERA.mount.height_m]
    assert np.all(np.abs(error[:2]) < np.deg2rad(0.5)) and abs(error[2]) < 0.01
    assert np.all(np.abs(error) < 5 * mount.sigma)


@pytest.mark.parametrize(
    ("lens", "distortion"),
    [
        ("none", ()),
        ("plumb_bob", (-0.3, 0.1, 1e-3, -1e-3, 0.0)),
        ("equidistant", (-0.02, 0.003, 0.0, 0.0)),
        ("rational_polynomial", (-0.2, 0.02, 0.0, 0.0, 0.0, 0.05, 0.0, 0.0)),
    ],
)
def test_every_lens_model_gives_the_directions_of_pixels(lens, distortion):
    camera = replace(CAMERA, distortion_model=lens, distortion=distortion)
    found = calibrate(exact_views(camera, count=15, sigma_px=0.02), SIZE, lens)
    assert found.camera.distortion_model == lens and len(found.camera.distortion) == len(distortion)
    u, v = np.meshgrid(np.linspace(60, 420, 7), np.linspace(45, 315, 5))
    pixels = np.stack([u, v], axis=-1)
    error = found.camera.image_from_pixels(pixels) - camera.image_from_pixels(pixels)
    assert np.linalg.norm(error, axis=-1).max() * camera.focal_px < 1.0


def test_a_coefficient_that_the_views_do_not_tell_is_left_out():
    assert "k3" not in calibrate(exact_views(CAMERA), SIZE).parameters
    bent = replace(CAMERA, distortion=(-0.3, 0.1, 0.0, 0.0, -0.5))
    assert "k3" in calibrate(exact_views(bent, count=15, sigma_px=0.02), SIZE).parameters


def test_a_view_that_does_not_fit_is_named():
    views = exact_views(CAMERA)
    rng = np.random.default_rng(1)
    views[3] = replace(views[3], corners_px=views[3].corners_px + rng.normal(0, 1.5, views[3].corners_px.shape))
    assert calibrate(views, SIZE).outliers == ["3"]
    assert calibrate(exact_views(CAMERA), SIZE).outliers == []


def test_what_views_hardly_tell_is_the_same_each_time():
    found = {calibrate(exact_views(CAMERA, count=4), SIZE, "rational_polynomial").camera.distortion for _ in range(8)}
    assert len(found) == 1


def test_views_from_straight_ahead_do_not_tell_the_focal_length():
    with pytest.raises(InputError, match="do not tell"):
        calibrate(exact_views(CAMERA, count=6, turn_rad=1e-3), SIZE)


def test_an_image_without_the_board_shows_none():
    grey = np.random.default_rng(0).integers(0, 255, (360, 480), dtype=np.uint8)
    assert CHARUCO.find(grey) is None and CHESSBOARD.find(grey) is None
    image = board_image(CAMERA, CHARUCO, poses_before(CHARUCO, 1)[0])
    assert replace(CHARUCO, dictionary="4X4_50").find(image) is None


@pytest.mark.parametrize(
    ("changes", "field"),
    [
        ({"columns": 2}, "--squares"),
        ({"square_m": 0.0}, "--square-m"),
        ({"marker_m": 0.03}, "--marker-m"),
        ({"dictionary": "9X9"}, "--dictionary"),
        ({"columns": 20, "rows": 20}, "--dictionary"),
    ],
)
def test_a_board_that_does_not_exist_is_refused(changes, field):
    with pytest.raises(InputError) as raised:
        replace(CHARUCO, **changes)
    assert raised.value.field == field


def test_too_few_views_are_refused():
    with pytest.raises(InputError, match="at least 3 images, found it in 2"):
        calibrate(exact_views(CAMERA, count=2), SIZE)
