"""Where the robot may be, from one frame and nothing else."""

import numpy as np
import pytest
from cameras import floor_points
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from proposal_room import CAMERA, drawn_frames, room

from localiser import geometry
from localiser.edges import Edges
from localiser.geometry import wrap_angle
from localiser.landmarks import LandmarkMap
from localiser.observation import EdgeObservation, Frame, ObservationParameters, Sighting
from localiser.particles import POSE, Particles, log_sum
from localiser.relocalisation import GlobalLocalisation
from localiser.relocalisation.global_localisation import evenly_around
from localiser.relocalisation.hypotheses import Feet, from_three_bearings, from_two_bearings

ROOM = room()
LIKE = Particles(POSE, np.zeros((3, 5)), np.zeros(5))


def search_on(landmark_map, kind="line"):
    return GlobalLocalisation.of(EdgeObservation(CAMERA, ObservationParameters(kind=kind)), landmark_map)


def proposed(search, edges, seed=0):
    """Return the poses (N, 3) that an image proposes, their weights, and the log-likelihood of the image at them."""
    sighting = Sighting(0, edges)
    candidates, _ = search.proposed(LIKE, sighting, 1.0, np.random.default_rng(seed))
    cloud = candidates.particles
    fit = search.log_fit(cloud.poses, sighting) if len(cloud) else np.zeros(0)
    return cloud.poses, cloud.log_weight, fit


def beside(poses, pose, metres=0.25, degrees=5.0):
    near = np.hypot(*(poses[:, :2] - pose[:2]).T) < metres
    return near & (np.abs(wrap_angle(poses[:, 2] - pose[2])) < np.radians(degrees))


@pytest.mark.parametrize(("kind", "clutter", "least"), [("line", 0, 0.9), ("line", 15, 0.8), ("slope", 5, 0.6)])
def test_one_frame_proposes_the_true_pose(kind, clutter, least):
    """Of 25 random poses from which at least six landmarks are measured."""
    hits, search = [], search_on(ROOM, kind)
    for pose, edges in zip(*drawn_frames(ROOM, 90, seed=1, clutter=clutter), strict=True):
        if (edges.landmark_id >= 0).sum() >= 6 and len(hits) < 25:
            hits.append(beside(proposed(search, edges)[0], pose).any())
    assert len(hits) == 25
    assert np.mean(hits) >= least


def test_proposed_poses_weigh_what_even_draws_do():
    """The evidence of the true place, Σ prior / q · p(edges | pose): that by 30,000 even draws around it.

    With ten edges and no clutter, no other place has any.
    """
    search, rng, ratios, shares = search_on(ROOM), np.random.default_rng(1), [], []
    box = np.array([0.5, 0.5, np.radians(10.0)])
    for pose, edges in zip(*drawn_frames(ROOM, 60, seed=5), strict=True):
        if len(edges) >= 10:
            poses, log_weight, fit = proposed(search, edges)
            near = beside(poses, pose)
            even = pose + box * rng.uniform(-0.5, 0.5, (30_000, 3))
            log_even = log_sum(search.log_fit(even, Sighting(0, edges))[beside(even, pose)]) - np.log(len(even))
            log_even += search.region.log_density + np.log(box.prod())
            ratios.append(log_sum((log_weight + fit)[near]) - log_even)
            shares.append(np.exp(log_sum((log_weight + fit)[near]) - log_sum(log_weight + fit)))
    assert len(ratios) >= 10
    assert abs(np.median(ratios)) < 0.7 and np.quantile(np.abs(ratios), 0.8) < 1.5 and max(ratios) < 2.0
    assert np.median(shares) > 0.9


def test_weights_of_boxes_that_overlap_are_the_prior_of_what_they_cover():
    search, rng = search_on(ROOM), np.random.default_rng(0)
    centres = np.array([[0.0, 0.0, 3.1], [0.1, 0.05, -3.1], [2.0, 1.0, 0.0]])
    sums = [np.exp(evenly_around(centres, search.region, rng)[1]).sum() for _ in range(200)]
    width, depth, turn = 0.25 - 0.1, 0.25 - 0.05, np.pi / 18 - (2 * np.pi - 6.2)
    covered = 3 * 0.25 * 0.25 * np.pi / 18 - width * depth * turn
    assert np.mean(sums) == pytest.approx(covered * np.exp(search.region.log_density), rel=0.01)
    assert len(evenly_around(np.array([[90.0, 0.0, 0.0]]), search.region, rng)[0]) == 0


def test_bearings_alone_propose_the_pose():
    """No heights on the map, no ends measured: triples of bearings."""
    bare = LandmarkMap.from_points(room(14, seed=4).points)
    search, hits = search_on(bare), []
    for pose, edges in zip(*drawn_frames(bare, 60, seed=7), strict=True):
        edges.ends_px[:] = np.nan
        if len(edges) >= 5:
            hits.append(beside(proposed(search, edges)[0], pose).any())
    assert len(hits) >= 5
    assert np.mean(hits) >= 0.8


@pytest.mark.parametrize("landmark_map", [ROOM, LandmarkMap.from_points(np.zeros((1, 2)))], ids=["room", "lonely"])
def test_where_no_two_edges_can_be_two_landmarks_nothing_is_proposed(landmark_map):
    _, frames = drawn_frames(ROOM, 1, seed=8, clutter=10)
    few = frames[0] if len(landmark_map) == 1 else frames[0].take(np.arange(1))
    assert len(proposed(search_on(landmark_map), few)[0]) == 0


def test_the_same_seed_proposes_the_same():
    _, frames = drawn_frames(ROOM, 1, seed=9, clutter=10)
    one, other = (proposed(search_on(ROOM), frames[0], seed=7) for _ in range(2))
    for column, again in zip(one, other, strict=True):
        np.testing.assert_array_equal(column, again)


def test_a_floor_range_says_the_same_as_the_end_that_it_was_measured_from():
    """Edges of something that reports the range of their feet and no ends."""
    _, frames = drawn_frames(ROOM, 60, seed=5)
    edges = next(edges for edges in frames if len(edges) >= 12)
    view = Feet.of(Frame(edges, CAMERA))
    foot_px = np.take_along_axis(edges.ends_px, edges.ends_px[..., 1].argmax(axis=1)[:, None, None], axis=1)[:, 0]
    range_m = np.linalg.norm(floor_points(CAMERA, foot_px), axis=-1)
    bare = Edges.from_columns(edges.bearing, edges.bearing_sigma, edges.lean, edges.lean_sigma, foot_range_m=range_m)
    foot = Feet.of(Frame(bare, CAMERA)).foot
    seen = np.isfinite(foot) & np.isfinite(view.foot)
    assert seen.sum() >= 8
    # The end itself errs across the edge, not along the bearing, by half a pixel.
    np.testing.assert_allclose(foot[seen], view.foot[seen], atol=2e-3)


property_test = settings(max_examples=80)
seeds = st.integers(0, 100_000)


def scene(seed, count):
    """A pose, landmarks (count, 2) ahead of it, and at what bearings and ranges they are seen."""
    rng = np.random.default_rng(seed)
    pose = rng.uniform([-20, -20, -np.pi], [20, 20, np.pi])
    in_robot = rng.uniform([-3, -8], [3, -0.5], (count, 2))
    right, back = in_robot.T
    return pose, geometry.map_from_robot(pose, in_robot), np.arctan2(right, -back), np.hypot(right, back)


def circle_gap(points, position):
    """How far, relative to its radius, a position is from the circle through three points."""
    (ax, az), (bx, bz), (cx, cz) = points
    rows = 2 * np.array([[bx - ax, bz - az], [cx - ax, cz - az]])
    centre = np.linalg.solve(rows, [bx**2 - ax**2 + bz**2 - az**2, cx**2 - ax**2 + cz**2 - az**2])
    radius = np.hypot(*(points[0] - centre))
    return abs(np.hypot(*(position - centre)) - radius) / radius


def assert_contains(poses, pose, atol=1e-6):
    error = poses - pose
    error[:, 2] = wrap_angle(error[:, 2])
    assert np.nanmin(np.abs(error).max(axis=1)) < atol


@property_test
@given(seed=seeds)
def test_three_bearings_give_the_pose(seed):
    pose, points, bearing, _ = scene(seed, 3)
    assume(np.abs(np.linalg.det(np.c_[points, np.ones(3)])) > 0.1)  # not in one line
    assume(circle_gap(points, pose[:2]) > 0.05)
    assert_contains(from_three_bearings(points[None], bearing[None]), pose)


def test_on_the_circle_through_the_landmarks_no_pose_is_made_up():
    angle = np.radians([20.0, 80.0, 130.0])
    points = 3.0 * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    seen = geometry.robot_from_map(np.array([0.0, -3.0, np.pi]), points)
    bearing = np.arctan2(seen[:, 0], -seen[:, 1])
    assert np.isnan(from_three_bearings(points[None], bearing[None])).all()


def test_landmarks_behind_a_ray_give_no_pose():
    _, points, bearing, _ = scene(3, 3)
    bearing[0] = wrap_angle(bearing[0] + np.pi)
    assert np.isnan(from_three_bearings(points[None], bearing[None])).all()


@property_test
@given(seed=seeds, scale=st.floats(0.2, 5))
def test_two_bearings_and_the_ratio_of_ranges_give_the_pose(seed, scale):
    pose, points, bearing, range_m = scene(seed, 2)
    assume(np.hypot(*(points[0] - points[1])) > 0.05)
    found = from_two_bearings(points[None], bearing[None], scale * range_m[None])
    assert_contains(found, pose)


@property_test
@given(seed=seeds, ratio=st.floats(0.1, 10))
def test_whatever_the_ratio_both_bearings_are_held(seed, ratio):
    _, points, bearing, _ = scene(seed, 2)
    assume(np.abs(bearing[0] - bearing[1]) > 0.02)
    found = from_two_bearings(points[None], bearing[None], np.array([[ratio, 1.0]]))
    seen = geometry.robot_from_map(found, points)
    np.testing.assert_allclose(np.arctan2(seen[:, 0], -seen[:, 1]), bearing, atol=1e-8)
