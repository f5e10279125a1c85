"""Maps and visibility; the oracle of visibility projects points along every edge, one by one."""

import gc
import weakref
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from localiser import geometry as g
from localiser.camera import Camera, Mount
from localiser.geometry.compiled import entry
from localiser.landmarks import (
    LandmarkMap,
    SightParameters,
    field_of_view_rad,
    half_view_rad,
    image_heights,
    in_camera,
    in_view_of_cells_loop,
    reach_of,
    sight,
)
from localiser.landmarks.landmark_map import MOST_PIECES, PIECE_M, Reach
from localiser.landmarks.visibility import visible_length_px

MARGIN_NONE = SightParameters(range_max_m=8.0, range_min_m=0.3, length_min_px=20.0, margin_px=0.0)


def make_camera(tilt_deg=20.0, **mount):
    mount = {"tilt_rad": np.radians(tilt_deg), "height_m": 1.2, **mount}
    return Camera(640, 480, 554.0, 554.0, 319.5, 239.5, Mount(**mount))


def visible_length_by_points(camera, tangent, ahead_m, bottom_m, top_m):
    """Project points along one edge, evenly by angle, and measure between the outermost that lie in the image."""
    low, high = (-1e9 if np.isnan(bottom_m) else bottom_m), (1e9 if np.isnan(top_m) else top_m)
    elevations = np.linspace(*np.arctan((np.array([low, high]) - camera.mount.height_m) / ahead_m), 20_001)
    points = np.stack(
        [np.full_like(elevations, tangent * ahead_m), ahead_m * np.tan(elevations), np.full_like(elevations, -ahead_m)],
        axis=-1,
    )
    pixels = camera.project_level(points)
    inside = ((pixels >= 0) & (pixels <= [camera.width - 1, camera.height - 1])).all(axis=-1)
    return np.hypot(*np.ptp(pixels[inside], axis=0)) if inside.any() else 0.0


# -- the map ----------------------------------------------------------------------------------------------------------


def test_map_of_points_knows_nothing_else():
    landmark_map = LandmarkMap.from_points(np.array([[1.0, -2.0], [3.0, -4.0]]), name="two")
    assert len(landmark_map) == 2
    assert landmark_map.ids == (0, 1)
    for unknown in (landmark_map.cov, landmark_map.bottom_m, landmark_map.top_m):
        assert len(unknown) == 2
        assert np.isnan(unknown).all()
    assert landmark_map.polarity.tolist() == [0, 0]


# -- visible length ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("tilt_deg", [0.0, 20.0, 50.0, -15.0])
@pytest.mark.parametrize("known", ["both", "bottom", "top", "neither"])
def test_visible_length_is_that_of_the_projected_edge(tilt_deg, known):
    rng, count = np.random.default_rng(2), 80
    camera = make_camera(tilt_deg)
    tangent, ahead_m = rng.uniform(-2.5, 2.5, count), rng.uniform(0.3, 6, count)
    bottom_m = rng.uniform(0, 1, count)
    top_m = bottom_m + rng.uniform(0.1, 2, count)
    bottom_m = np.where(known in {"both", "bottom"}, bottom_m, np.nan)
    top_m = np.where(known in {"both", "top"}, top_m, np.nan)
    expected = [visible_length_by_points(camera, *edge) for edge in zip(tangent, ahead_m, bottom_m, top_m, strict=True)]
    assert 5 < np.count_nonzero(expected) < count  # the draw has edges inside and outside
    found = visible_length_px(camera, tangent, *image_heights(camera, ahead_m, bottom_m, top_m))
    # Two neighbouring points are less than π/2e4 rad apart, which is 0.1 px; times two ends, more off the axis.
    np.testing.assert_allclose(found, expected, atol=0.5)


def test_with_roll_no_more_is_expected_than_the_image_shows():
    # The upright rectangle inside a rolled image is smaller than the image: corners are left out, nothing is made up.
    rng, count = np.random.default_rng(4), 120
    camera = make_camera(roll_rad=np.radians(5))
    tangent, ahead_m, bottom_m = rng.uniform(-0.9, 0.9, count), rng.uniform(0.3, 6, count), rng.uniform(0, 1, count)
    top_m = bottom_m + rng.uniform(0.1, 2, count)
    shown = [visible_length_by_points(camera, *edge) for edge in zip(tangent, ahead_m, bottom_m, top_m, strict=True)]
    found = visible_length_px(camera, tangent, *image_heights(camera, ahead_m, bottom_m, top_m))
    assert np.count_nonzero(found) > 40
    assert (found <= np.array(shown) + 0.5).all()


def test_margin_counts_edges_just_outside():
    camera = make_camera(0.0)
    tangent = np.array([322.0 / 554])  # 2.5 px right of the image's last column
    unknown = np.array([np.nan])
    assert visible_length_px(camera, tangent, *image_heights(camera, np.array([2.0]), unknown, unknown))[0] == 0
    assert visible_length_px(camera, tangent, *image_heights(camera, np.array([2.0]), unknown, unknown), margin_px=5.0)[
        0
    ] == pytest.approx(489)


def test_edge_straight_ahead_is_seen_from_bottom_to_top_of_the_image():
    camera, unknown = make_camera(), np.array([np.nan])
    ends = image_heights(camera, np.array([2.0]), unknown, unknown)
    assert visible_length_px(camera, np.array([0.0]), *ends)[0] == pytest.approx(479)


# -- which landmarks are seen -----------------------------------------------------------------------------------------


def test_pairs_are_those_that_a_plain_loop_finds():
    rng = np.random.default_rng(3)
    camera = make_camera(25.0)
    poses = np.column_stack([rng.uniform(-5, 5, (30, 2)), rng.uniform(-np.pi, np.pi, 30)])
    points, top_m = rng.uniform(-9, 9, (40, 2)), rng.uniform(0.2, 2.5, 40)
    landmark_map = LandmarkMap.from_points(points, bottom_m=np.zeros(40), top_m=top_m)
    found = sight(camera, poses, landmark_map, MARGIN_NONE)

    expected = {}
    for n, pose in enumerate(poses):
        for k, point in enumerate(points):
            x, z = g.robot_from_map(pose, point)
            if z < 0 and 0.3 <= np.hypot(x, z) <= 8.0:
                length = visible_length_by_points(camera, x / -z, -z, 0.0, top_m[k])
                assert abs(length - 20) > 0.1  # no draw so near the limit that the oracle cannot tell
                if length > 20:
                    expected[n, k] = (x / -z, np.hypot(x, z))
    assert len(expected) > 30
    assert list(zip(found.pose, found.landmark, strict=True)) == sorted(expected)
    columns = np.stack([found.tangent, found.range_m], axis=-1)
    np.testing.assert_allclose(columns, [expected[pair] for pair in sorted(expected)], atol=1e-9)


@pytest.mark.parametrize(("distance_m", "seen"), [(0.25, False), (0.35, True), (7.9, True), (8.1, False)])
def test_range_limits(distance_m, seen):
    landmark_map = LandmarkMap.from_points(np.array([[0.0, -distance_m]]))
    assert (len(sight(make_camera(), np.zeros((1, 3)), landmark_map, MARGIN_NONE).pose) == 1) is seen


def test_nothing_in_view_gives_no_pairs():
    landmark_map = LandmarkMap.from_points(np.array([[100.0, 100.0]]))
    found = sight(make_camera(), np.zeros((4, 3)), landmark_map)
    assert [len(column) for column in (found.pose, found.landmark, found.tangent, found.range_m)] == [0, 0, 0, 0]


@pytest.mark.parametrize("roll_deg", [90.0, 180.0, -90.0])
def test_a_camera_that_is_turned_sees_the_same_landmarks(roll_deg):
    landmark_map = LandmarkMap.from_points(np.random.default_rng(3).uniform(-6, 6, (60, 2)))
    upright = make_camera()
    turned = replace(make_camera(roll_rad=np.radians(roll_deg)), width=480, height=640, cx=239.5, cy=319.5)
    turned = turned if roll_deg != 180 else make_camera(roll_rad=np.pi)
    expected, found = (sight(camera, np.zeros((1, 3)), landmark_map, MARGIN_NONE) for camera in (upright, turned))
    assert len(expected.landmark) > 5
    np.testing.assert_array_equal(found.landmark, expected.landmark)
    assert half_view_rad(turned) == pytest.approx(half_view_rad(upright))
    assert field_of_view_rad(turned) == pytest.approx(field_of_view_rad(upright))


def listed(points, half_view, range_m, margin_m=0.5):
    """Return start and item of the lists of cells of 0.5 m and 32 headings, between -4 and 4 m."""
    per_unit, shape = np.array([2.0, 2.0, 32 / (2 * np.pi)]), np.array([16, 16, 32])
    low, every = np.array([-4.0, -4.0, -np.pi]), np.arange(shape.prod() + 1)
    reach = Reach.of(points, range_m + margin_m)
    ahead = (0.0, 0.0, 0.0)
    return entry(in_view_of_cells_loop)(every, low, per_unit, shape, ahead, points, half_view, range_m, reach)


@settings(max_examples=25)
@given(seed=st.integers(0, 10_000), half_view=st.floats(0.1, 1.5), margin_m=st.sampled_from([0.5, 0.1]))
def test_a_cell_lists_every_landmark_that_can_be_in_view(seed, half_view, margin_m):
    """Also where cells are larger than the lists are made for."""
    rng = np.random.default_rng(seed)
    points = rng.uniform(-4, 4, (30, 2))
    start, item = listed(points, half_view, 5.0, margin_m)
    poses = rng.uniform([-4, -4, -np.pi], [4, 4, np.pi], (50, 3))
    right, ahead = in_camera(poses, points)
    seen = (np.abs(np.arctan2(right, ahead)) <= half_view) & (np.hypot(right, ahead) <= 5.0)
    for pose, visible in zip(poses, seen, strict=True):
        column, row = ((pose[:2] + 4.0) * 2.0).astype(int)
        cell = (column * 16 + row) * 32 + int((pose[2] + np.pi) * 32 / (2 * np.pi)) % 32
        assert set(np.flatnonzero(visible)) <= set(item[start[cell] : start[cell + 1]])


def test_a_narrow_view_leaves_most_landmarks_out() -> None:
    points = np.random.default_rng(0).uniform(-4, 4, (30, 2))
    start, _ = listed(points, np.radians(30), 12.0)
    assert np.diff(start).mean() < 0.6 * len(points)


def scattered(count: int, side_m: float, seed: int = 0) -> LandmarkMap:
    return LandmarkMap.from_points(np.random.default_rng(seed).uniform(0, side_m, (count, 2)))


def beside(reach: Reach, point):
    """Return the list of the piece of floor that a point lies on."""
    x, z = np.floor((point - reach.low) * reach.per_m).astype(int).tolist()
    if not (0 <= x < reach.shape[0] and 0 <= z < reach.shape[1]):
        return np.zeros(0, dtype=np.int32)
    piece = x * reach.shape[1] + z
    return reach.item[reach.start[piece] : reach.start[piece + 1]]


def test_every_landmark_in_range_of_a_point_is_listed_and_far_ones_are_not():
    points = scattered(800, 120.0).points
    reach = Reach.of(points, 10.0)
    for point in np.random.default_rng(1).uniform(-20, 140, (200, 2)):
        listed = beside(reach, point)
        distance = np.hypot(*(points - point).T)
        assert set(np.flatnonzero(distance <= 10.0)) <= set(listed)
        assert (np.diff(listed) > 0).all()
        assert (distance[listed] <= 10.0 + 1.5 * PIECE_M).all()


def test_pieces_grow_where_landmarks_are_a_world_apart():
    points = np.array([[0.0, 0.0], [9e5, -9e5]])
    reach = Reach.of(points, 16.0)
    assert len(reach.start) <= MOST_PIECES + 2
    assert beside(reach, points[1]).tolist() == [1]


def test_it_is_made_once_for_a_map_and_goes_with_it():
    landmark_map = scattered(50, 20.0)
    assert reach_of(landmark_map, 12.0) is reach_of(landmark_map, 12.0)
    lives = weakref.ref(landmark_map)
    del landmark_map
    gc.collect()
    assert lives() is None
