"""Tilt and roll from the edges of one image; columns of edges."""

from dataclasses import replace

import numpy as np
import pytest
from edge_images import camera_of, wall_image
from hypothesis import given
from hypothesis import strategies as st

from localiser.edges import EdgeParameters, Edges, find_edges
from localiser.edges.find import vertical_segments as chosen_segments
from localiser.edges.mount import LENS_SIGMA, fit_mount, mount_error_of_edges, nadir_miss
from localiser.edges.types import BearingSensor, Segments, complete
from localiser.errors import InputError
from localiser.landmarks import LandmarkMap, sight

PLUMB_RAD = np.deg2rad(0.1)


def vertical_segments(camera, bearings_deg, heights=(-0.3, 0.2), sigma_px=0.3) -> Segments:
    """Return the exact images, in undistorted pixels, of vertical edges."""
    tangent = np.tan(np.deg2rad(bearings_deg))[:, None]
    e = np.array(heights)[None, :]
    tilt = camera.mount.tilt_rad
    upright = np.stack(np.broadcast_arrays(tangent * (np.cos(tilt) + e * np.sin(tilt)), e), axis=-1)
    return Segments.of_ends(camera.ideal.pixels_from_upright(upright), sigma_px)


@pytest.mark.parametrize("tilt_deg", [0.0, 5.0, 20.0, 45.0])
@pytest.mark.parametrize("roll_deg", [0.0, -4.0])
def test_derivative_by_tilt_and_roll_is_that_of_finite_differences(tilt_deg, roll_deg):
    camera = camera_of(tilt_deg=tilt_deg, roll_deg=roll_deg)
    segments = vertical_segments(camera, np.linspace(-25, 25, 7))
    miss, step = nadir_miss(segments, camera, PLUMB_RAD), 1e-6
    np.testing.assert_allclose(miss.angle, 0.0, atol=1e-9)
    for index, name in enumerate(("tilt_rad", "roll_rad")):
        moved = camera.with_mount(**{name: getattr(camera.mount, name) + step})
        numeric = (nadir_miss(segments, moved, PLUMB_RAD).angle - miss.angle) / step
        np.testing.assert_allclose(miss.per_mount[:, index], numeric, rtol=0.03, atol=0.002)


@pytest.mark.parametrize("roll_deg", [0.0, -4.0])
def test_derivative_by_the_lens_is_that_of_a_small_distortion(roll_deg):
    stated, lens_sigma = camera_of(tilt_deg=20.0, roll_deg=roll_deg), 1e-4
    half = np.array([(stated.width - 1) / 2, (stated.height - 1) / 2]) / stated.focal_px
    bent = replace(stated, distortion_model="plumb_bob", distortion=(lens_sigma / (half @ half), 0.0, 0.0, 0.0, 0.0))
    exact = vertical_segments(stated, np.linspace(-25, 25, 7), (0.05, 0.35))
    taken = Segments.of_ends(bent.pixels_from_image(stated.image_from_pixels(exact.ends_px)), 0.3)
    miss = nadir_miss(taken, stated, PLUMB_RAD, lens_sigma=lens_sigma)
    np.testing.assert_allclose(miss.per_mount[:, 2], -miss.angle, rtol=0.01, atol=1e-8)
    assert np.abs(miss.angle).max() > lens_sigma / 10
    assert not nadir_miss(taken, bent, PLUMB_RAD, lens_sigma=lens_sigma).per_mount[:, 2].any()


def told_by(edges, camera, prior_sigma_rad, plumb_sigma_rad, lens_sigma=LENS_SIGMA):
    ends = camera.image_from_pixels(edges.ends_px)
    return mount_error_of_edges(edges, ends, camera, prior_sigma_rad, plumb_sigma_rad, lens_sigma=lens_sigma)


def test_a_lens_that_bends_what_it_is_said_not_to_does_not_turn_the_camera():
    """Edges in the upper half alone lean as if the camera were tilted; those below the middle tell the two apart."""
    stated = camera_of(tilt_deg=10.0)
    bent = replace(stated, distortion_model="plumb_bob", distortion=(-0.06, 0.0, 0.0, 0.0, 0.0))
    bearings, nan = np.linspace(-27, 27, 24), np.full(32, np.nan)
    exact = [
        vertical_segments(stated, bearings, (0.1, 0.35)).ends_px,
        vertical_segments(stated, bearings[::3], (-0.35, -0.1)).ends_px,
    ]
    ends = bent.pixels_from_image(stated.image_from_pixels(np.concatenate(exact)))
    edges = Edges.from_columns(nan, nan, nan, np.full(32, 1e-4), ends_px=ends)
    prior_rad, plumb_rad = np.deg2rad([3.0, 2.0]), np.deg2rad(0.1)
    told = [told_by(edges, stated, prior_rad, plumb_rad, lens_sigma=sigma) for sigma in (0.02, 0.0)]
    tilt, tilt_of_no_lens = (abs(np.rad2deg(error.mean[0])) for error in told)
    assert tilt < 0.3
    assert tilt_of_no_lens > 0.6
    assert tilt < 2 * np.rad2deg(np.sqrt(told[0].cov[0, 0]))


pixels_in_image = st.tuples(st.floats(0, 639), st.floats(0, 479))


@given(
    ends=st.tuples(pixels_in_image, pixels_in_image).filter(lambda ends: abs(ends[0][1] - ends[1][1]) > 5),
    tilt_deg=st.floats(5, 40),
    roll_deg=st.floats(-10, 10),
)
def test_miss_is_the_angle_to_the_line_through_middle_and_nadir(ends, tilt_deg, roll_deg):
    camera, ends = camera_of(tilt_deg=tilt_deg, roll_deg=roll_deg), np.array(ends)
    to_middle = ends.mean(axis=0) - camera.project_level([0.0, -1.0, 0.0])
    across = np.array([to_middle[1], -to_middle[0]]) / np.linalg.norm(to_middle)
    expected = abs((ends[1] - ends[0]) @ across) / np.linalg.norm(ends[1] - ends[0])
    for either_way in (ends, ends[::-1]):
        miss = nadir_miss(Segments.of_ends(either_way[None], 0.3), camera, PLUMB_RAD)
        assert abs(miss.angle[0]) == pytest.approx(expected, abs=1e-9)


def test_miss_is_positive_when_the_top_is_too_far_right():
    upright, top_right = np.array([[[319.5, 300.0], [319.5, 100.0]]]), np.array([[0, 0], [4, 0]])
    for sign in (1, -1):
        miss = nadir_miss(Segments.of_ends(upright + sign * top_right, 0.3), camera_of(), PLUMB_RAD)
        assert miss.angle[0] == pytest.approx(sign * 4 / 200, rel=0.1)


def test_edges_tell_a_wrong_tilt_and_roll_despite_lines_that_are_not_vertical():
    camera = camera_of(tilt_deg=20.0, roll_deg=1.0)
    true = vertical_segments(camera, np.linspace(-25, 25, 12))
    rng = np.random.default_rng(0)
    slanted = vertical_segments(camera, rng.uniform(-25, 25, 4))
    slanted.ends_px[:, 1, 0] += [25.0, 40.0, 30.0, 50.0]
    ends = np.concatenate([true.ends_px, slanted.ends_px])
    ends += rng.normal(0, 0.3, ends.shape) * [1.0, 0.0]
    stated = camera.with_mount(tilt_rad=np.deg2rad(19.0), roll_rad=np.deg2rad(0.5))
    error = fit_mount(nadir_miss(Segments.of_ends(ends, 0.3), stated, PLUMB_RAD), np.deg2rad([3.0, 1.0]))
    np.testing.assert_allclose(np.rad2deg(error.mean), [1.0, 0.5], atol=0.3)
    assert np.all(np.abs(error.mean - np.deg2rad([1.0, 0.5])) < 4 * np.sqrt(np.diag(error.cov)))


def test_without_edges_nothing_is_learnt():
    camera = camera_of()
    error = fit_mount(nadir_miss(Segments.of_ends(np.zeros((0, 2, 2)), 0.3), camera, PLUMB_RAD), np.array([0.05, 0.02]))
    np.testing.assert_allclose(error.mean, 0.0)
    np.testing.assert_allclose(np.sqrt(np.diag(error.cov)), [0.05, 0.02])


def test_tilt_cannot_be_told_from_an_edge_straight_ahead():
    camera = camera_of()
    error = fit_mount(nadir_miss(vertical_segments(camera, np.array([0.0])), camera, PLUMB_RAD), np.array([0.05, 0.05]))
    np.testing.assert_allclose(np.sqrt(error.cov[0, 0]), 0.05, rtol=1e-3)
    assert np.sqrt(error.cov[1, 1]) < 0.01


def test_edges_that_are_not_quite_straight_count_by_their_length():
    camera, rng = camera_of(tilt_deg=20.0), np.random.default_rng(0)
    long = vertical_segments(camera, np.linspace(-25, 25, 6), (-0.35, 0.3)).ends_px
    short = vertical_segments(camera, np.linspace(-24, 24, 20), (-0.03, 0.03)).ends_px
    ends, unknown = np.concatenate([long, short]), np.full(26, np.nan)
    normalised = []
    for _ in range(100):
        rough = ends + rng.normal(0, 0.35, ends.shape) * [1.0, 0.0]
        edges = Edges.from_columns(unknown, unknown, unknown, np.full(26, 1e-4), ends_px=rough)
        error = told_by(edges, camera, np.deg2rad([3.0, 3.0]), np.deg2rad(0.01), lens_sigma=0.0)
        normalised.append(error.mean / np.sqrt(np.diag(error.cov)))
    assert np.all(np.abs(np.std(normalised, axis=0) - 1) < 0.25)


def test_an_image_taken_with_a_wrong_tilt_gives_the_true_one():
    camera = camera_of(tilt_deg=20.0, roll_deg=1.0, k1=-0.1)
    image = wall_image(
        camera, [-22.0, -10.0, 3.0, 14.0, 24.0], [60.0, 120.0, 70.0, 150.0, 110.0, 180.0], noise_sigma=2.0
    )
    stated = camera.with_mount(tilt_rad=np.deg2rad(17.0), roll_rad=np.deg2rad(1.5))
    prior_rad = np.deg2rad([3.0, 1.0])
    edges = find_edges(image, stated, EdgeParameters(tilt_sigma_deg=3.0, roll_sigma_deg=1.0))
    error = told_by(edges, stated, prior_rad, PLUMB_RAD)
    np.testing.assert_allclose(np.rad2deg(error.mean), [3.0, -0.5], atol=0.2)


@pytest.mark.parametrize("crooked", [0.02, 0.5, 1.0, 2.0])
def test_sigmas_are_learnt_from_how_crooked_edges_are(crooked):
    """Ends err by 0.35 px and edges by 0.3° from plumb, times `crooked`: with 40 edges the factor is told."""
    camera, rng, count = camera_of(tilt_deg=20.0), np.random.default_rng(1), 40
    exact = vertical_segments(camera, np.linspace(-27, 27, count), (-0.25, 0.2)).ends_px
    long_px, unknown = exact[:, 0, 1] - exact[:, 1, 1], np.full(count, np.nan)
    normalised, told = [], []
    for _ in range(100):
        ends = exact + crooked * rng.normal(0, 0.35, exact.shape) * [1.0, 0.0]
        ends[:, 1, 0] += crooked * np.deg2rad(rng.normal(0, 0.3, count)) * long_px
        edges = Edges.from_columns(unknown, unknown, unknown, np.full(count, 1e-4), ends_px=ends)
        off = np.deg2rad(rng.normal(0, [0.5, 0.3]))
        moved = camera.with_mount(tilt_rad=camera.mount.tilt_rad + off[0], roll_rad=off[1])
        error = told_by(edges, moved, np.deg2rad([0.5, 0.3]), np.deg2rad(0.3))
        normalised.append((error.mean + off) / np.sqrt(np.diag(error.cov)))
        told.append(error.crooked)
    if crooked < 0.1:
        assert np.median(told) < 0.3
    else:
        np.testing.assert_allclose(np.median(told), crooked, rtol=0.15)
        np.testing.assert_allclose(np.std(normalised, axis=0), 1.0, atol=0.2)


def test_two_edges_are_taken_to_be_as_crooked_as_is_stated():
    camera = camera_of(tilt_deg=20.0)
    ends = vertical_segments(camera, np.array([-20.0, 20.0])).ends_px
    unknown = np.full(2, np.nan)
    edges = Edges.from_columns(unknown, unknown, unknown, np.full(2, 1e-4), ends_px=ends)
    assert 0.6 < told_by(edges, camera, np.deg2rad([0.5, 0.3]), np.deg2rad(0.3)).crooked < 1.0


def test_a_vague_mount_is_found_from_wherever_it_is_stated():
    """Twelve vertical edges, and as many that agree on nothing; least squares alone end where they begin."""
    rng, truth = np.random.default_rng(4), camera_of(tilt_deg=20.0, roll_deg=1.0)
    vertical = vertical_segments(truth, np.linspace(-25, 25, 12), sigma_px=0.5)
    middle = rng.uniform([60, 60], [580, 420], (40, 2))
    reach = 60 * np.stack([rng.normal(0, 0.12, 40), np.ones(40)], axis=-1)
    clutter = np.stack([middle + reach, middle - reach], axis=1)
    ends = np.concatenate([vertical.ends_px, clutter])
    for tilt_off, roll_off in ((-5.0, 0.0), (5.0, 0.0), (0.0, 3.5), (-4.0, -3.0), (4.0, 3.0)):
        stated = camera_of(tilt_deg=20.0 + tilt_off, roll_deg=1.0 + roll_off)
        miss = nadir_miss(Segments.of_ends(ends, 0.5), stated, PLUMB_RAD)
        found = fit_mount(miss, np.deg2rad([3.0, 2.0]))
        np.testing.assert_allclose(np.rad2deg(found.mean), [-tilt_off, -roll_off], atol=0.35)
        if roll_off == 0.0:
            found = fit_mount(miss, np.deg2rad([3.0, 0.0]))
            np.testing.assert_allclose(np.rad2deg(found.mean), [-tilt_off, 0.0], atol=0.35)


@pytest.mark.parametrize("out_of_plumb_deg", [0.02, 0.5])
def test_how_far_an_edge_may_miss_depends_on_how_plumb_the_others_are(out_of_plumb_deg):
    camera, rng = camera_of(tilt_deg=20.0), np.random.default_rng(0)
    ends = vertical_segments(camera, np.linspace(-25, 25, 31)).ends_px
    long_px = ends[:, 0, 1] - ends[:, 1, 1]
    off_deg = rng.normal(0, out_of_plumb_deg, 31)
    off_deg[15] = 0.75
    ends[:, 1, 0] += np.deg2rad(off_deg) * long_px
    is_vertical, error = chosen_segments(
        Segments.of_ends(ends, 0.02), camera, np.deg2rad([0.5, 0.3]), np.deg2rad(0.3), 3.0
    )
    assert is_vertical[15] == (out_of_plumb_deg > 0.3)
    assert np.delete(is_vertical, 15).all()
    assert (error.crooked > 1) == (out_of_plumb_deg > 0.3)


def test_an_edge_of_no_known_direction_is_none():
    """`columns` looks up to 7.1° from vertical: where 3 sigmas are more, every line would pass."""
    camera = camera_of()
    ends = vertical_segments(camera, np.array([-10.0, 10.0])).ends_px
    for length_px, found in ((21.0, 2), (16.0, 1)):  # 3 sigmas are 6.6° and 8.5°
        ends[1, 1] = ends[1, 0] + (ends[1, 1] - ends[1, 0]) * length_px / np.linalg.norm(ends[1, 1] - ends[1, 0])
        segments = Segments.of_ends(ends, 0.55)
        blank = np.zeros((camera.height, camera.width), dtype=np.uint8)
        parameters = EdgeParameters(min_length_px=3.0)
        assert len(find_edges(blank, camera, parameters, detector=lambda *_, s=segments: s)) == found


def test_the_longest_edges_stay_in_their_order() -> None:
    edges = replace(Edges.from_bearings([0.1, 0.2, 0.3, 0.4], 0.01), length_px=np.array([50.0, np.nan, 200.0, 60.0]))
    np.testing.assert_array_equal(edges.longest(2).bearing, [0.3, 0.4])
    assert edges.longest(4) is edges and edges.longest(9) is edges
    unknown = Edges.from_bearings([0.1, 0.2, 0.3], 0.01)
    np.testing.assert_array_equal(unknown.longest(2).bearing, [0.1, 0.2])


angle = st.floats(-1.3, 1.3)
tilt = st.floats(0.05, 1.4) | st.floats(-1.4, -0.05)


@given(angle, st.floats(1e-4, 0.1), tilt)
def test_lean_from_bearing_and_back_is_the_same_edge(bearing: float, sigma: float, tilt_rad: float) -> None:
    b, s, unknown = np.array([bearing]), np.array([sigma]), np.array([np.nan])
    _, _, lean, lean_sigma = complete(b, s, unknown, unknown, tilt_rad)
    found, found_sigma, _, _ = complete(unknown, unknown, lean, lean_sigma, tilt_rad)
    np.testing.assert_allclose(found, b, atol=1e-12)
    np.testing.assert_allclose(found_sigma, s, rtol=1e-9)


@given(angle, st.floats(0.1, 1.4))
def test_sigma_of_the_lean_is_what_a_small_error_of_the_bearing_moves_it_by(bearing: float, tilt_rad: float) -> None:
    step = 1e-6
    both, sigmas, unknown = np.array([bearing, bearing + step]), np.full(2, step), np.full(2, np.nan)
    _, _, lean, lean_sigma = complete(both, sigmas, unknown, unknown, tilt_rad)
    np.testing.assert_allclose(lean[1] - lean[0], lean_sigma[0], rtol=1e-4)


def test_what_is_known_stays_as_it_is() -> None:
    known = [np.array([0.1]), np.array([0.01]), np.array([0.2]), np.array([0.02])]
    for found, given_value in zip(complete(*known, 0.3), known, strict=True):
        np.testing.assert_array_equal(found, given_value)


def test_without_tilt_neither_tells_of_the_other() -> None:
    unknown = np.array([np.nan])
    _, _, lean, lean_sigma = complete(np.array([0.1]), np.array([0.01]), unknown, unknown, 0.0)
    assert np.isnan(lean) and np.isnan(lean_sigma)


@pytest.mark.parametrize("range_m", [0.5, 2.0, 10.0])
def test_nominal_camera_sees_its_field_of_view_at_every_range(range_m: float) -> None:
    sensor = BearingSensor(half_view_deg=33.0)
    degrees = np.array([-35.0, -32.0, 0.0, 32.0, 35.0])
    bearing = np.radians(degrees)
    points = range_m * np.stack([np.sin(bearing), -np.cos(bearing)], axis=-1)
    seen = sight(sensor.camera(), np.zeros((1, 3)), LandmarkMap.from_points(points))
    np.testing.assert_array_equal(degrees[seen.landmark], [-32.0, 0.0, 32.0])


@pytest.mark.parametrize(
    ("bearing", "sigma", "told"),
    [
        (0.1, 0.01, r"bearing: expected \(E,\) finite numbers, found 0.1"),
        ([[0.1]], 0.01, r"bearing: expected \(E,\) finite numbers"),
        ([0.1, np.nan], 0.01, r"bearing: expected \(E,\) finite numbers"),
        (["left"], 0.01, r"bearing: expected \(E,\) finite numbers"),
        ([0.1], 0.0, "sigma: expected numbers above 0, found 0.0"),
        ([0.1], -0.01, "sigma: expected numbers above 0, found -0.01"),
        ([0.1], np.inf, r"sigma: expected one or \(1,\) finite numbers, found inf"),
        ([0.1, 0.2], [0.01] * 3, r"sigma: expected one or \(2,\) finite numbers"),
    ],
)
def test_bearings_that_cannot_be_are_refused(bearing: object, sigma: object, told: str) -> None:
    with pytest.raises(InputError, match=f"^{told}"):
        Edges.from_bearings(bearing, sigma)


def test_bearings_have_one_sigma_or_one_each() -> None:
    assert Edges.from_bearings([0, 1], 1).bearing_sigma.tolist() == [1.0, 1.0]
    assert Edges.from_bearings([0.1, 0.2], [0.01, 0.02]).bearing_sigma.tolist() == [0.01, 0.02]
    assert len(Edges.from_bearings([], 0.01)) == 0
