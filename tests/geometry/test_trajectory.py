"""Poses over time, odometry without its jumps, and how fast a robot moves."""

from collections import deque
from dataclasses import replace

import numpy as np
import pytest
from short_log import corridor_with_edges

from localiser.filter.events import Odometry, moves_between
from localiser.geometry import (
    UNKNOWN_TWIST,
    Array,
    Increment,
    Trajectory,
    arc_motion,
    between,
    bridged,
    compose,
    twist_at,
    wrap_angle,
)
from localiser.mapping import known_poses, wheels_of
from localiser.motion import MotionParameters
from localiser.storage import jump_text

STEP = np.array([0.0, -0.02, 0.01])
STEP_NS = 50_000_000


def driven(count: int = 100) -> Trajectory:
    poses = [np.array([3.0, -2.0, 1.0])]
    for _ in range(count - 1):
        poses.append(compose(poses[-1], STEP))
    return Trajectory(STEP_NS * np.arange(count), np.array(poses))


def restarted(track: Trajectory, at: int, origin: Array) -> Trajectory:
    """Return odometry that is at `origin` (3,) at the pose `at`, and goes on from there."""
    later = compose(origin, between(track.poses[at], track.poses[at:]))
    return Trajectory(track.t_ns, np.concatenate([track.poses[:at], later]))


def test_a_jump_is_bridged_by_the_step_before_it() -> None:
    track = driven()
    found, jumps = bridged(restarted(restarted(track, 40, np.zeros(3)), 70, np.array([0.0, 10.0, 0.0])))
    assert jumps.tolist() == [40, 70]
    np.testing.assert_allclose(between(found.poses[:-1], found.poses[1:]), np.tile(STEP, (99, 1)), atol=1e-9)


def test_a_turn_at_once_is_a_jump_and_a_first_one_stands_still() -> None:
    found, jumps = bridged(restarted(driven(), 1, np.array([3.0, -2.0, -1.0])))
    assert jumps.tolist() == [1]
    np.testing.assert_allclose(found.poses[1], found.poses[0], atol=1e-12)


def test_a_pace_that_is_no_robots_is_not_gone_on_with() -> None:
    """0.2 m between poses that were stamped 1 ms apart are no pace of 200 m/s for the 5 s until the base is back."""
    t_ns = np.array([0, 1_000_000, 5_001_000_000])
    found, jumps = bridged(Trajectory(t_ns, np.array([[0.0, 0.0, 0.0], [0.0, -0.2, 0.0], [90.0, 0.0, 0.0]])))
    assert jumps.tolist() == [2]
    np.testing.assert_allclose(found.poses[2], found.poses[1], atol=1e-12)


def test_poses_that_jump_all_the_time_take_no_longer_than_their_number() -> None:
    poses = np.zeros((20_000, 3))
    poses[1::2, 0] = 100.0
    found, jumps = bridged(Trajectory(STEP_NS * np.arange(len(poses)), poses))
    assert len(jumps) == len(poses) - 1
    np.testing.assert_array_equal(found.poses, 0.0)


@pytest.mark.parametrize("seconds", [0.001, 0.05, 5.0])
def test_fast_robots_and_noisy_stamps_do_not_jump(seconds: float) -> None:
    """5 m/s, or 0.2 m between two poses that were stamped at nearly the same time."""
    way = max(5.0 * seconds, 0.2)
    track = Trajectory(np.array([0, round(1e9 * seconds)]), np.array([[0.0, 0.0, 0.0], [0.0, -way, 0.2]]))
    found, jumps = bridged(track)
    assert not len(jumps)
    np.testing.assert_array_equal(found.poses, track.poses)
    assert not len(bridged(Trajectory(track.t_ns[:1], track.poses[:1]))[1])


def test_the_filter_moves_over_a_jump_as_before_it_whichever_image_it_falls_to() -> None:
    track = restarted(driven(), 42, np.zeros(3))
    waiting, told = deque[Odometry](), []
    total = Increment.from_mean(np.zeros(3))
    for t_ns, pose in zip(track.t_ns.tolist(), track.poses, strict=True):
        waiting.append(Odometry(t_ns, pose))
        if t_ns % (4 * STEP_NS) == 0 and t_ns:
            moves, at, jumped = moves_between(waiting, t_ns - 4 * STEP_NS, t_ns)
            np.testing.assert_allclose(at, pose, atol=1e-9)
            told.append(jumped)
            for move in moves:
                total = total.then(move)
    assert told.index(True) == 10 and sum(told) == 1
    expected = np.zeros(3)
    for _ in range(4 * len(told)):
        expected = compose(expected, STEP)
    np.testing.assert_allclose(total.mean, expected, atol=1e-6)


def test_a_jump_is_told_with_its_time_and_size() -> None:
    log, _ = corridor_with_edges()
    assert jump_text(log) == ""
    at = int(np.searchsorted(log.odometry.t_ns, log.start_ns + 6_000_000_000))
    way_m = float(np.hypot(*log.odometry.poses[at - 1, :2]))
    told = jump_text(replace(log, odometry=restarted(log.odometry, at, np.zeros(3))))
    assert f"jumps 1×, for the first time by {way_m:.1f} m after 6.0 s" in told


def test_a_map_is_built_from_odometry_as_if_the_base_had_not_restarted() -> None:
    log, _ = corridor_with_edges()
    at = len(log.odometry) // 2
    broken = replace(log, odometry=restarted(log.odometry, at, np.zeros(3)))
    whole, found = (known_poses(one, "odometry") for one in (log, broken))
    np.testing.assert_allclose(found.poses[:, :2], whole.poses[:, :2], atol=0.1)  # one step of 50 ms is not known
    sigma = MotionParameters()
    times = np.array([frame.t_ns for frame in log.frames])
    moves, mended = (wheels_of(one.odometry, times, sigma) for one in (log, broken))
    np.testing.assert_allclose(mended.motion, moves.motion, atol=0.05)


T_NS = np.arange(0, 1_000_000_001, 50_000_000)
READOUT_S = (0.0, 0.03)


def arc(turn_rad_s: float, speed_m_s: float) -> Trajectory:
    start, velocity = np.array([1.0, -2.0, 3.0]), np.array([0.1, -speed_m_s])
    moves = [arc_motion(velocity, turn_rad_s * t / 1e9, t / 1e9) for t in T_NS]
    return Trajectory(T_NS, compose(start, np.array(moves)))


@pytest.mark.parametrize("t_ns", [10_000_000, 430_000_000, 999_000_000, 1_200_000_000])
@pytest.mark.parametrize("turn_rad_s", [-1.5, 0.0, 1.0])
def test_a_constant_twist_is_found(turn_rad_s: float, t_ns: int) -> None:
    found = twist_at(arc(turn_rad_s, 0.6), t_ns, READOUT_S)
    assert found.turn_rad_s == pytest.approx(turn_rad_s, abs=1e-9)
    # The velocity of an arc is that at its start, in the robot's own frame: it does not change.
    assert (found.right_m_s, found.backward_m_s) == pytest.approx((0.1, -0.6), abs=0.03 * abs(turn_rad_s) + 1e-9)
    assert found.turn_sigma_rad_s == pytest.approx(0.05 * abs(turn_rad_s), abs=1e-9)


def test_later_poses_than_the_first_after_the_image_change_nothing() -> None:
    track, cut = arc(1.0, 0.5), 5
    other = track.poses.copy()
    other[cut + 1 :, 2] -= 1.0
    t_ns = int(T_NS[cut]) - 1_000_000
    assert twist_at(track, t_ns, READOUT_S) == twist_at(Trajectory(T_NS, other), t_ns, READOUT_S)


def test_a_turn_that_begins_is_less_certain() -> None:
    heading = np.maximum(T_NS - 500_000_000, 0) / 1e9
    track = Trajectory(T_NS, np.stack([np.zeros(len(T_NS)), np.zeros(len(T_NS)), heading], axis=-1))
    before, beginning, later = (twist_at(track, t_ns, READOUT_S) for t_ns in (490_000_000, 540_000_000, 840_000_000))
    assert before.turn_rad_s == 0.0 and before.turn_sigma_rad_s == 0.0
    assert beginning.turn_rad_s == pytest.approx(1.0) and beginning.turn_sigma_rad_s > 0.25
    assert later.turn_sigma_rad_s == pytest.approx(0.05)


def test_nothing_is_known_before_the_second_pose() -> None:
    track = arc(1.0, 0.5)
    assert twist_at(track, 0, READOUT_S) == UNKNOWN_TWIST
    assert twist_at(Trajectory(T_NS[:1], track.poses[:1]), 10**9, READOUT_S) == UNKNOWN_TWIST


def test_wheels_that_begin_to_count_anew_tell_nothing() -> None:
    track = arc(0.2, 0.5)
    poses = track.poses.copy()
    poses[10:, 0] += 10.0
    assert twist_at(Trajectory(T_NS, poses), int(T_NS[10]) - 1, READOUT_S) == UNKNOWN_TWIST


def test_rows_before_the_first_pose_tell_nothing() -> None:
    assert twist_at(arc(1.0, 0.5), 20_000_000, (-0.03, -0.02)) == UNKNOWN_TWIST


@pytest.mark.parametrize("scale", [1e-9, 1.0, 1e4])
def test_one_pose_is_the_same_to_the_last_bit_as_one_of_many(scale: float) -> None:
    one, other = scale * np.random.default_rng(1).normal(size=(2, 200, 3))
    for function in (compose, between):
        alone = np.array([function(a, b) for a, b in zip(one, other, strict=True)])
        assert alone.tobytes() == function(one, other).tobytes()


@pytest.mark.parametrize("angle", [0.0, -0.0, np.pi, -np.pi, 3 * np.pi, np.nextafter(np.pi, 0.0), -7.0, np.nan])
def test_one_angle_is_wrapped_to_the_last_bit_as_one_of_many(angle: float) -> None:
    assert wrap_angle(float(angle)).tobytes() == wrap_angle(np.array([angle])).tobytes()
