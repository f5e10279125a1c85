"""Put images and poses of the wheels in the order of their times, and choose the image to weigh next."""

from __future__ import annotations

import bisect
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from itertools import pairwise, takewhile
from typing import Any

import numpy as np

from localiser.filter import Odometry, track_of
from localiser.geometry import MOST_SPEED_M_S, Array, Trajectory
from localiser.localiser import MeasuredImage
from localiser.storage.bags import image_decision, odometry_decision

MOST_WAITING = 8
MOST_ODOMETRY = 20_000
"""Images that wait for the wheels, and poses of the wheels that wait for an image: seconds, and minutes."""

PATIENCE_NS = 500_000_000
"""How long an image waits for wheels from which nothing comes, and what they may leave out between two poses."""


@dataclass(slots=True, eq=False)
class WaitingImage:
    """An image on its way. number: how many came before it. stamp_ns: by the robot's clock. at_ns: when it came.

    measured: once its edges are found. by_wheels: whether the wheels tell how the robot came there.
    """

    number: int
    t_ns: int
    stamp_ns: int
    at_ns: int
    message: Any
    measured: MeasuredImage | None = None
    by_wheels: bool = True


def is_driven(sooner: Odometry, later: Odometry) -> bool:
    """Whether a robot can have driven from one pose of its wheels to the next; else they have begun to count anew."""
    seconds = (later.t_ns - sooner.t_ns) / 1e9
    return seconds > 0 and float(np.hypot(*(later.pose - sooner.pose)[:2])) <= MOST_SPEED_M_S * seconds


@dataclass(slots=True, eq=False)
class Timeline:
    """What has arrived and is not settled. decided: is called for every image, and for every pose that is not used.

    is_ready: whether all else than odometry is there that an image needs, its mount.

    A pose of the wheels is settled once an image was weighed with a later one: what comes after that cannot count,
    or a replay, which knows all poses from the start, would not give the same result.
    """

    decided: Callable[[str], None]
    is_ready: Callable[[WaitingImage], bool] = lambda _: True
    needs_wheels: bool = True
    settled_ns: int = -1
    weighed_ns: int = -1
    newest_ns: int = -1
    heard_ns: int = -1
    late_odometry: int = 0
    skipped: dict[str, int] = field(default_factory=dict)
    _released: deque[Odometry] = field(default_factory=lambda: deque(maxlen=8))  # before the last image, one after
    _odometry: list[tuple[int, int, Array]] = field(default_factory=list)
    _frames: list[WaitingImage] = field(default_factory=list)

    def add_odometry(self, t_ns: int, number: int, pose: Array, at_ns: int) -> None:
        """Take in a pose (3,) of the wheels; number: how many came before it. at_ns: when it came."""
        self.heard_ns = at_ns
        place = bisect.bisect_left(self._odometry, t_ns, key=lambda row: row[0])
        if t_ns <= self.settled_ns:
            self.leave_out(t_ns, number, "late")
        elif place < len(self._odometry) and self._odometry[place][0] == t_ns:
            self.leave_out(t_ns, number, "came twice")
        else:
            self._odometry.insert(place, (t_ns, number, pose))
            self.newest_ns = max(self.newest_ns, t_ns)
            self._thin_out()

    def add_frame(self, frame: WaitingImage) -> None:
        """Take in an image."""
        if frame.t_ns <= self.weighed_ns:
            self.skip(frame, "late")
        elif any(waiting.t_ns == frame.t_ns for waiting in self._frames):
            self.skip(frame, "came twice")
        else:
            bisect.insort(self._frames, frame, key=lambda waiting: waiting.t_ns)
            if len(self._frames) > MOST_WAITING:
                oldest = self._frames.pop(0)
                self.skip(oldest, "waited for odometry" if oldest.t_ns > self.newest_ns else "newer image")

    def next(self, most: int, now_ns: int) -> WaitingImage | None:
        """Return the image to weigh now, if odometry has reached any; of those it has reached all but `most` are old.

        most: how many there is time for; at least the newest is taken. now_ns: by the clock of arrivals. Wheels that
        have gone silent are not waited for.
        """
        silent = self.heard_ns >= 0 and now_ns - self.heard_ns > PATIENCE_NS
        any_time = silent or not self.needs_wheels
        for frame in [frame for frame in self._frames if now_ns - frame.at_ns > PATIENCE_NS]:
            if not self.is_ready(frame):
                self.discard(frame, "no transforms")
        reached = [frame for frame in self._frames if any_time or frame.t_ns <= self.newest_ns]
        reached = list(takewhile(self.is_ready, reached))
        for frame in reached[: -max(most, 1)]:
            self._frames.remove(frame)
            self.skip(frame, "newer image")
        if not reached:
            return None
        frame = self._frames.pop(0)
        frame.by_wheels = not self.needs_wheels or self._wheels_tell(frame.t_ns)
        return frame

    @property
    def waiting(self) -> WaitingImage | None:
        """The newest image that still waits for the wheels."""
        return self._frames[-1] if self._frames else None

    @property
    def track(self) -> Trajectory:
        """The poses of the wheels about the last image and since."""
        return track_of(self._poses)

    @property
    def _poses(self) -> list[Odometry]:
        return [*self._released, *(Odometry(at_ns, pose) for at_ns, _, pose in self._odometry)]

    def release(self, frame: WaitingImage) -> Iterator[Odometry]:
        """Yield the poses of the wheels up to the first at or after an image that is weighed now; they are settled."""
        self.weighed_ns = frame.t_ns
        self.decided(image_decision(frame.number, frame.t_ns, by_wheels=frame.by_wheels))
        while self._odometry and self.settled_ns < frame.t_ns:
            self.settled_ns, _, pose = self._odometry.pop(0)
            self._released.append(Odometry(self.settled_ns, pose))
            yield self._released[-1]
        self.settled_ns = max(self.settled_ns, frame.t_ns)

    def discard(self, frame: WaitingImage, why: str) -> None:
        """Leave out an image that may be waiting."""
        self._frames = [waiting for waiting in self._frames if waiting is not frame]
        self.skip(frame, why)

    def leave_out(self, t_ns: int, number: int, why: str) -> None:
        """Leave out a pose of the wheels, and say why."""
        self.late_odometry += 1
        self.decided(odometry_decision(number, t_ns, why))

    def _wheels_tell(self, t_ns: int) -> bool:
        """Whether the wheels reported the whole way since the last image, if that was not long ago."""
        if t_ns > self.newest_ns:
            return False
        if t_ns - self.weighed_ns > 2 * PATIENCE_NS:
            return True  # edges tell less over so long a time than wheels that missed some of it
        return all(
            is_driven(sooner, later) and later.t_ns - sooner.t_ns <= PATIENCE_NS
            for sooner, later in pairwise(self._poses)
            if later.t_ns > self.weighed_ns and sooner.t_ns < t_ns
        )

    def restart(self, t_ns: int) -> int:
        """Return the time from which on a start holds that was stated for `t_ns`: not before what is settled."""
        start_ns = max(t_ns, self.settled_ns + 1, self.weighed_ns + 1)
        while self._frames and self._frames[0].t_ns < start_ns:
            self.skip(self._frames.pop(0), "before the start")
        self.weighed_ns = start_ns - 1
        return start_ns

    @property
    def first_odometry(self) -> Odometry | None:
        """The first pose of the wheels that is not settled."""
        return Odometry(self._odometry[0][0], self._odometry[0][2]) if self._odometry else None

    def resume(self, settled: Odometry) -> None:
        """Go on after the last pose that was settled in a run before, which is earlier than all that is here."""
        self._released.append(settled)
        self.settled_ns = self.weighed_ns = settled.t_ns

    def skip(self, frame: WaitingImage, why: str) -> None:
        """Leave an image out, and say why."""
        self.skipped[why] = self.skipped.get(why, 0) + 1
        self.decided(image_decision(frame.number, frame.t_ns, why))

    def _thin_out(self) -> None:
        """Keep every other pose when no image has come for very long: where the robot went stays exact."""
        if len(self._odometry) > MOST_ODOMETRY:
            for t_ns, number, _ in self._odometry[1:-1:2]:
                self.leave_out(t_ns, number, "no image for long")
            del self._odometry[1:-1:2]
