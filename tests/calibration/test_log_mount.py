"""Tilt and roll from lines and from the images of a log."""

from dataclasses import replace

import numpy as np
import pytest
from edge_images import camera_of, wall_image
from folders import ROOT
from hypothesis import given, settings
from hypothesis import strategies as st
from leaning_rows import leaning_drive

from localiser.calibration import (
    Lines,
    check_mount,
    down_in_camera,
    lines_of,
    mount_from_down,
    mount_of_images,
    mount_of_lines,
)
from localiser.calibration.mount import PRIOR_SIGMA_RAD, fit_mount
from localiser.edges import EdgeParameters, Edges, find_edges
from localiser.storage import open_log

TRUE = np.deg2rad([20.0, 1.0])
CAMERA = camera_of(tilt_deg=20.0, roll_deg=1.0, k1=-0.2)
angles = st.floats(-60.0, 60.0)


def edges_at(camera, bearings, low=-0.35, high=0.2, turn_rad=0.0, sigma_rad=1e-3) -> Edges:
    """Return vertical edges at bearings (E,), each turned about its middle in the image by turn_rad (E,)."""
    s, c = np.sin(camera.mount.tilt_rad), np.cos(camera.mount.tilt_rad)
    e = np.array([low, high])
    upright = np.stack([np.tan(bearings)[:, None] * (c + e * s), np.broadcast_to(e, (len(bearings), 2))], axis=-1)
    middle = upright.mean(axis=1, keepdims=True)
    half = upright - middle
    turned = np.stack([half[..., 1], -half[..., 0]], axis=-1) * np.reshape(turn_rad, (-1, 1, 1))
    ends = camera.pixels_from_upright(middle + half + turned)
    count = len(bearings)
    return Edges.from_columns(bearings, np.full(count, 1e-4), np.zeros(count), np.full(count, sigma_rad), ends_px=ends)


def apart(images: int) -> np.ndarray:
    """Return poses (F, 3) of images that have nothing in common: they were taken a building apart."""
    return np.column_stack([30.0 * np.arange(images), np.zeros((images, 2))])


def scene(rng, images=40, edges=8, clutter=3, sigma_rad=3e-3, sides_rad=0.45) -> Lines:
    """Return the lines of images that show vertical edges with noise, and some that point anywhere near."""
    camera = camera_of(tilt_deg=20.0, roll_deg=1.0, k1=-0.2)
    parts = []
    for frame in range(images):
        bearings = rng.uniform(-sides_rad, sides_rad, edges + clutter)
        turn = np.concatenate([rng.normal(0, sigma_rad, edges), rng.uniform(-0.15, 0.15, clutter)])
        parts.append(lines_of(edges_at(camera, bearings, turn_rad=turn, sigma_rad=sigma_rad), camera, frame))
    return Lines.together(parts)


# -- lines ------------------------------------------------------------------------------------------------------------


@given(tilt=angles, roll=angles)
@settings(max_examples=30)
def test_down_is_the_level_frame_s_own_and_inverts(tilt, roll):
    camera = camera_of(tilt_deg=tilt, roll_deg=roll)
    down = down_in_camera(np.deg2rad([tilt, roll]))
    np.testing.assert_allclose(camera.level_from_camera @ down, [0, -1, 0], atol=1e-12)
    np.testing.assert_allclose(mount_from_down(down), np.deg2rad([tilt, roll]), atol=1e-9)


@pytest.mark.parametrize("k1", [0.0, -0.2])
def test_planes_of_vertical_edges_hold_the_direction_of_down(k1):
    camera = camera_of(tilt_deg=20.0, roll_deg=1.0, k1=k1)
    lines = lines_of(edges_at(camera, np.linspace(-0.45, 0.45, 9)), camera)
    miss, _, _ = lines.misses(TRUE)
    np.testing.assert_allclose(miss, 0.0, atol=1e-9)


def test_derivatives_of_the_miss_are_those_of_finite_differences():
    camera, step = camera_of(tilt_deg=20.0, roll_deg=1.0), 1e-6
    bearings, mount = np.linspace(-0.4, 0.4, 7), TRUE + np.array([0.02, -0.03])
    lines = lines_of(edges_at(camera, bearings, sigma_rad=1.0), camera)
    _, per_mount, per_turn = lines.misses(mount)
    for axis in range(2):
        numeric = (lines.misses(mount + step * np.eye(2)[axis])[0] - lines.misses(mount)[0]) / step
        np.testing.assert_allclose(per_mount[:, axis], numeric, atol=1e-5)
    turned = lines_of(edges_at(camera, bearings, turn_rad=np.full(7, step), sigma_rad=1.0), camera)
    numeric = np.abs(turned.misses(mount)[0] - lines.misses(mount)[0]) / step
    np.testing.assert_allclose(per_turn, numeric, atol=1e-3)


# -- the fit ----------------------------------------------------------------------------------------------------------


def test_fit_is_the_smallest_eigenvector_of_the_planes_normals():
    """Design equation 10, for lines that are all vertical and equally certain."""
    rng = np.random.default_rng(3)
    camera = camera_of(tilt_deg=20.0, roll_deg=1.0)
    bearings = rng.uniform(-0.45, 0.45, 300)
    lines = lines_of(edges_at(camera, bearings, turn_rad=rng.normal(0, 2e-3, 300), sigma_rad=2e-3), camera)
    found = fit_mount(lines, TRUE, TRUE)
    _, _, sigma = lines.misses(found.mount)
    weight = found.vertical / (sigma**2 + found.plumb_sigma**2)
    _, vectors = np.linalg.eigh(np.einsum("k,ki,kj->ij", weight, lines.normal, lines.normal))
    down = vectors[:, 0] * -np.sign(vectors[1, 0])
    np.testing.assert_allclose(found.mount, mount_from_down(down), atol=np.deg2rad(0.002))


@pytest.mark.parametrize("off_deg", [(3.0, 0.0), (-3.0, 0.0), (0.0, 2.0), (6.0, -4.0)])
def test_a_stated_mount_that_is_degrees_off_has_hardly_a_say(off_deg):
    lines = scene(np.random.default_rng(1))
    right = mount_of_lines(lines, apart(40), CAMERA, TRUE)
    found = mount_of_lines(lines, apart(40), CAMERA, TRUE + np.deg2rad(off_deg))
    np.testing.assert_allclose(found.mount, right.mount, atol=np.deg2rad(0.01))
    np.testing.assert_allclose(found.mount, TRUE, atol=np.deg2rad(0.1))


def test_sigma_covers_the_error():
    normalised = []
    for seed in range(60):
        found = mount_of_lines(scene(np.random.default_rng(seed), images=12, edges=6), apart(12), CAMERA, TRUE + 0.01)
        normalised.append((found.mount - TRUE) / found.sigma)
    spread = np.sqrt(np.mean(np.square(normalised), axis=0))
    assert np.all((spread > 0.5) & (spread < 1.25)), spread


def test_seams_of_the_floor_do_not_pass_for_vertical_edges():
    """Joints between planks ahead all meet at the horizon; as many of them as edges do not move the tilt."""
    camera = camera_of(tilt_deg=20.0, roll_deg=1.0)
    rng = np.random.default_rng(2)
    lines = [scene(rng, images=30, edges=6, clutter=0)]
    for frame in range(30):
        side = np.arange(-1.0, 1.0, 0.2) + rng.uniform(0, 0.2)
        ends = [np.stack([side, np.full(10, -0.8), np.full(10, -z)], axis=-1) for z in (1.8, 5.0)]
        ends_px = camera.project_level(np.stack(ends, axis=1))
        ends_px = ends_px[np.isfinite(ends_px).all(axis=(1, 2))]
        unknown = np.zeros(len(ends_px))
        edges = Edges.from_columns(unknown, unknown + 1e-3, unknown, unknown + 1e-3, ends_px=ends_px)
        lines.append(lines_of(edges, camera, frame))
    found = mount_of_lines(Lines.together(lines), apart(30), CAMERA, TRUE + np.deg2rad([3.0, -2.0]))
    np.testing.assert_allclose(np.rad2deg(found.mount - TRUE), 0.0, atol=0.1)


def test_without_lines_the_stated_mount_stands_and_says_so():
    found = mount_of_lines(Lines.together([]), np.zeros((5, 3)), CAMERA, TRUE)
    np.testing.assert_allclose(found.mount, TRUE)
    np.testing.assert_allclose(found.sigma, PRIOR_SIGMA_RAD)
    assert "hardly tell the tilt and the roll" in found.problem


def test_edges_straight_ahead_tell_the_roll_only():
    found = mount_of_lines(scene(np.random.default_rng(4), sides_rad=0.005, clutter=0), apart(40), CAMERA, TRUE)
    assert found.sigma[1] < np.deg2rad(0.1) < np.deg2rad(1.0) < found.sigma[0]
    assert "hardly tell the tilt:" in found.problem


def test_a_mount_beyond_the_search_is_doubted():
    found = mount_of_lines(scene(np.random.default_rng(6)), apart(40), CAMERA, TRUE - np.deg2rad([12.2, 0.0]))
    assert "limit of the search" in found.problem


# -- things that lean -------------------------------------------------------------------------------------------------


def test_sigma_covers_the_error_where_rows_lean():
    errors = []  # of tilt and roll, in sigmas
    for seed in range(8):
        drive = leaning_drive(seed, row_deg=0.3, own_deg=0.15)
        found = mount_of_lines(drive.lines, drive.odometry, drive.camera, drive.mount)
        errors.append((found.mount - drive.mount) / found.sigma)
    errors = np.array(errors)
    assert 0.5 < np.sqrt((errors**2).mean()) < 1.5 and np.abs(errors).max() < 4.0


# -- the check of a run -----------------------------------------------------------------------------------------------

BELIEVED_RAD = np.deg2rad([0.5, 0.3])


@pytest.mark.parametrize(
    ("off_deg", "disagrees"), [((0.0, 0.0), False), ((0.3, 0.0), False), ((0.8, 0.0), True), ((0.0, -1.5), True)]
)
def test_a_run_disagrees_beyond_what_the_stated_mount_may_be_off(off_deg, disagrees):
    true = camera_of(tilt_deg=20.0, roll_deg=1.0)
    rng = np.random.default_rng(0)
    frames = [
        edges_at(true, rng.uniform(-0.45, 0.45, 8), turn_rad=rng.normal(0, 3e-3, 8), sigma_rad=3e-3) for _ in range(20)
    ]
    tilt, roll = np.deg2rad([20.0, 1.0]) + np.deg2rad(off_deg)
    poses = np.column_stack([np.zeros(20), -0.3 * np.arange(20), np.zeros(20)])
    check = check_mount(frames.__getitem__, poses, true.with_mount(tilt_rad=tilt, roll_rad=roll), BELIEVED_RAD)
    assert check.disagrees is disagrees
    np.testing.assert_allclose(check.mount, TRUE, atol=np.deg2rad(0.15))


def test_a_run_that_sees_nothing_disagrees_with_nothing():
    check = check_mount(lambda _: Edges.none(), np.zeros((3, 3)), camera_of(), BELIEVED_RAD)
    assert not check.disagrees and np.all(check.sigma > np.deg2rad(2.0))
    assert not check_mount(lambda _: Edges.none(), np.zeros((0, 3)), camera_of(), BELIEVED_RAD).disagrees


# -- images -----------------------------------------------------------------------------------------------------------


def test_images_of_walls_give_the_true_mount_from_one_that_is_degrees_off():
    camera = camera_of(tilt_deg=20.0, roll_deg=1.0, k1=-0.1)
    rng = np.random.default_rng(0)
    images = []
    for seed in range(4):
        bearings = np.sort(rng.uniform(-26, 26, 7))
        greys = 110 + 50 * (-1.0) ** np.arange(8) + rng.uniform(-20, 20, 8)
        images.append(wall_image(camera, bearings, greys, wall_ahead_m=2.5, noise_sigma=3.0, seed=seed))
    stated = camera.with_mount(tilt_rad=np.deg2rad(17.0), roll_rad=np.deg2rad(2.5))
    found = mount_of_images(images.__getitem__, apart(4), stated, EdgeParameters())
    np.testing.assert_allclose(np.rad2deg(found.mount), [20.0, 1.0], atol=0.1)
    assert np.all(np.abs(found.mount - TRUE) < 4 * found.sigma)


def test_the_plank_floored_corridor_gives_its_mount():
    log = open_log(ROOT / "logs" / "corridor")
    frames = [frame for frame in log.frames if log.odometry.covers(frame.t_ns)][::6]
    poses = log.odometry.sampled([frame.t_ns for frame in frames]).poses
    mount = np.array([log.camera.mount.tilt_rad, log.camera.mount.roll_rad])
    tilt, roll = mount + np.deg2rad([-3.0, 2.0])
    camera = log.camera.with_mount(tilt_rad=tilt, roll_rad=roll)
    found = mount_of_images(lambda i: frames[i].load(), poses, camera, EdgeParameters())
    error, sigma = np.rad2deg(found.mount - mount), np.rad2deg(found.sigma)
    assert abs(error[0]) < 0.03 and abs(error[1]) < 0.015
    assert np.all(np.abs(error) < 3 * sigma) and np.all(sigma < 0.03)


def test_edges_agree_with_mounts_that_move():
    """The error of the usual mount is the same in every image of a camera that moves on the robot."""
    camera, frames = camera_of(), []
    for tilt_deg, roll_deg in ((14.0, 2.0), (20.0, -1.0), (26.0, 0.0)):
        mount = replace(camera.mount, tilt_rad=np.radians(tilt_deg), roll_rad=np.radians(roll_deg))
        image = wall_image(camera.at(mount), [-20.0, -8.0, 3.0, 14.0], [60.0, 120.0, 70.0, 150.0, 110.0])
        frames.append(find_edges(image, camera, mount=mount))
    poses = np.arange(3.0)[:, None] * [0.0, -1.0, 0.5]
    check = check_mount(frames.__getitem__, poses, camera, np.radians([0.5, 0.3]))
    np.testing.assert_allclose(check.mount, check.stated, atol=1e-3)
    assert not check.disagrees
    forgotten = [replace(edges, mount=None) for edges in frames]
    assert (
        np.abs(check_mount(forgotten.__getitem__, poses, camera, np.radians([0.5, 0.3])).mount - check.stated).max()
        > 1e-3
    )
