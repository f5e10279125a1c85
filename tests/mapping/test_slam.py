"""Poses and landmarks from a log alone: the smoother, the scale, loops, and whole drives."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest
from mapping_worlds import World, world
from ring_world import CAMERA, CONSTANTS, circle

from localiser import mapping
from localiser.edges import Edges
from localiser.geometry import Array, robot_from_map, wrap_angle
from localiser.landmarks import LandmarkMap
from localiser.mapping import Built, MappingParameters, Prior, Sightings
from localiser.mapping.factors import Problem, State, cost_of, linearise
from localiser.mapping.landmarks import fit_landmarks, triangulate
from localiser.mapping.loop_closure import same_landmarks
from localiser.mapping.place_recognition import recognise_groups
from localiser.mapping.sightings import Index
from localiser.mapping.smooth import Scale, dead_reckoning, scale_by_floor_contacts, smooth
from localiser.motion import MotionParameters


def disturbed() -> tuple[Problem, State]:
    problem, poses, points = circle(0.0, frames=12)
    rng = np.random.default_rng(1)
    poses, moved = (each + sigma * rng.standard_normal(each.shape) for each, sigma in ((poses, 0.02), (points, 0.1)))
    return problem, State(poses, moved, CONSTANTS, points)


def differences(value: Callable[[State], Any], state: State, count: int) -> Array:
    """Return the derivatives (V, ...) of a value by the V variables of a state, from two values beside it."""
    step = 1e-6 * np.eye(count)
    return np.array([(value(state.moved(each)) - value(state.moved(-each))) / 2e-6 for each in step])


def test_derivatives_agree_with_differences() -> None:
    problem, state = disturbed()
    dense = linearise(problem, state).jacobian.toarray()
    by_differences = differences(lambda at: linearise(problem, at).residual, state, dense.shape[1])
    np.testing.assert_allclose(-by_differences.T, dense, atol=1e-3, rtol=1e-4)


def test_the_step_goes_down_the_slope_of_the_cost() -> None:
    problem, state = disturbed()
    gradient = -2 * linearise(problem, state).normal()[1]
    by_differences = differences(lambda at: cost_of(problem, at), state, len(gradient))
    np.testing.assert_allclose(by_differences, gradient, rtol=1e-4, atol=1e-6 * np.abs(gradient).max())


def test_exact_measurements_give_the_exact_state() -> None:
    problem, poses, points = circle(0.0)
    start = dead_reckoning(problem.wheels)
    found = smooth(problem, start, points + 0.05, np.zeros(4), iterations=60)
    assert found.poses[:, :2] == pytest.approx(poses[:, :2], abs=2e-3)
    # On a circle, turns that are too large and a veer are one and the same.
    assert found.constants[[0, 3]] == pytest.approx(CONSTANTS[[0, 3]], abs=1e-3)
    assert np.linalg.norm(start[-1, :2] - poses[-1, :2]) > 0.1


def test_errors_of_landmarks_are_what_their_covariances_say() -> None:
    nees, between_two = [], []
    for seed in range(6):
        problem, poses, points = circle(1.0, seed)
        found = smooth(problem, poses, points, CONSTANTS)
        seen = np.unique(problem.bearings.landmark)
        error = (found.points - points)[seen]
        nees.append(np.einsum("li,lij,lj->l", error, np.linalg.inv(found.landmark_cov()[seen]), error) / 2)
        apart, cov = np.diff(error, axis=0), found.difference_cov(seen[1:], seen[:-1])
        between_two.append(np.einsum("li,lij,lj->l", apart, np.linalg.inv(cov), apart) / 2)
    assert 0.7 < np.mean(nees) < 1.4 and 0.7 < np.mean(between_two) < 1.4


# -- scale ------------------------------------------------------------------------------------------------------------


def edges_with_feet(true_scale: float, lifted_m: Array, seed: int = 0) -> tuple[Sightings, Array, Array]:
    """Return landmarks, some of which end above the floor, and cameras, both believed nearer by `true_scale`."""
    rng = np.random.default_rng(seed)
    count, height = len(lifted_m), CAMERA.mount.height_m
    points = np.stack([rng.uniform(-1.5, 1.5, count), rng.uniform(-5, -2, count)], axis=-1)
    frames = []
    poses = np.stack([np.zeros(6), np.linspace(0, -0.5, 6), np.zeros(6)], axis=-1)
    for pose in CAMERA.pose_in_map(poses):
        level = robot_from_map(pose, points)
        range_m = np.hypot(level[:, 0], level[:, 1])
        apparent = range_m * height / (height - lifted_m) * np.exp(0.005 * rng.standard_normal(count))
        bearing = np.arctan2(level[:, 0], -level[:, 1])
        foot = np.stack([apparent * np.sin(bearing), np.full(count, -height), -apparent * np.cos(bearing)], axis=-1)
        top = foot + np.array([0.0, 0.5, 0.0])
        ends = np.stack([CAMERA.project_level(foot), CAMERA.project_level(top)], axis=1)
        unknown = np.full(count, 0.01)
        frames.append(Edges.from_columns(bearing, unknown, bearing, unknown, ends_px=ends))
    cameras = CAMERA.pose_in_map(poses) / [true_scale, true_scale, 1]
    return Sightings.from_edges(frames, CAMERA), points / true_scale, cameras


@pytest.mark.parametrize("true_scale", [0.96, 1.0, 1.05])
def test_feet_on_the_floor_tell_the_scale_though_many_are_not(true_scale: float) -> None:
    lifted = np.concatenate([np.zeros(18), np.linspace(0.05, 0.25, 12)])
    sightings, points, cameras = edges_with_feet(true_scale, lifted)
    of = np.tile(np.arange(30), 6)
    scale = scale_by_floor_contacts(sightings, of, points, cameras, Scale(0.0, 0.05))
    assert scale.log == pytest.approx(np.log(true_scale), abs=0.01)
    assert scale.sigma < 0.01


# -- loops ------------------------------------------------------------------------------------------------------------


def test_landmarks_of_a_second_visit_join_those_of_the_first_despite_drift() -> None:
    places = np.array([[0.0, -3.0], [1.0, -3.5], [-1.2, -4.0], [2.0, -4.2]])
    frames, drift = 10, np.array([0.12, -0.08])
    cameras = np.stack([np.linspace(-0.5, 0.5, frames), np.zeros(frames), np.zeros(frames)], axis=-1)
    seen = []
    for _ in (np.zeros(2), drift):
        for camera in cameras:
            level = robot_from_map(camera, places)
            bearing = np.arctan2(level[:, 0], -level[:, 1])
            seen.append(Edges.from_columns(bearing, np.full(4, 1e-3), bearing, np.full(4, 1e-3)))
    sightings = Sightings.from_edges(seen, CAMERA)
    of = np.concatenate([np.tile(np.arange(4), frames), np.tile(np.arange(4, 8), frames)])
    believed = np.concatenate([cameras, cameras + np.array([*drift, 0.0])])
    built = fit_landmarks(sightings, of, believed, np.full(len(of), 1e-3))
    # The second visit is off as a whole by about 0.15 m; each place within a visit is good to 5 mm.
    joint = 0.005**2 * np.eye(16)
    common = np.kron(np.ones((4, 4)), 0.15**2 * np.eye(2))
    joint[8:, 8:] += common
    drifted = JointPlaces(built.fit.points, joint)
    assert same_landmarks(drifted, built, sightings.frame).tolist() == [0, 1, 2, 3, 0, 1, 2, 3]
    certain = JointPlaces(built.fit.points, 2.5e-5 * np.eye(16))
    assert same_landmarks(certain, built, sightings.frame).tolist() == list(range(8))


@dataclass(frozen=True)
class JointPlaces:
    """Landmarks (L, 2) and the covariance (2 L, 2 L) of all of them."""

    points: Array
    cov: Array

    def landmark_cov(self) -> Array:
        blocks = self.cov.reshape(len(self.points), 2, len(self.points), 2)
        return np.asarray(blocks[np.arange(len(blocks)), :, np.arange(len(blocks))])

    def joint_difference_cov(self, one: Index, other: Index) -> Array:
        pick = np.zeros((len(one), len(self.points)))
        pick[np.arange(len(one)), one] += 1
        pick[np.arange(len(one)), other] -= 1
        whole = np.kron(pick, np.eye(2))
        return np.asarray(whole @ self.cov @ whole.T)

    def difference_cov(self, one: Index, other: Index) -> Array:
        joint = self.joint_difference_cov(one, other).reshape(len(one), 2, len(one), 2)
        return np.asarray(joint[np.arange(len(one)), :, np.arange(len(one))])


# -- whole drives -----------------------------------------------------------------------------------------------------


def aligned_error(found: Array, truth: Array) -> Array:
    """Return the distances (T,) of poses after the best rotation and translation."""
    one, other = found[:, :2] - found[:, :2].mean(axis=0), truth[:, :2] - truth[:, :2].mean(axis=0)
    left, _, right = np.linalg.svd(one.T @ other)
    turn = left @ np.diag([1.0, np.linalg.det(left @ right)]) @ right
    return np.linalg.norm(one @ turn - other, axis=1)


def drive_alone(drive: World, edges: list[Edges]) -> mapping.Slam:
    """Build from edges and odometry."""
    sightings = Sightings.from_edges(edges, drive.camera)
    wheels = mapping.wheels_of(drive.odometry, drive.odometry.t_ns, MotionParameters())
    prior = Prior.of(MotionParameters())
    return mapping.build_from_log(sightings, wheels, prior, np.zeros(3), drive.camera, MappingParameters())


@pytest.mark.slow
def test_a_drive_with_wrong_wheels_is_put_right() -> None:
    drive = world("corridor")
    found = drive_alone(drive, drive.edges(seed=0, clutter=1.0))
    error = aligned_error(found.poses, drive.truth.poses)
    wheels = aligned_error(drive.odometry.poses, drive.truth.poses)
    assert np.sqrt((error**2).mean()) < 0.05 and np.sqrt((wheels**2).mean()) > 0.2


def with_fence(drive: World, spacing_m: float, count: int) -> World:
    """Return the drive with a row of posts that look alike along a wall of the first corridor."""
    posts = np.column_stack([np.full(count, -0.93), -1.5 - spacing_m * np.arange(count)])
    known = drive.landmark_map
    bottom, top = np.append(known.bottom_m, np.zeros(count)), np.append(known.top_m, np.ones(count))
    whole = LandmarkMap.from_points(np.vstack([known.points, posts]), bottom_m=bottom, top_m=top)
    shown = np.repeat((drive.truth.poses[:, 1] > -9.0)[:, None], count, axis=1)
    return replace(drive, landmark_map=whole, visible=np.hstack([drive.visible, shown]))


@pytest.mark.slow
def test_posts_taken_for_their_neighbours_do_not_break_the_path() -> None:
    drive = with_fence(world("corridor"), 0.1, 40)
    found = drive_alone(drive, drive.edges(seed=0, clutter=1.0))
    assert found.loops_left_out is None
    assert np.sqrt((aligned_error(found.poses, drive.truth.poses) ** 2).mean()) < 0.025


@pytest.mark.slow
def test_a_camera_that_pans_gives_the_path_of_a_fixed_one() -> None:
    drive = world("corridor")
    edges = drive.edges(seed=0, clutter=1.0)
    pan = np.deg2rad(20.0) * np.sin(0.3 * np.arange(len(edges)))
    mount = drive.camera.mount
    # A camera that is turned to the left sees everything farther to the right.
    panned = [
        replace(frame, bearing=frame.bearing + angle, mount=replace(mount, yaw_rad=mount.yaw_rad + angle))
        for frame, angle in zip(edges, pan, strict=True)
    ]
    fixed, moving = drive_alone(drive, edges), drive_alone(drive, panned)
    np.testing.assert_allclose(moving.poses, fixed.poses, atol=1e-4)
    np.testing.assert_allclose(moving.constants, fixed.constants, atol=1e-4)
    np.testing.assert_allclose(wrap_angle(moving.cameras[:, 2] - fixed.cameras[:, 2]), pan, atol=1e-4)


# -- large loops ------------------------------------------------------------------------------------------------------


def visits(drifts: list[Array], repeats: bool = False) -> tuple[Array, Built, Index]:
    """Return landmarks of visits to one place, the later ones moved by drifts (3,), and the frames of sightings."""
    rng = np.random.default_rng(4)
    first = rng.uniform(-3, 3, (12, 2))
    if repeats:  # doors at equal steps: the place looks like itself one step on
        first = np.stack([np.repeat(np.arange(6) * 1.0, 2), np.tile([0.0, 2.0], 6)], axis=-1)
    parts = [first]
    for drift in drifts:
        cos, sin = np.cos(drift[2]), np.sin(drift[2])
        moved = first @ np.array([[cos, sin], [-sin, cos]]) + drift[:2] + 0.01 * rng.standard_normal(first.shape)
        parts.append(moved[4:8] if repeats else moved)
    visit = np.repeat(np.arange(len(parts)), [len(part) for part in parts])
    seen = np.arange(100 * len(parts))[:, None] // 20 == 5 * visit
    frame, landmark = np.nonzero(seen)
    return np.concatenate(parts), fitted_nowhere(landmark), frame


def test_a_group_that_fits_in_two_places_is_not_decided() -> None:
    points, built, frame = visits([np.array([0.4, 0.0, 0.0])], repeats=True)
    assert recognise_groups(points, built, frame).number.tolist() == list(range(len(points)))


def test_drift_by_more_than_the_spacing_is_followed_from_visit_to_visit_however_far_it_goes() -> None:
    points, built, frame = visits([number * np.array([2.0, -1.5, 0.25]) for number in range(1, 8)])
    assert recognise_groups(points, built, frame).number.tolist() == [*range(12)] * 8


def test_what_drifted_is_moved_back_and_the_way_to_it_evenly() -> None:
    drift = np.array([1.5, -0.8, 0.2])
    points, built, frame = visits([drift])
    found = recognise_groups(points, built, frame)
    poses = np.stack([np.linspace(-1, 1, 200), np.linspace(2, -2, 200), np.linspace(0, 1, 200)], axis=-1)
    cos, sin = np.cos(drift[2]), np.sin(drift[2])
    drifted = np.column_stack([poses[:, :2] @ np.array([[cos, sin], [-sin, cos]]) + drift[:2], poses[:, 2] - drift[2]])
    middle = int(found.frame[0])
    moved = found.moved(np.concatenate([poses[:100], drifted[100:]]))
    np.testing.assert_allclose(moved[120:], poses[120:], atol=0.03)
    np.testing.assert_array_equal(moved[0], poses[0])
    turned = wrap_angle(found.moved(np.tile(poses[:1], (200, 1)))[:, 2] - poses[0, 2])
    np.testing.assert_allclose(np.diff(turned[: middle + 1]), turned[middle] / middle, atol=1e-9)


def test_many_landmarks_of_a_second_visit_join_at_once() -> None:
    count, rng = 500, np.random.default_rng(5)
    first = np.stack([np.arange(count) * 0.1, rng.uniform(-3, 3, count)], axis=-1)
    points = np.concatenate([first, first + 0.003 * rng.standard_normal(first.shape)])
    frame = np.concatenate([np.arange(count), count + np.arange(count)])
    built = fitted_nowhere(np.arange(2 * count))
    joined = same_landmarks(JointPlaces(points, 1e-5 * np.eye(4 * count)), built, frame)
    assert (joined[count:] == np.arange(count)).mean() > 0.95


def fitted_nowhere(landmark: Index) -> Built:
    """Return landmarks of sightings (K,) that look like nothing in particular."""
    count = int(landmark.max()) + 1
    return Built(
        of=landmark,
        used=np.arange(len(landmark)),
        fit=triangulate(np.zeros(0, dtype=np.int64), count, np.zeros((0, 2)), np.zeros(0), np.zeros(0)),
        parallax=np.full(count, 0.5),
        count=np.bincount(landmark),
        side=np.full((count, 2), np.nan),
        polarity=np.zeros(count, dtype=np.int8),
    )


def test_wrong_bearings_do_not_bend_the_path() -> None:
    problem, poses, points = circle(1.0)
    bearing = problem.bearings.bearing.copy()
    bearing[::15] += 0.1
    wrong = replace(problem, bearings=replace(problem.bearings, bearing=bearing))
    found = smooth(wrong, poses, points, CONSTANTS)
    assert np.hypot(*(found.poses - poses)[:, :2].T).max() < 0.05


def test_feet_that_agree_on_nothing_tell_no_scale() -> None:
    sightings, points, cameras = edges_with_feet(1.0, np.linspace(0.05, 0.35, 30))
    scale = scale_by_floor_contacts(sightings, np.tile(np.arange(30), 6), points, cameras, Scale(0.0, 0.05))
    assert scale.sigma == np.inf
