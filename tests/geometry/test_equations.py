"""Floor poses, increments, trajectories and the paper's equations, each against an oracle of its own."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from localiser import geometry as g
from paper.slopes import (
    bearing_of_image_point,
    depth_from_slopes,
    lean_from_slope,
    motion_from_slopes,
    rotation_from_slopes,
    slope_from_point,
)

angles = st.floats(-np.pi, np.pi)
poses = st.tuples(st.floats(-50, 50), st.floats(-50, 50), angles).map(np.array)
tilts = st.floats(np.radians(1), np.radians(60))
bearings = st.floats(np.radians(-85), np.radians(85))
TILT = np.radians(20)


def assert_same_pose(found, expected, atol=1e-9):
    np.testing.assert_allclose(found[..., :2], expected[..., :2], atol=atol)
    np.testing.assert_allclose(g.wrap_angle(found[..., 2] - expected[..., 2]), 0, atol=atol)


def numerical_jacobian(function, at, step=1e-6):
    """Central differences: error about step² from curvature and 1e-16 / step from rounding, so 1e-9 is safe."""
    columns = [(function(at + step * axis) - function(at - step * axis)) / (2 * step) for axis in np.eye(len(at))]
    return np.stack(columns, axis=-1)


# -- angles -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("wrap", "period"), [(g.wrap_angle, 2 * np.pi), (g.wrap_half_turn, np.pi)])
@given(angle=st.floats(-100, 100))
def test_wrapping_keeps_the_direction_and_lands_in_one_period(wrap, period, angle):
    wrapped = wrap(angle)
    assert -period / 2 <= wrapped < period / 2
    turns = (angle - wrapped) / period
    assert abs(turns - round(turns)) < 1e-12


def test_both_ends_of_the_period_are_one_angle():
    np.testing.assert_array_equal(g.wrap_angle([np.pi, -np.pi]), [-np.pi, -np.pi])
    np.testing.assert_array_equal(g.wrap_half_turn([np.pi / 2, -np.pi / 2]), [-np.pi / 2, -np.pi / 2])


# -- poses ------------------------------------------------------------------------------------------------------------


def test_heading_zero_faces_minus_z_and_turns_anticlockwise_seen_from_above():
    np.testing.assert_allclose(g.forward([0, np.pi / 2]), [[0, -1], [-1, 0]], atol=1e-15)
    np.testing.assert_allclose(g.right([0, np.pi / 2]), [[1, 0], [0, -1]], atol=1e-15)


@given(pose=poses, right_m=st.floats(-5, 5), ahead_m=st.floats(-5, 5))
def test_robot_frame_is_right_and_backward(pose, right_m, ahead_m):
    in_map = pose[:2] + right_m * g.right(pose[2]) + ahead_m * g.forward(pose[2])
    np.testing.assert_allclose(g.map_from_robot(pose, [right_m, -ahead_m]), in_map, atol=1e-12)
    np.testing.assert_allclose(g.robot_from_map(pose, in_map), [right_m, -ahead_m], atol=1e-12)


@given(start=poses, end=poses)
def test_between_undoes_compose(start, end):
    assert_same_pose(g.compose(start, g.between(start, end)), end)
    assert_same_pose(g.between(start, g.compose(start, end)), end)
    assert -np.pi <= g.compose(start, end)[2] < np.pi and -np.pi <= g.between(start, end)[2] < np.pi, "wrapped"


@given(first=poses, second=poses, third=poses)
def test_compose_is_associative(first, second, third):
    assert_same_pose(g.compose(g.compose(first, second), third), g.compose(first, g.compose(second, third)))


def test_poses_broadcast_against_one_motion():
    starts = np.array([[1.0, 2.0, 0.3], [-1.0, 0.0, 3.0]])
    motion = np.array([0.1, -0.5, 0.4])
    expected = np.array([g.compose(start, motion) for start in starts])
    np.testing.assert_array_equal(g.compose(starts, motion), expected)


# -- interpolation along arcs -----------------------------------------------------------------------------------------


def drive(pose, velocity, turn_rate, duration, steps=2000):
    """Integrate x' = velocity turned by the heading, heading' = turn_rate; velocity is (right, backward).

    The midpoint rule errs by (turn / steps)² / 24 of the path: 1e-7 for a full half turn in 2000 steps.
    """
    step = duration / steps
    heading = pose[2] + turn_rate * step * (np.arange(steps) + 0.5)
    in_map = velocity[0] * g.right(heading) - velocity[1] * g.forward(heading)
    return np.array([*(pose[:2] + in_map.sum(axis=0) * step), pose[2] + turn_rate * duration])


@given(
    start=poses,
    velocity=st.tuples(st.floats(-1, 1), st.floats(-1, 1)),
    turn_rate=st.floats(-3.1, 3.1),
    fraction=st.floats(0, 1),
)
def test_interpolation_follows_the_path_of_constant_velocity(start, velocity, turn_rate, fraction):
    end = drive(start, velocity, turn_rate, 1.0)
    expected = drive(start, velocity, turn_rate, fraction)
    path = g.Trajectory(np.array([0, 10**12]), np.array([start, end]))
    assert_same_pose(path.at(round(1e12 * fraction)), expected, atol=2e-6)


@pytest.mark.parametrize("turn", [0.0, 1e-12, 1e-9, 2e-9, 1e-6])
def test_interpolation_of_nearly_straight_motion_is_the_chord(turn):
    path = g.Trajectory(np.array([0, 4]), np.array([[0, 0, 0], [0.2, -1.0, turn]]))
    np.testing.assert_allclose(path.at(1), [0.05, -0.25, turn / 4], atol=1e-6)


def test_trajectory_interpolates_between_poses_and_holds_the_ends():
    start_ns = 1_700_000_000_000_000_001  # of the size of a clock's time, where a float64 cannot hold single ns
    path = g.Trajectory(start_ns + np.array([0, 100, 300]), np.array([[0, 0, 3.1], [0, -1, -3.1], [2, -1, -3.1]]))
    np.testing.assert_allclose(path.at(start_ns + 100), path.poses[1], atol=1e-15)
    assert_same_pose(path.at(start_ns + 200), np.array([1, -1, -3.1]))
    assert path.at(start_ns + 101)[0] == pytest.approx(0.01, abs=1e-12)
    assert abs(path.at(start_ns + 50)[2]) == pytest.approx(np.pi, abs=1e-12)
    np.testing.assert_allclose(path.at(start_ns - 7), path.poses[0], atol=1e-15)
    np.testing.assert_allclose(path.at(start_ns + 900), path.poses[-1], atol=1e-15)
    assert [path.covers(start_ns + t) for t in (-1, 0, 300, 301)] == [False, True, True, False]


def test_sampled_trajectory_is_the_trajectory_at_each_time():
    path = g.Trajectory(np.array([0, 10, 20]), np.array([[0, 0, 0], [0, -1, 0.5], [-1, -2, 1.0]]))
    sampled = path.sampled([-5, 3, 10, 14])
    np.testing.assert_array_equal(sampled.t_ns, [-5, 3, 10, 14])
    np.testing.assert_array_equal(sampled.poses, [path.at(t) for t in (-5, 3, 10, 14)])
    assert path.sampled([]).poses.shape == (0, 3)


# -- increments -------------------------------------------------------------------------------------------------------

FIRST = g.Increment.from_mean([0.05, -0.8, 0.7], cov=np.array([[4, 1, 0], [1, 9, 2], [0, 2, 3]]) * 1e-6)
SECOND = g.Increment.from_mean([-0.1, 0.4, -1.2], cov=np.array([[5, -1, 1], [-1, 4, 0], [1, 0, 2]]) * 1e-6)


def test_increments_compose_and_add_their_paths():
    both = FIRST.then(SECOND)
    np.testing.assert_allclose(both.mean, g.compose(FIRST.mean, SECOND.mean))
    assert both.path_m == pytest.approx(np.hypot(0.05, 0.8) + np.hypot(0.1, 0.4))
    assert both.turned_rad == pytest.approx(0.7 + 1.2)


def test_covariance_of_composed_increments_is_of_first_order():
    both = np.concatenate([FIRST.mean, SECOND.mean])
    jacobian = numerical_jacobian(lambda v: g.compose(v[:3], v[3:]), both)
    cov = np.block([[FIRST.cov, np.zeros((3, 3))], [np.zeros((3, 3)), SECOND.cov]])
    # Relative 1e-8: the numerical Jacobian is good to 1e-9.
    np.testing.assert_allclose(FIRST.then(SECOND).cov, jacobian @ cov @ jacobian.T, rtol=1e-8, atol=1e-16)


@pytest.mark.parametrize("later", [SECOND, g.Increment.from_mean(SECOND.mean)])
def test_what_came_after_the_beginning_is_what_came_then(later: g.Increment) -> None:
    found = FIRST.then(later).since(FIRST)
    ways = ([one.cov[2, 2], one.path_m, one.turned_rad, *one.told, *one.mean] for one in (found, later))
    np.testing.assert_allclose(*ways, atol=1e-15)


# -- ROS --------------------------------------------------------------------------------------------------------------


def test_ros_axes_and_yaw():
    # Facing map -z is facing +y of ROS; one metre ahead is one metre up in y.
    np.testing.assert_allclose(g.ros_from_pose([2.0, -3.0, 0.0]), [2, 3, np.pi / 2])
    np.testing.assert_allclose(g.pose_from_ros([2.0, 3.0, np.pi / 2]), [2, -3, 0], atol=1e-15)


@given(pose=poses)
def test_ros_conversion_goes_both_ways(pose):
    assert_same_pose(g.pose_from_ros(g.ros_from_pose(pose)), pose)
    assert_same_pose(g.ros_from_pose(g.pose_from_ros(pose)), pose)
    assert -np.pi <= g.pose_from_ros(pose)[2] < np.pi and -np.pi <= g.ros_from_pose(pose)[2] < np.pi


@given(pose=poses, step_m=st.floats(0.1, 5))
def test_forward_in_ros_is_along_its_yaw(pose, step_m):
    ahead = np.append(pose[:2] + step_m * g.forward(pose[2]), pose[2])
    start, end = g.ros_from_pose(pose), g.ros_from_pose(ahead)
    np.testing.assert_allclose(end[:2] - start[:2], step_m * np.array([np.cos(start[2]), np.sin(start[2])]), atol=1e-9)


def test_ros_covariance_is_carried_by_the_jacobian_and_back():
    cov = np.array([[4.0, 1.0, 0.5], [1.0, 9.0, -2.0], [0.5, -2.0, 3.0]])
    jacobian = numerical_jacobian(g.ros_from_pose, np.array([1.0, 2.0, 0.3]))
    np.testing.assert_allclose(g.ros_cov_from_cov(cov), jacobian @ cov @ jacobian.T, atol=1e-8)
    np.testing.assert_array_equal(g.ros_cov_from_cov(g.ros_cov_from_cov(cov)), cov)


# -- slope, lean and bearing (design equations 1, 2 and 6) ------------------------------------------------------------


def slope_of_projected_edge(x, z, y_1, y_2, tilt):
    """The paper's long way, eqs. 1, 2, 5: tilt two points of a vertical edge, project both, take the slope."""
    s, c = np.sin(tilt), np.cos(tilt)
    (u_1, v_1), (u_2, v_2) = ((x / (y * s + z * c), (y * c - z * s) / (y * s + z * c)) for y in (y_1, y_2))
    return (v_2 - v_1) / (u_2 - u_1)


@given(
    bearing=bearings.filter(lambda b: abs(b) > 0.01),
    range_m=st.floats(0.5, 20),
    y_1=st.floats(-2, -0.1),
    y_2=st.floats(0.1, 2),
    tilt=tilts,
)
def test_slope_is_that_of_any_two_points_of_the_edge(bearing, range_m, y_1, y_2, tilt):
    x, z = range_m * np.sin(bearing), -range_m * np.cos(bearing)
    slope = slope_from_point(x, z, tilt)
    # The two points' differences cancel up to three digits.
    assert slope == pytest.approx(slope_of_projected_edge(x, z, y_1, y_2, tilt), rel=1e-9)
    assert lean_from_slope(slope) == pytest.approx(g.lean_from_bearing(np.arctan2(x, -z), tilt), abs=1e-12)


@given(bearing=bearings, tilt=tilts)
def test_bearing_survives_lean_and_slope(bearing, tilt):
    lean = g.lean_from_bearing(bearing, tilt)
    assert g.bearing_from_lean(lean, tilt) == pytest.approx(bearing, abs=1e-12)
    assert lean_from_slope(g.slope_from_lean(lean)) == pytest.approx(lean, abs=1e-12) and lean * bearing >= 0


def test_edge_straight_ahead_has_infinite_slope_and_no_lean():
    assert slope_from_point(0.0, -3.0, TILT) == np.inf
    assert lean_from_slope(np.inf) == lean_from_slope(-np.inf) == 0 and g.slope_from_lean(0.0) == np.inf
    assert g.lean_from_bearing(0.0, TILT) == g.bearing_from_lean(0.0, TILT) == 0


def test_lean_is_smooth_where_slope_changes_its_sign():
    left, right = slope_from_point(np.array([-1e-9, 1e-9]), -1.0, TILT)
    assert left < -1e9 < 1e9 < right
    np.testing.assert_allclose(lean_from_slope([left, right]), np.sin(TILT) * np.array([-1e-9, 1e-9]), rtol=1e-6)


def test_edge_beside_the_camera_lies_flat():
    assert abs(slope_from_point(2.0, 0.0, TILT)) == 0
    np.testing.assert_allclose(g.lean_from_bearing([np.pi / 2, -np.pi / 2], TILT), [np.pi / 2, -np.pi / 2])
    np.testing.assert_allclose(g.bearing_from_lean([np.pi / 2, -np.pi / 2], TILT), [np.pi / 2, -np.pi / 2])


@given(bearing=bearings, tilt=tilts)
def test_edge_behind_the_camera_has_the_line_of_the_one_opposite(bearing, tilt):
    x, z = np.sin(bearing), -np.cos(bearing)
    assert g.lean_from_bearing(np.arctan2(-x, z), tilt) == pytest.approx(g.lean_from_bearing(bearing, tilt), abs=1e-9)


def test_without_tilt_lean_is_zero_and_says_nothing():
    np.testing.assert_array_equal(g.lean_from_bearing([-1.0, 0.0, 1.0], 0.0), 0)
    without_tilt = [
        lambda: g.bearing_from_lean(0.1, 0.0),
        lambda: slope_from_point(1.0, -1.0, 0.0),
        lambda: g.bearing_per_lean(0.1, 0.0),
        lambda: rotation_from_slopes(1.0, 2.0, 0.0),
    ]
    for call in without_tilt:
        with pytest.raises(ValueError, match="tilt is 0"):
            call()


@given(bearing=bearings, tilt=tilts, e=st.floats(-0.5, 0.5))
def test_bearing_of_any_point_of_the_edge_line(bearing, tilt, e):
    a, higher = np.tan(bearing) * (np.cos(tilt) + np.array([e, e + 1]) * np.sin(tilt))
    assert bearing_of_image_point(a, e, tilt) == pytest.approx(bearing, abs=1e-12)
    # The line's inverse slope is the lean's tangent: equation 2 contains equation 1.
    assert higher - a == pytest.approx(np.tan(g.lean_from_bearing(bearing, tilt)), abs=1e-9)


# -- two views of one edge (design equations 4 and 5) -----------------------------------------------------------------


@given(bearing=st.floats(-1, 1), turn=st.floats(-1.5, 1.5), tilt=tilts)
def test_rotation_is_the_change_of_bearing(bearing, turn, tilt):
    landmark = np.array([np.sin(bearing), -np.cos(bearing)])
    turned = g.robot_from_map([0, 0, turn], landmark)
    slopes = (slope_from_point(x, z, tilt) for x, z in (landmark, turned))
    assert rotation_from_slopes(*slopes, tilt) == pytest.approx(turn, abs=1e-9)


@pytest.mark.parametrize("infinite", [np.inf, -np.inf])
def test_rotation_from_and_to_the_image_centre(infinite):
    slope = g.slope_from_lean(g.lean_from_bearing(0.3, TILT))
    assert rotation_from_slopes(infinite, slope, TILT) == pytest.approx(0.3)
    assert rotation_from_slopes(slope, infinite, TILT) == pytest.approx(-0.3)


@given(
    x=st.floats(0.2, 5) | st.floats(-5, -0.2),
    z_1=st.floats(-10, -0.5),
    d=st.floats(-3, -0.01) | st.floats(0.01, 3),
    tilt=tilts,
)
def test_depth_and_motion_from_two_slopes(x, z_1, d, tilt):
    m_1, m_2 = slope_from_point(x, z_1, tilt), slope_from_point(x, z_1 - d, tilt)
    # A motion of 1 cm at 10 m leaves 1e-3 of each slope as their difference.
    assert depth_from_slopes(m_1, m_2, d) == pytest.approx(z_1, rel=1e-11)
    assert motion_from_slopes(m_1, m_2, z_1) == pytest.approx(d, rel=1e-11)


def test_neither_an_edge_straight_ahead_nor_a_robot_that_stands_tells_depth():
    assert np.isnan(depth_from_slopes(2.0, 2.0, 0.0))
    m_1, m_2 = slope_from_point(0.0, np.array([-2.0, -1.5]), TILT)
    assert np.isnan(depth_from_slopes(m_1, m_2, -0.5)) and np.isnan(motion_from_slopes(m_1, m_2, -2.0))


def test_edge_that_comes_to_stand_beside_the_camera_gives_its_depth():
    m_1, m_2 = slope_from_point(1.0, np.array([-2.0, 0.0]), TILT)
    assert depth_from_slopes(m_1, m_2, -2.0) == pytest.approx(-2.0)
    assert motion_from_slopes(m_1, m_2, -2.0) == pytest.approx(-2.0) and depth_from_slopes(m_2, m_1, 2.0) == 0
    assert np.isnan(motion_from_slopes(m_2, m_1, 0.0))  # 0 m at first: the ratio of the depths is lost


@pytest.mark.parametrize("reach", [1.0, np.pi, 3.0 * np.pi, 100.0])
def test_wrapping_many_angles_is_wrapping_each(reach):
    angles = np.random.default_rng(0).uniform(-reach, reach, 500)
    np.testing.assert_array_equal(g.wrap_angle(angles), [float(g.wrap_angle(float(angle))) for angle in angles])


@pytest.mark.parametrize("reach", [0.1, np.pi, 1000.0])
def test_cosines_and_sines_of_many_angles_are_those_of_each(reach):
    angles = np.append(np.random.default_rng(0).uniform(-reach, reach, g.MANY), np.arange(-8, 9) * np.pi / 4)
    cos, sin = g.cos_sin(angles)
    np.testing.assert_allclose(cos, np.cos(angles), rtol=0, atol=3e-16)
    np.testing.assert_allclose(sin, np.sin(angles), rtol=0, atol=3e-16)
    assert np.isnan(g.cos_sin(np.full(g.MANY, np.nan))).all()
