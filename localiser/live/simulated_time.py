"""The time that a simulator, or a player of bags, tells on /clock, made to go on steadily."""

from __future__ import annotations

from dataclasses import dataclass

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
