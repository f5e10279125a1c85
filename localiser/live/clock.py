"""Check whether a time stamp can be true, and make the time go on steadily: of the robot's clock, and of /clock."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field

LATE_NS = 1_000_000_000
EARLY_NS = 250_000_000
AGREEING = 5
"""How far a stamp may lie behind the newest one, and ahead of what the time of its arrival allows; how many messages
in a row must agree with each other, and with nothing before them, for the clock to have jumped."""

_LEAD_DECAY = 1e-3  # of the time that passes: more than two clocks drift apart


@dataclass(slots=True, eq=False)
class RobotClock:
    """Turns stamps into times that go on steadily. offset_ns: what is added to stamps now.

    newest_ns: the latest time of any message that shows the clock, 0 before the first.
    """

    offset_ns: int = 0
    jumps: int = 0
    newest_ns: int = 0
    _lead_ns: float = 0.0
    _at_ns: int | None = None
    _doubtful: list[tuple[int, int]] = field(default_factory=list)

    def time_of(self, stamp_ns: int, at_ns: int) -> int | None:
        """Return the time of a message, None when its stamp cannot be true. at_ns: when it came, by any steady clock.

        A jump is believed after some messages that agree, and ends those it is made of: they return None too.
        """
        if self._at_ns is None:
            self.newest_ns, self._lead_ns, self._at_ns = stamp_ns, float(stamp_ns - at_ns), at_ns
            return stamp_ns
        lead_ns = self._lead_at(at_ns)
        if (t_ns := self.possible_time(stamp_ns, at_ns)) is not None:
            self._doubtful.clear()
            self.newest_ns = max(self.newest_ns, t_ns)
            self._lead_ns, self._at_ns = max(lead_ns, t_ns - at_ns), at_ns
            return t_ns
        return self._jumped(stamp_ns, at_ns, lead_ns)

    @property
    def is_known(self) -> bool:
        """Whether any message has come that shows the clock."""
        return self._at_ns is not None

    def possible_time(self, stamp_ns: int, at_ns: int) -> int | None:
        """Return the time of a message that tells nothing of the clock, None when its stamp cannot be true now.

        at_ns: see `time_of`. Before any message that tells of the clock, no stamp can be judged: None.
        """
        if self._at_ns is None:
            return None
        return None if self.is_late(stamp_ns) or self.is_early(stamp_ns, at_ns) else stamp_ns + self.offset_ns

    def is_late(self, stamp_ns: int) -> bool:
        """Whether a stamp lies too far behind the newest to be true now."""
        return self.is_known and stamp_ns + self.offset_ns < self.newest_ns - LATE_NS

    def is_early(self, stamp_ns: int, at_ns: int) -> bool:
        """Whether a stamp lies too far ahead of a time of arrival to be true."""
        return self.is_known and stamp_ns + self.offset_ns > at_ns + self._lead_at(at_ns) + EARLY_NS

    def shift(self, by_ns: int) -> None:
        """Take stamps that jump back by so much from now on, as is known from elsewhere: the time goes on steadily."""
        self.offset_ns += by_ns
        self._doubtful.clear()

    def _lead_at(self, at_ns: int) -> float:
        """Return by how much stamps are ahead of arrivals at most, as far as that is known at `at_ns`."""
        return self._lead_ns - _LEAD_DECAY * (at_ns - (self._at_ns or 0))

    def _jumped(self, stamp_ns: int, at_ns: int, lead_ns: float) -> int | None:
        if self._doubtful:
            last_ns, last_at_ns = self._doubtful[-1]
            if not last_ns - LATE_NS <= stamp_ns <= last_ns + (at_ns - last_at_ns) + EARLY_NS:
                self._doubtful.clear()
        self._doubtful.append((stamp_ns, at_ns))
        if len(self._doubtful) < AGREEING:
            return None
        self._doubtful.clear()
        self.jumps += 1
        t_ns = max(self.newest_ns + 1, round(at_ns + lead_ns))
        self.offset_ns = t_ns - stamp_ns
        self.newest_ns, self._lead_ns, self._at_ns = t_ns, float(t_ns - at_ns), at_ns
        return t_ns


SLACK_NS = 100_000_000
"""How far /clock may go back without having begun anew: messages of two networks may overtake each other."""

JUST_NS = 1_000_000_000
"""How long messages that were sent before /clock began anew may still come."""


@dataclass(slots=True, eq=False)
class SimulatedTime:
    """A clock in place of this machine's. It may stand still, run at any rate, and begin anew."""

    _clock_ns: int | None = None
    _offset_ns: int = 0
    _begun_ns: int | None = None

    @property
    def has_just_begun(self) -> bool:
        """Whether /clock has begun anew within the last second."""
        return self._begun_ns is not None and self.clock_ns - self._begun_ns < JUST_NS

    @property
    def is_known(self) -> bool:
        """Whether anything was heard of /clock yet."""
        return self._clock_ns is not None

    @property
    def clock_ns(self) -> int:
        """The newest time of /clock, 0 before the first."""
        return self._clock_ns or 0

    @property
    def now_ns(self) -> int:
        """The time that goes on steadily: after a jump back it does not go back."""
        return self.clock_ns + self._offset_ns

    def take(self, clock_ns: int, least_ns: int = 0) -> int:
        """Take a message of /clock. If it jumped back, return what makes up for that; else 0.

        least_ns: what is made up for at least, because some stamps were ahead of the clock.
        """
        back_ns = self.clock_ns - clock_ns if self.is_known else 0
        if back_ns > SLACK_NS:
            made_up_ns = max(back_ns + 1, least_ns)
            self._offset_ns += made_up_ns
            self._clock_ns = self._begun_ns = clock_ns
            return made_up_ns
        self._clock_ns = max(clock_ns, self.clock_ns)
        return 0


@dataclass(slots=True, eq=False)
class Clocks:
    """The clocks of a run. simulated: in place of this machine's; None where that counts. machine_ns: its own."""

    robot: RobotClock = field(default_factory=RobotClock)
    simulated: SimulatedTime | None = None
    machine_ns: Callable[[], int] = time.monotonic_ns

    @property
    def now_ns(self) -> int:
        """The time of arrivals, which goes on steadily."""
        return self.machine_ns() if self.simulated is None else self.simulated.now_ns

    def stamp_of(self, t_ns: int) -> int:
        """Return a time as the robot stamps it now."""
        return t_ns - self.robot.offset_ns

    def latency_ms(self, stamp_ns: int) -> float:
        """Return how long ago a stamp was: by the simulated time, else by this machine's calendar."""
        now_ns = time.time_ns() if self.simulated is None else self.simulated.clock_ns
        return (now_ns - stamp_ns) / 1e6
