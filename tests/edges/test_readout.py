"""A rolling shutter undone: against points projected one by one from where the camera was at their row's time."""

import csv
from collections import defaultdict
from dataclasses import replace

import cv2
import numpy as np
import pytest
from edge_images import camera_of, supersampled_directions, wall_image

from localiser.camera import Camera, Mount, RollingShutter
from localiser.edges import EdgeParameters, find_edges
from localiser.edges.measure import Readout, readout_of
from localiser.geometry import Array, Twist, arc_motion, compose

SHUTTER = RollingShutter(30e-3 / 479, stamp_row=100.0)
BEARINGS_DEG = [-22.0, -15.0, -8.0, -2.0, 3.0, 9.0, 16.0, 23.0]
GREYS = [60.0, 130.0, 70.0, 150.0, 90.0, 170.0, 100.0, 160.0, 80.0]


def rolling(camera: Camera, shutter: RollingShutter = SHUTTER) -> Camera:
    return replace(camera, shutter=shutter)


def taken_one_by_one(camera: Camera, twist: Twist, points: Array) -> Array:
    """Return pixels (..., 2) of map points (..., 3), each in the row that was taken when it was there."""
    found = []
    for point in points.reshape(-1, 3):
        pixel = camera.project(np.zeros(3), point)
        for _ in range(30):
            since_s = float(camera.shutter.since_stamp_s(pixel[1]))
            velocity = np.array([twist.right_m_s, twist.backward_m_s])
            pixel = camera.project(
                compose(np.zeros(3), arc_motion(velocity, twist.turn_rad_s * since_s, since_s)), point
            )
        found.append(pixel)
    return np.array(found).reshape(*points.shape[:-1], 2)


def edges_on_the_floor() -> Array:
    """Return bottom and top (S, 2, 3) of posts that stand around."""
    places = np.array([[-1.0, -2.2], [-0.8, -4.0], [0.1, -3.0], [0.6, -2.0], [1.5, -3.5], [1.2, -2.5]])
    heights = np.array([0.0, 0.9])
    return np.stack([np.stack([np.full(2, x), heights, np.full(2, z)], axis=-1) for x, z in places])


def ideal_px(camera: Camera, pixels: Array) -> Array:
    return camera.ideal.pixels_from_image(camera.image_from_pixels(pixels))


@pytest.mark.parametrize(
    "twist", [Twist(turn_rad_s=1.0), Twist(turn_rad_s=-2.0), Twist(0.0, -0.8, 0.7), Twist(0.3, -0.5)]
)
@pytest.mark.parametrize("mount", [Mount(0.35, 0.8), Mount(0.35, 0.8, -0.05, 0.3, 0.2, -0.3)])
def test_points_are_brought_to_the_time_stamp(twist: Twist, mount: Mount) -> None:
    camera = rolling(camera_of(k1=-0.25)).at(mount)
    points = edges_on_the_floor()
    at_once = ideal_px(camera, camera.project(np.zeros(3), points))
    taken = ideal_px(camera, taken_one_by_one(camera, twist, points))
    readout = readout_of(camera, twist)
    rate, sigma = readout.rates(taken)
    corrected = readout.at_stamp(taken, rate)
    ideal = camera.ideal
    before, after = (np.abs(ideal.lean_of_segments(px) - ideal.lean_of_segments(at_once)) for px in (taken, corrected))
    speed = np.hypot(twist.right_m_s, twist.backward_m_s)
    assert np.rad2deg(after.max()) < 0.02 + 0.06 * speed, "ranges change a little on the way"
    assert before.max() > 10.0 * after.max()
    bearing = np.abs(ideal.bearing_of_segments(corrected) - ideal.bearing_of_segments(at_once))
    assert np.rad2deg(bearing.max()) < 0.02 + 0.06 * speed
    assert (sigma > 0).any() == bool(speed or (mount.back_m and twist.turn_rad_s))
    np.testing.assert_allclose(readout.as_taken(corrected, rate), taken, atol=1e-4)


def test_derivatives_by_the_turn_rate_are_differences() -> None:
    camera, points = rolling(camera_of()), edges_on_the_floor()
    taken = taken_one_by_one(camera, Twist(turn_rad_s=1.0), points)
    low, high = (readout_of(camera, Twist(turn_rad_s=rate)) for rate in (0.99, 1.01))
    assert high is not None
    one, other = (readout.at_stamp(taken, readout.rates(taken)[0]) for readout in (low, high))
    rate = low.rates(taken)[0]
    np.testing.assert_allclose(
        (camera.lean_of_segments(other) - camera.lean_of_segments(one)) / 0.02, low.per_turn(one, rate)[0], rtol=0.02
    )
    np.testing.assert_allclose(
        (camera.bearing_of_segments(other) - camera.bearing_of_segments(one)) / 0.02,
        low.per_turn(one, rate)[1],
        rtol=0.02,
        atol=1e-5,
    )


def turning_image(camera: Camera, turn_rad_s: float) -> Array:
    """Return the image of a wall far away, each row taken with the camera turned on: of that row alone, from each."""
    image = np.zeros((camera.height, camera.width), dtype=np.uint8)
    tangent, _ = supersampled_directions(camera)
    k = tangent.shape[0] // camera.height
    for row in range(camera.height):
        turned = turn_rad_s * float(camera.shutter.since_stamp_s(row))
        bearings = np.tan(np.deg2rad(BEARINGS_DEG) + turned)
        fine = np.asarray(GREYS)[np.searchsorted(bearings, tangent[row * k : (row + 1) * k])]
        image[row] = np.rint(fine.reshape(k, camera.width, k).mean(axis=(0, 2)))
    return image


@pytest.mark.parametrize("turn_rad_s", [1.0, -1.0])
def test_an_image_that_was_taken_row_by_row_has_the_edges_of_one_taken_at_once(turn_rad_s: float) -> None:
    camera = rolling(camera_of(roll_deg=1.0, k1=-0.25))
    image = turning_image(camera, turn_rad_s)
    at_once = find_edges(wall_image(camera, BEARINGS_DEG, GREYS), camera_of(roll_deg=1.0, k1=-0.25))
    found = find_edges(image, camera, twist=Twist(turn_rad_s=turn_rad_s, turn_sigma_rad_s=0.05))
    assert len(found) == len(at_once) == len(BEARINGS_DEG)
    order, expected = np.argsort(found.bearing), np.argsort(at_once.bearing)
    np.testing.assert_allclose(np.rad2deg(found.bearing[order]), BEARINGS_DEG, atol=0.03)
    np.testing.assert_allclose(np.rad2deg(found.lean[order]), np.rad2deg(at_once.lean[expected]), atol=0.05)
    np.testing.assert_array_equal(found.polarity[order], at_once.polarity[expected])
    np.testing.assert_allclose(found.profile[order], at_once.profile[expected], atol=8.0)
    as_global = find_edges(image, replace(camera, shutter=None))
    assert (
        len(as_global) < len(at_once) or np.rad2deg(np.abs(np.sort(as_global.lean) - np.sort(at_once.lean))).max() > 1
    )


def test_an_uncertain_turn_rate_is_an_error_that_edges_share() -> None:
    camera = rolling(camera_of())
    image = wall_image(camera, BEARINGS_DEG, GREYS)
    found = find_edges(image, camera, twist=Twist(turn_sigma_rad_s=0.2))
    assert found.common.names == ("tilt", "roll", "turn rate")
    assert found.common.cov[2, 2] == pytest.approx(0.04)
    # From the first row to the last, an error of 1 rad/s turns the top against the bottom by 30 ms.
    high = found.ends_px[:, 0, 1] - found.ends_px[:, 1, 1]
    lean = found.common.bearing_from_lean[:, 2] * np.sin(camera.mount.tilt_rad) / np.cos(found.bearing) ** 2
    assert (np.sign(lean) == 1.0).all()
    np.testing.assert_allclose(lean, SHUTTER.row_time_s * camera.focal_px * high / high, rtol=0.35)


def test_edges_that_a_wrong_turn_rate_turns_are_kept_if_it_was_said_to_be_uncertain() -> None:
    camera = rolling(camera_of())
    image = turning_image(camera, 1.0)
    sure, unsure = (find_edges(image, camera, twist=Twist(turn_sigma_rad_s=sigma)) for sigma in (0.0, 1.0))
    assert len(unsure) == len(BEARINGS_DEG) > len(sure)
    assert len(find_edges(image, camera)) >= len(sure), "nothing is known of the motion"


def test_a_camera_that_takes_all_rows_at_once_takes_no_notice() -> None:
    camera = camera_of(k1=-0.25)
    image = wall_image(camera, BEARINGS_DEG, GREYS, noise_sigma=2.0)
    plain, told = find_edges(image, camera), find_edges(image, camera, twist=Twist(0.0, -1.0, 2.0, 0.5))
    assert readout_of(camera, Twist(turn_rad_s=1.0)) is None
    assert told.common.names == ("tilt", "roll")
    np.testing.assert_array_equal(plain.lean, told.lean)
    np.testing.assert_array_equal(plain.ends_px, told.ends_px)


def test_the_lower_end_tells_the_range_by_which_driving_moves_an_edge() -> None:
    camera = rolling(camera_of())
    ends = camera.project(
        np.zeros(3), np.array([[[1.0, 0.0, -2.0], [1.0, 0.6, -2.0]], [[1.0, 1.0, -2.0], [1.0, 1.1, -2.0]]])
    )
    readout = readout_of(camera, Twist(backward_m_s=-1.0))
    assert isinstance(readout, Readout)
    rate, sigma = readout.rates(ends)
    sine, range_m = 1 / np.sqrt(5), np.sqrt(5)
    assert rate == pytest.approx([sine / range_m, sine * 0.4]), "one stands on the floor, one ends above the horizon"
    assert sigma == pytest.approx([0.3 * sine] * 2)


def test_at_half_the_resolution_rows_are_twice_as_far_apart() -> None:
    camera, twist = rolling(camera_of()), Twist(turn_rad_s=1.0)
    image, half = turning_image(camera, 1.0), EdgeParameters(half_resolution=True)
    found = find_edges(image, camera, half, twist=twist)
    np.testing.assert_allclose(np.rad2deg(np.sort(found.bearing)), BEARINGS_DEG, atol=0.05)
    expected = find_edges(wall_image(camera, BEARINGS_DEG, GREYS), camera_of(), half)
    np.testing.assert_allclose(np.sort(found.lean), np.sort(expected.lean), atol=np.deg2rad(0.1))


CAMERA = Camera(640, 480, 502.3, 502.3, 319.5, 239.5, Mount(np.deg2rad(18.0), 0.8))
IMAGES = range(0, 418, 30)


@pytest.fixture(scope="module")
def visible(data_dir) -> dict[int, np.ndarray]:
    """Return per image the landmarks (T, 5) in view: bottom u, v, top u, v, visible share."""
    rows = defaultdict(list)
    with (data_dir / "house" / "visible.csv").open() as file:
        for row in csv.DictReader(file):
            keys = ("u_bottom", "v_bottom", "u_top", "v_top", "visible_fraction")
            rows[int(row["image"])].append([float(row[key]) for key in keys])
    return {index: np.array(rows[index]).reshape(-1, 5) for index in IMAGES}


def step_across(image: np.ndarray, ends: np.ndarray) -> np.ndarray:
    """Return the size (T,) of the median grey difference across ±2.5 px of edges (T, 2, 2)."""
    along = np.linspace(0.02, 0.98, 60)[None, :, None]
    u, v = np.moveaxis((ends[:, :1] * (1 - along) + ends[:, 1:] * along).astype(np.float32), -1, 0)
    left, right = (
        cv2.remap(image.astype(np.float32), u + np.float32(by), v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        for by in (-2.5, 2.5)
    )
    return np.abs(np.median(right - left, axis=1))


def recall(detector, data_dir, visible) -> float:
    """Return the share of landmarks with at least 60 px in view, and a step, that an edge passes within 2.5 px."""
    found = total = 0
    for index in IMAGES:
        image = cv2.imread(str(data_dir / "house" / "images" / f"{index:06d}.jpg"), cv2.IMREAD_GRAYSCALE)
        edges = find_edges(image, CAMERA, EdgeParameters(detector=detector))
        ends = visible[index][:, :4].reshape(-1, 2, 2)
        counted = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1) * visible[index][:, 4] >= 60
        counted &= step_across(image, ends) >= 8
        apart = np.abs(edges.bearing - CAMERA.bearing_of_segments(ends[counted])[:, None]) * CAMERA.focal_px
        found += int((apart.min(axis=1, initial=np.inf) < 2.5).sum())
        total += int(counted.sum())
    return found / total


@pytest.mark.data
def test_fewer_landmarks_are_missed_than_by_lsd(data_dir, visible):
    own, general = recall("columns", data_dir, visible), recall("lsd", data_dir, visible)
    assert 1 - own < (1 - general) / 1.3
