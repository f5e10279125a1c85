"""How fast a robot drives and turns, from poses: against motion of constant twist, and by what is known until then."""

from __future__ import annotations

import numpy as np
import pytest

from localiser.geometry import UNKNOWN_TWIST, Trajectory, arc_motion, compose, twist_at

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
