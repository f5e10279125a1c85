"""The detector along columns: significance, sub-pixel position with an honest sigma, close neighbours, bad images."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from cameras import floor_points
from edge_images import camera_of, wall_image

from localiser.edges import EdgeParameters, find_edges
from localiser.edges.columns import KERNEL, change_of, clutter, gradient_field, peaks_of
from localiser.edges.detectors import columns
from localiser.edges.lines import Groups
from localiser.edges.views import ROWS_AT_ONCE, ROWS_PER_BLOCK, column_view

PARAMETERS = EdgeParameters(detector="columns")


def test_the_gradient_of_a_ramp_is_its_slope():
    ramp = 3.0 * np.arange(40.0)
    np.testing.assert_allclose(np.correlate(ramp, KERNEL, mode="valid"), 3.0, rtol=1e-6)


@pytest.mark.parametrize("tilt_deg", [-30.0, 0.0, 20.0, 60.0])
def test_a_vertical_edge_is_a_column_of_the_rectified_image(tilt_deg):
    camera = camera_of(tilt_deg=tilt_deg, roll_deg=3.0, k1=-0.2)
    view = column_view(camera)
    assert view.height % ROWS_PER_BLOCK == 0
    row, column = np.nonzero(~view.tables[2])
    row, column = row[::997].astype(np.float64), column[::997].astype(np.float64)
    rays = camera.level_rays(camera.pixels_from_upright(view.upright(column, row)))
    np.testing.assert_allclose(rays[:, 0] / -rays[:, 2], view.tangent(column), atol=1e-6)


def test_the_whole_image_is_in_the_rectified_one():
    camera = camera_of(roll_deg=3.0, k1=-0.2)
    view = column_view(camera)
    corners = np.array(
        [[1.0, 1.0], [camera.width - 2, 1.0], [1.0, camera.height - 2], [camera.width - 2, camera.height - 2]]
    )
    rays, e = camera.level_rays(corners), camera.upright_from_pixels(corners)[:, 1]
    column = (rays[:, 0] / -rays[:, 2] - view.first_tangent) * view.columns_per_tangent
    row = (view.first_height - e) * camera.focal_px / ROWS_AT_ONCE
    assert np.all((column >= 0) & (column <= view.width - 1))
    assert np.all((row >= 0) & (row <= view.height - 1))


@pytest.mark.parametrize(
    ("model", "distortion"),
    [
        ("none", ()),
        ("plumb_bob", (-0.3, 0.05, 0.001, -0.001, 0.0)),
        ("plumb_bob", (0.3, 0.0, 0.0, 0.0, 0.0)),
        ("rational_polynomial", (0.3, 0.1, 0.0005, -0.0005, 0.02, 0.45, 0.12, 0.01)),
        ("equidistant", (-0.02, 0.005, 0.0, 0.0)),
    ],
)
@pytest.mark.parametrize("size", [(176, 144), (641, 479)])
def test_the_remap_is_the_lens_models_to_a_table_entry(model, distortion, size):
    camera = replace(camera_of(*size, roll_deg=2.0), distortion_model=model, distortion=distortion)
    view = column_view(camera)
    whole, share, unseen = view.tables
    row, column = np.nonzero(~unseen)
    exact = camera.pixels_from_upright(view.upright(column.astype(np.float64), row.astype(np.float64)))
    looked_up = whole[row, column] + np.stack([share & 31, share >> 5], axis=-1)[row, column] / 32
    # Between the centres of two rows, which are averaged before.
    exact[:, 1] = (exact[:, 1] - (ROWS_AT_ONCE - 1) / 2) / ROWS_AT_ONCE
    np.testing.assert_allclose(looked_up, exact, atol=1 / 64 + 0.01)


@pytest.mark.parametrize("focal", [256.0, 254.0, 191.0])
def test_a_fisheye_whose_corners_look_sideways_has_a_view_of_ordinary_size(focal):
    camera = replace(camera_of(focal_px=focal), distortion_model="equidistant", distortion=(0.0, 0.0, 0.0, 0.0))
    view = column_view(camera)
    assert view.width < 3 * camera.width and view.height < 3 * camera.height


def test_blocks_are_means_of_what_lies_between_four_pixels():
    camera = camera_of(176, 144, roll_deg=2.0)
    view, image = column_view(camera), np.random.default_rng(0).integers(0, 256, (144, 176), dtype=np.uint8)
    whole, share = view.tables[:2]
    both = image[::2].astype(np.int64) + image[1::2]
    paired = (both + (both >> 1 & 1)) >> 1  # halves to even
    # In 1/32 px; beyond the border the last pixel goes on.
    place = 32 * whole.astype(np.int64) + np.stack([share & 31, share >> 5], axis=-1)
    x, y = np.moveaxis(place.clip(0, 32 * np.array(paired.shape[::-1]) - 32), -1, 0)
    column, row = np.minimum(x // 32, paired.shape[1] - 2), np.minimum(y // 32, paired.shape[0] - 2)
    upper, lower = (
        32 * paired[at, column] + (paired[at, column + 1] - paired[at, column]) * (x - 32 * column)
        for at in (row, row + 1)
    )
    looked_up = (32 * upper + (lower - upper) * (y - 32 * row) + 512) >> 10
    expected = looked_up.reshape(-1, ROWS_PER_BLOCK, view.width).mean(axis=1)
    np.testing.assert_array_equal(view.blocks(image), expected)


@pytest.mark.parametrize("bearing_deg", [-29.0, 29.0])
def test_an_edge_is_not_drawn_along_the_border_that_cuts_it_off(bearing_deg):
    camera = camera_of(k1=-0.25)
    edges = find_edges(wall_image(camera, [bearing_deg], [90.0, 130.0], noise_sigma=3.0), camera, PARAMETERS)
    assert len(edges) == 1
    assert abs(edges.bearing[0] - np.deg2rad(bearing_deg)) < 3 * edges.bearing_sigma[0]


def test_noise_alone_has_no_edges():
    camera = camera_of()
    anything = EdgeParameters(detector="columns", min_contrast=0.0, min_length_px=20.0)
    found = [
        len(
            find_edges(
                np.random.default_rng(seed).normal(120, 10, (480, 640)).clip(0, 255).astype(np.uint8), camera, anything
            )
        )
        for seed in range(10)
    ]
    assert sum(found) <= 1


def test_noise_is_measured_in_the_image():
    camera = camera_of(tilt_deg=0.0)
    image = wall_image(camera, [-5.0, 5.0], [90.0, 150.0, 90.0], noise_sigma=6.0)
    white = 6.0 * np.linalg.norm(KERNEL) / np.sqrt(ROWS_PER_BLOCK * ROWS_AT_ONCE)
    np.testing.assert_allclose(gradient_field(image, camera).noise_grey, white, rtol=0.1)


def test_chains_follow_a_column_and_keep_neighbours_apart():
    camera = camera_of(tilt_deg=0.0)
    field = gradient_field(wall_image(camera, [0.0, 0.5], [60.0, 120.0, 180.0], noise_sigma=1.0), camera)
    _, position, _, chain = peaks_of(field)
    sizes = np.bincount(chain)
    assert (sizes > 0.9 * field.fine.shape[0]).sum() == 2
    for index in np.flatnonzero(sizes > 0.9 * field.fine.shape[0]):
        assert np.ptp(position[chain == index]) < 1.0


@pytest.mark.parametrize("gap_px", [3.0, 4.0, 5.0, 6.0])
def test_the_edges_of_a_door_frame_stay_apart(gap_px):
    camera = camera_of()
    frame = np.rad2deg(np.arctan(np.tan(np.deg2rad(8.0)) + np.arange(4) * gap_px / camera.focal_px))
    image = wall_image(camera, frame, [60.0, 110.0, 150.0, 190.0, 230.0], noise_sigma=1.0)
    edges = find_edges(image, camera, PARAMETERS)
    np.testing.assert_allclose(np.sort(np.rad2deg(edges.bearing)), frame, atol=0.3 * gap_px / camera.focal_px * 57.3)


def test_a_faint_step_in_strong_noise_and_motion_blur_is_found():
    camera = camera_of(roll_deg=1.0)
    bearings = [-21.0, -7.0, 6.0, 19.0]
    image = wall_image(camera, bearings, [120.0, 140.0, 120.0, 140.0, 120.0])
    noise = np.random.default_rng(5).normal(0, 10, image.shape)
    image = np.clip(cv2.blur(image.astype(np.float64), (5, 1)) + noise, 0, 255).astype(np.uint8)
    edges = find_edges(image, camera, PARAMETERS)
    np.testing.assert_allclose(np.sort(np.rad2deg(edges.bearing)), bearings, atol=0.1)
    assert len(find_edges(image, camera, EdgeParameters(detector="lsd"))) < len(bearings)


@pytest.mark.parametrize(("motion_px", "blur_px"), [(9, 0), (15, 0), (25, 0), (0, 1.0), (0, 2.0), (0, 3.0)])
def test_edges_smeared_by_motion_or_out_of_focus_are_one_each_with_an_honest_sigma(motion_px, blur_px):
    camera = camera_of(k1=-0.2)
    bearings = np.array([-19.0, -6.0, 7.0, 18.0])
    image = wall_image(camera, bearings, [90.0, 140.0, 80.0, 150.0, 100.0]).astype(np.float64)
    image = cv2.blur(image, (motion_px, 1)) if motion_px else cv2.GaussianBlur(image, (0, 0), blur_px)
    noise = np.random.default_rng(2).normal(0, 4, image.shape)
    edges = find_edges(np.clip(np.rint(image + noise), 0, 255).astype(np.uint8), camera, PARAMETERS)
    error = np.sort(edges.bearing) - np.deg2rad(bearings)
    assert np.all(np.abs(error) < np.deg2rad(0.08))
    assert np.all(np.abs(error) < 3.5 * edges.bearing_sigma[np.argsort(edges.bearing)])


@pytest.mark.slow
def test_sigma_is_honest_from_clean_to_hard():
    camera = camera_of(roll_deg=1.0)
    rng = np.random.default_rng(11)
    for noise, blur in ((0.5, 1), (4.0, 1), (10.0, 5)):
        normalised = []
        for seed in range(8):
            bearings = np.linspace(-22, 22, 8) + rng.uniform(-1.5, 1.5, 8)
            image = cv2.blur(wall_image(camera, bearings, [100.0, 125.0] * 4 + [100.0]).astype(np.float64), (blur, 1))
            image = np.clip(np.rint(image + rng.normal(0, noise, image.shape)), 0, 255).astype(np.uint8)
            edges = find_edges(image, camera, PARAMETERS)
            assert len(bearings) <= len(edges) <= len(bearings) + 1, seed
            match = np.argmin(np.abs(edges.bearing - np.deg2rad(bearings)[:, None]), axis=1)
            normalised.extend((edges.bearing[match] - np.deg2rad(bearings)) / edges.bearing_sigma[match])
        assert 0.6 < np.std(normalised) < 1.4, (noise, blur)


def test_a_shadow_beside_an_edge_moves_it_little_and_is_part_of_its_sigma():
    camera = camera_of()
    plain = wall_image(camera, [8.0], [160.0, 60.0]).astype(np.float64)
    rays = camera.level_rays(np.stack(np.meshgrid(np.arange(640), np.arange(480)), axis=-1))
    beside = np.arctan2(rays[..., 0], -rays[..., 2]) - np.deg2rad(8.0)
    shadow = 40.0 * np.exp(beside * camera.focal_px / 3.0) * (beside < 0)
    image = np.clip(np.rint(plain - shadow), 0, 255).astype(np.uint8)
    clean, shaded = (find_edges(each.astype(np.uint8), camera, PARAMETERS) for each in (plain, image))
    error = abs(shaded.bearing[0] - np.deg2rad(8.0))
    assert error < np.deg2rad(0.02)
    assert error < 3 * shaded.bearing_sigma[0]
    assert shaded.bearing_sigma[0] > 2 * clean.bearing_sigma[0]


@pytest.mark.parametrize(("right_of_foot_m", "found"), [(0.0, 1), (0.3, 0)])
def test_a_seam_of_the_floor_is_taken_for_an_edge_only_when_it_passes_below_the_camera(right_of_foot_m, found):
    camera = camera_of()
    floor = floor_points(camera, np.stack(np.meshgrid(np.arange(640.0), np.arange(480.0)), axis=-1))
    # The floor is on both sides of the seam x = right_of_foot - z / 4.
    side = np.where(floor[..., 0] > right_of_foot_m - floor[..., 1] / 4, 150, 90)
    image = np.where(np.isnan(floor[..., 0]), 120, side).astype(np.uint8)
    edges = find_edges(image, camera, PARAMETERS)
    assert len(edges) == found
    np.testing.assert_allclose(edges.bearing, np.arctan(0.25), atol=np.deg2rad(0.02))


def test_a_foot_is_found_to_a_fraction_of_a_block():
    camera = camera_of()
    image = wall_image(camera, [-8.0, 10.0], [60.0, 150.0, 60.0], wall_ahead_m=2.5, floor_grey=105.0, noise_sigma=1.0)
    edges = find_edges(image, camera, PARAMETERS)
    foot = np.stack([2.5 * np.tan(edges.bearing), np.full(2, -camera.mount.height_m), np.full(2, -2.5)], axis=-1)
    block_px = ROWS_PER_BLOCK * ROWS_AT_ONCE
    np.testing.assert_allclose(edges.ends_px[:, 0], camera.project_level(foot), atol=0.25 * block_px)


def test_faint_edges_are_left_out_by_their_contrast():
    camera = camera_of()
    image = wall_image(camera, [-10.0, 10.0], [100.0, 106.0, 126.0])
    strong = find_edges(image, camera, EdgeParameters(detector="columns", min_contrast=0.1))
    both = find_edges(image, camera, EdgeParameters(detector="columns", min_contrast=0.03))
    np.testing.assert_allclose(np.rad2deg(strong.bearing), [10.0], atol=0.02)
    assert len(both) == 2


@pytest.mark.parametrize("gain", [0.15, 0.3, 1.0, 2.0])
def test_the_same_edges_are_found_in_any_light(gain):
    camera = camera_of()
    bearings = [-20.0, -10.0, 0.0, 10.0, 20.0]
    wall = wall_image(camera, bearings, [80.0, 92.0, 110.0, 98.0, 80.0, 70.0]).astype(np.float64)
    noise = np.random.default_rng(3).normal(0, 0.5, wall.shape)
    image = np.clip(np.rint(gain * wall + noise), 0, 255).astype(np.uint8)
    edges = find_edges(image, camera, PARAMETERS)
    np.testing.assert_allclose(np.sort(np.rad2deg(edges.bearing)), bearings, atol=0.05)


def test_an_edge_beside_what_is_overexposed_counts_however_small_its_step():
    camera = camera_of()
    assert len(find_edges(wall_image(camera, [0.0], [243.0, 255.0], noise_sigma=0.5), camera, PARAMETERS)) == 1


def shaded(image, bearing_deg, width_px, camera):
    """Return an image (H, W) with the step at a bearing as soft as a Gaussian of `width_px` would make it."""
    rays = camera.level_rays(np.stack(np.meshgrid(np.arange(640), np.arange(480)), axis=-1))
    beside = np.arctan2(rays[..., 0], -rays[..., 2]) - np.deg2rad(bearing_deg)
    return np.where(np.abs(beside) < np.deg2rad(4.0), cv2.GaussianBlur(image, (0, 0), width_px), image)


@pytest.mark.parametrize(("width_px", "found"), [(0.5, 3), (2.5, 2), (5.0, 2)])
def test_soft_shading_among_sharp_edges_is_no_edge(width_px, found):
    camera = camera_of()
    image = wall_image(camera, [-12.0, 0.0, 12.0], [60.0, 150.0, 80.0, 160.0], noise_sigma=1.0)
    assert len(find_edges(shaded(image, 0.0, width_px, camera), camera, PARAMETERS)) == found


@pytest.mark.parametrize("shape", [(3, 9), (6, 40), (12, 16)])
def test_images_too_small_to_hold_an_edge_are_searched_in_vain(shape):
    image = np.random.default_rng(0).integers(0, 255, shape, dtype=np.uint8)
    assert len(columns(image, camera_of(shape[1], shape[0]), min_contrast=PARAMETERS.min_contrast)) == 0


@pytest.mark.parametrize("off_deg", [-3.0, 3.0])
def test_edges_are_found_with_a_tilt_that_is_three_degrees_off(off_deg):
    camera = camera_of()
    image = wall_image(camera, [-20.0, -8.0, 3.0, 14.0], [60.0, 120.0, 70.0, 150.0, 110.0], noise_sigma=3.0)
    stated = camera.with_mount(tilt_rad=camera.mount.tilt_rad + np.deg2rad(off_deg))
    assert len(find_edges(image, stated, EdgeParameters(detector="columns", tilt_sigma_deg=3.0))) == 4


def test_an_edge_beside_what_is_overexposed_is_less_certain_than_a_pixel_is_wide():
    camera = camera_of(tilt_deg=20.0)
    normalised = []
    for seed in range(6):
        bearings = np.array([-14.0, -6.0, 3.0, 11.0]) + 0.37 * seed
        # What the sensor would read; beyond 255 it shows nothing.
        image = wall_image(camera, bearings, [130.0, 520.0, 100.0, 600.0, 140.0], noise_sigma=2.0, seed=seed)
        edges = find_edges(image, camera, EdgeParameters())
        assert len(edges) == 4
        edges = edges.take(np.argsort(edges.bearing))
        normalised += list((edges.bearing - np.deg2rad(bearings)) / edges.bearing_sigma)
    assert 0.4 < np.sqrt(np.mean(np.square(normalised))) < 1.3


def test_white_noise_is_no_clutter_and_texture_is():
    noise = np.random.default_rng(0).normal(0, 1, (60, 640)).astype(np.float32)
    assert np.median(clutter(change_of(noise))) < 1.1
    assert np.median(clutter(change_of(4 * noise))) > 8


def test_where_an_edge_ends_is_no_texture():
    """A beam across an edge makes it end and begin again: it changes on one side of a block only."""
    fine = np.zeros((60, 640), dtype=np.float32)
    fine[:20, ::20] = fine[30:, ::20] = 100.0
    np.testing.assert_allclose(change_of(fine)[3:-3], 0.0, atol=1e-4)


def test_lines_are_those_that_polyfit_finds_group_by_group():
    rng = np.random.default_rng(3)
    of = rng.permutation(np.repeat(np.arange(5), [2, 3, 10, 40, 7]))
    groups = Groups(of, 5)
    x, weight = rng.uniform(-50, 50, len(of)), rng.uniform(0.1, 4.0, len(of))
    y = 3.0 + 0.2 * x + rng.normal(0, 1, len(of))
    fit = groups.line(x, y, weight)
    for group in range(5):
        own = of == group
        slope, start = np.polyfit(x[own], y[own], 1, w=np.sqrt(weight[own]))
        np.testing.assert_allclose(fit.slope[group], slope, rtol=1e-8)
        np.testing.assert_allclose(fit.at(np.array([group]), np.zeros(1)), start, rtol=1e-8)
        np.testing.assert_allclose(fit.weight[group], weight[own].sum())
        about_mean = x[own] - np.average(x[own], weights=weight[own])
        np.testing.assert_allclose(fit.spread[group], (weight[own] * about_mean**2).sum())
