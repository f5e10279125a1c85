"""Tilt and roll from lines and from the images of a log."""

from __future__ import annotations

import numpy as np
import pytest
from edge_images import camera_of, wall_image
from folders import ROOT
from hypothesis import given, settings
from hypothesis import strategies as st

from localiser.calibration import (
    Lines,
    check_mount,
    down_in_camera,
    lines_of,
    mount_from_down,
    mount_of_images,
    mount_of_lines,
    views_of,
)
from localiser.calibration.log_mount import as_scattered
from localiser.calibration.plumb import PRIOR_SIGMA_RAD, fitted
from localiser.edges import EdgeParameters, Edges
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


def test_edges_that_no_image_shows_are_left_out():
    edges = Edges.from_columns(np.array([0.1]), np.array([0.01]), np.array([0.03]), np.array([0.01]))
    assert len(lines_of(edges, camera_of())) == 0


# -- the fit ----------------------------------------------------------------------------------------------------------


def test_fit_is_the_smallest_eigenvector_of_the_planes_normals():
    """Design equation 10, for lines that are all vertical and equally certain."""
    rng = np.random.default_rng(3)
    camera = camera_of(tilt_deg=20.0, roll_deg=1.0)
    bearings = rng.uniform(-0.45, 0.45, 300)
    lines = lines_of(edges_at(camera, bearings, turn_rad=rng.normal(0, 2e-3, 300), sigma_rad=2e-3), camera)
    found = fitted(lines, TRUE, TRUE)
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
    assert np.all((spread > 0.7) & (spread < 1.25)), spread


def sides_that_err_alike(rng, images=80, things=5, sigma_rad=3e-3) -> Lines:
    """Return the lines of images that show posts: both sides of a post, and its trims, have one and the same error."""
    camera = camera_of(tilt_deg=20.0, roll_deg=1.0)
    parts = []
    for frame in range(images):
        bearings = np.repeat(rng.uniform(-0.45, 0.45, things), 4) + np.tile([0.0, 0.004, 0.008, 0.012], things)
        turn = np.repeat(rng.normal(0, sigma_rad, things), 4)
        parts.append(lines_of(edges_at(camera, bearings, turn_rad=turn, sigma_rad=sigma_rad), camera, frame))
    return Lines.together(parts)


def errors_over_sigma(found) -> np.ndarray:
    return (found.image_mount - TRUE) / np.sqrt(np.diagonal(found.image_cov, axis1=1, axis2=2))


@pytest.mark.parametrize("lines_of_images", [sides_that_err_alike, lambda rng: scene(rng, images=80)])
def test_each_image_is_as_certain_as_images_scatter(lines_of_images):
    found = mount_of_lines(lines_of_images(np.random.default_rng(8)), apart(80), CAMERA, TRUE)
    spread = np.sqrt(np.mean(np.square(errors_over_sigma(found)), axis=0))
    assert np.all((spread > 0.75) & (spread < 1.25)), spread


def test_one_view_does_not_tell_how_images_scatter():
    """Eighty images of one view hold one error: nothing says how it compares with those of other views."""
    lines = sides_that_err_alike(np.random.default_rng(8))
    alone = errors_over_sigma(mount_of_lines(lines, np.zeros((80, 3)), CAMERA, TRUE))
    assert np.all(np.sqrt(np.mean(np.square(alone), axis=0)) > 1.5)


def test_a_wild_image_does_not_speak_for_the_others():
    rng, cov = np.random.default_rng(0), np.tile(np.diag([1e-6, 1e-6]), (100, 1, 1))
    off = rng.normal(0, 1e-3, (100, 2))
    off[7] = 0.1
    grown = as_scattered(off, cov, np.arange(100))
    assert np.all(np.sqrt(np.diagonal(grown, axis1=1, axis2=2)) < 1.3e-3)


def test_images_of_one_view_count_once():
    """Twenty images of a robot that stands still hold the errors of the edges that they show twenty times."""
    rng = np.random.default_rng(0)
    once = scene(rng, images=1, edges=12)
    still = Lines.together([Lines(once.normal, once.per_turn, once.sigma, once.frame + i) for i in range(20)])
    one = mount_of_lines(once, np.zeros((1, 3)), CAMERA, TRUE)
    twenty = mount_of_lines(still, np.zeros((20, 3)), CAMERA, TRUE)
    np.testing.assert_allclose(twenty.sigma, one.sigma, rtol=0.05)
    assert twenty.views == 1


def test_edges_that_are_out_of_plumb_make_it_less_certain():
    rng = np.random.default_rng(5)
    plumb = mount_of_lines(scene(rng, sigma_rad=1e-3), apart(40), CAMERA, TRUE)
    lines = scene(rng, sigma_rad=1e-2)
    crooked = mount_of_lines(
        Lines(lines.normal, lines.per_turn, lines.sigma / 10, lines.frame), apart(40), CAMERA, TRUE
    )
    assert np.all(crooked.sigma > 3 * plumb.sigma)
    assert 0.4 < np.rad2deg(crooked.plumb_sigma) < 0.8  # 0.01 rad seen across a line that rises at some 70°


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


def test_views_change_with_distance_and_with_turning():
    still = np.zeros((5, 3))
    assert views_of(still).tolist() == [0] * 5
    ahead = np.column_stack([np.zeros(7), -0.4 * np.arange(7), np.zeros(7)])
    assert views_of(ahead).tolist() == [0, 0, 0, 1, 1, 1, 2]
    turning = np.column_stack([np.zeros((5, 2)), [3.1, -3.0, -2.6, -2.5, -2.0]])
    assert views_of(turning).tolist() == [0, 0, 1, 1, 2]


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
    check = check_mount(frames, poses, true.with_mount(tilt_rad=tilt, roll_rad=roll), BELIEVED_RAD)
    assert check.disagrees is disagrees
    np.testing.assert_allclose(check.found, TRUE, atol=np.deg2rad(0.15))


def test_a_run_that_sees_nothing_disagrees_with_nothing():
    check = check_mount([Edges.none()] * 3, np.zeros((3, 3)), camera_of(), BELIEVED_RAD)
    assert not check.disagrees and np.all(check.sigma > np.deg2rad(2.0))
    assert not check_mount([], np.zeros((0, 3)), camera_of(), BELIEVED_RAD).disagrees


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


def found_in_log(folder, off_deg, images):
    """Return by how much (deg) tilt and roll found in a log are off, and their sigma, when stated `off_deg` off."""
    log = open_log(folder)
    frames = [frame for frame in log.frames if log.odometry.covers(frame.t_ns)]
    frames = frames[:: max(1, len(frames) // images)]
    poses = log.odometry.sampled([frame.t_ns for frame in frames]).poses
    mount = np.array([log.camera.mount.tilt_rad, log.camera.mount.roll_rad])
    tilt, roll = mount + np.deg2rad(off_deg)
    camera = log.camera.with_mount(tilt_rad=tilt, roll_rad=roll)
    found = mount_of_images(lambda i: frames[i].load(), poses, camera, EdgeParameters())
    return np.rad2deg(found.mount - mount), np.rad2deg(found.sigma)


@pytest.mark.parametrize("off_deg", [(-3.0, 2.0)])
def test_the_plank_floored_corridor_gives_its_mount(off_deg):
    error, sigma = found_in_log(ROOT / "logs" / "corridor", off_deg, images=30)
    assert abs(error[0]) < 0.03 and abs(error[1]) < 0.015
    assert np.all(np.abs(error) < 3 * sigma) and np.all(sigma < 0.03)


@pytest.mark.data
@pytest.mark.parametrize("off_deg", [(3.0, -2.0)])
@pytest.mark.slow  # quick: the corridor above
def test_the_rendered_house_gives_its_mount(data_dir, off_deg):
    error, sigma = found_in_log(data_dir / "house", off_deg, images=60)
    assert abs(error[0]) < 0.05 and abs(error[1]) < 0.03
    assert np.all(np.abs(error) < 3 * sigma)
