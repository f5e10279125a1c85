"""How fast a robot drives and turns at a time, from its poses."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from localiser.geometry.poses import arc_log, between
from localiser.geometry.trajectory import Trajectory

WHEELS_SHARE = 0.05
"""By which share wheels may misjudge a turn, 1 sigma."""
USUAL_TURN_RAD_S = 0.5
"""Turn rate of a robot of which nothing is known, 1 sigma."""
MOST_SPEED_M_S, MOST_TURN_RAD_S = 5.0, 20.0
"""Faster than any robot indoors: wheels that say more have begun to count anew."""


@dataclass(frozen=True, slots=True)
class Twist:
    """Velocity in the robot's own frame: to the right and backward (m/s), turning anticlockwise (rad/s).

    turn_sigma_rad_s: how certain the turn rate is, 1 sigma.
    """

    right_m_s: float = 0.0
    backward_m_s: float = 0.0
    turn_rad_s: float = 0.0
    turn_sigma_rad_s: float = 0.0


UNKNOWN_TWIST = Twist(turn_sigma_rad_s=USUAL_TURN_RAD_S)


def twist_at(track: Trajectory, t_ns: int, span_s: tuple[float, float]) -> Twist:
    """Return the mean twist during a span (begin, end) about a time, by poses up to the first one at or after the time.

    A running robot knows no later ones yet, so a span that ends later is moved to end there. The turn rate is as
    uncertain as wheels are, and as it has changed since as long before. Unknown before the second pose, and where no
    robot drives so fast.
    """
    last = min(int(np.searchsorted(track.t_ns, t_ns, side="left")), len(track) - 1)
    if last < 1:
        return UNKNOWN_TWIST
    known_ns, first_ns = int(track.t_ns[last]), int(track.t_ns[0])
    end_ns = min(t_ns + round(span_s[1] * 1e9), known_ns)
    length_ns = max(round((span_s[1] - span_s[0]) * 1e9), 1_000_000)
    begin_ns = max(end_ns - length_ns, first_ns)
    if begin_ns >= end_ns:
        return UNKNOWN_TWIST
    motion = between(track.at(begin_ns), track.at(end_ns))
    duration_s = (end_ns - begin_ns) / 1e9
    right, backward = arc_log(motion) / duration_s
    turn = float(motion[2]) / duration_s
    if np.hypot(right, backward) > MOST_SPEED_M_S or abs(turn) > MOST_TURN_RAD_S:
        return UNKNOWN_TWIST
    step_ns = max(length_ns, known_ns - int(track.t_ns[last - 1]))
    changed = turn - _turn_rate(track, max(begin_ns - step_ns, first_ns), begin_ns, turn)
    return Twist(float(right), float(backward), turn, float(np.hypot(WHEELS_SHARE * turn, changed / 2)))


def _turn_rate(track: Trajectory, begin_ns: int, end_ns: int, otherwise: float) -> float:
    """Return the mean turn rate between two times; `otherwise` where they are the same."""
    if end_ns <= begin_ns:
        return otherwise
    return float(between(track.at(begin_ns), track.at(end_ns))[2]) * 1e9 / (end_ns - begin_ns)
