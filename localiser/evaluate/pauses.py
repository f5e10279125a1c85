"""Pauses without a sighting, and how soon the position is right again after one."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from localiser.geometry import Array

# What makes a pause, and how long after it frames are judged apart (the data sets' own convention).
PAUSE_LONGER_THAN_S = 3.0
AFTER_PAUSE_S = 10.0
SEEN_WITHIN_S = 2.0
# Half the width of a doorway: closer than this a robot knows which side of a door frame it is on.
RECOVERED_WITHIN_M = 0.45


@dataclass(frozen=True, slots=True)
class Pause:
    """No sighting between these two times: of the last sighting before and of the first after."""

    start_ns: int
    end_ns: int

    @property
    def duration_s(self) -> float:
        """Length of the pause."""
        return (self.end_ns - self.start_ns) / 1e9


def find_pauses(t_ns: NDArray[np.int64], sighted: NDArray[np.bool_]) -> tuple[Pause, ...]:
    """Return the pauses longer than `PAUSE_LONGER_THAN_S`, from image times (T,) and whether edges were seen (T,).

    A run that begins blind begins with a pause; blindness that lasts until the end is none, for nothing comes after.
    """
    times = np.concatenate([t_ns[:1], t_ns[sighted]])
    long = np.flatnonzero(np.diff(times) > PAUSE_LONGER_THAN_S * 1e9)
    return tuple(Pause(int(times[i]), int(times[i + 1])) for i in long)


def seen_recently(t_ns: NDArray[np.int64], sighted: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return whether (T,) edges were seen at most `SEEN_WITHIN_S` ago at each image."""
    last = np.maximum.accumulate(np.where(sighted, np.arange(len(t_ns)), -1))
    return np.asarray((last >= 0) & (t_ns - t_ns[last] <= SEEN_WITHIN_S * 1e9))


def after_pauses(t_ns: NDArray[np.int64], pauses: tuple[Pause, ...]) -> NDArray[np.bool_]:
    """Return whether (T,) a pause ended at most `AFTER_PAUSE_S` ago at each image."""
    result = np.zeros(len(t_ns), dtype=bool)
    for pause in pauses:
        result |= (t_ns >= pause.end_ns) & (t_ns - pause.end_ns <= AFTER_PAUSE_S * 1e9)
    return result


def recovery_s(t_ns: NDArray[np.int64], position_m: Array, pause: Pause, until_ns: int | None = None) -> float:
    """Return the time from the end of a pause until the position is right within `RECOVERED_WITHIN_M`.

    nan when it is not before `until_ns` (the next pause), or the end.
    """
    back = (t_ns >= pause.end_ns) & (position_m <= RECOVERED_WITHIN_M)
    if until_ns is not None:
        back &= t_ns <= until_ns
    return float((t_ns[back][0] - pause.end_ns) / 1e9) if back.any() else float("nan")
