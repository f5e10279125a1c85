"""Save the state of a live run every few seconds, so that a restarted program is not lost."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from threading import Thread

from localiser.documents import read_bytes
from localiser.errors import OutputError
from localiser.filter import Start
from localiser.landmarks import LandmarkMap
from localiser.live.timeline import Timeline, is_driven
from localiser.localiser import Localiser, belongs_to
from localiser.storage import checkpoint_of, write_bytes

EVERY_S = 3.0
MAX_BYTES = 2**30  # a state of ten million particles with five constant errors


@dataclass(slots=True, eq=False)
class Checkpoints:
    """Saves the state of a run, on a thread, because disks take their time. failed: is told when that did not work."""

    path: Path
    failed: Callable[[str], None]
    _due: float = 0.0
    _thread: Thread | None = None

    def save_if_due(self, localiser: Localiser, offset_ns: int) -> None:
        """Save every few seconds, unless the last one is still being written. offset_ns: of the robot's clock."""
        if time.monotonic() >= self._due and (self._thread is None or not self._thread.is_alive()):
            self._due = time.monotonic() + EVERY_S
            self._thread = Thread(target=self._write, args=(localiser.save(-offset_ns),), name="checkpoint")
            self._thread.start()

    def close(self, localiser: Localiser | None, offset_ns: int) -> None:
        """Save how the run ended."""
        if self._thread is not None:
            self._thread.join()
        if localiser is not None and localiser.state.is_begun:
            self._write(localiser.save(-offset_ns))

    def _write(self, content: bytes) -> None:
        try:
            write_bytes(self.path, content, durably=True)
        except OutputError as error:
            self.failed(f"The state is not saved: {error}")


@dataclass(slots=True, eq=False)
class Resumed:
    """A run that goes on from what was saved. text: what there is to say of that. content: what it went on from."""

    path: Path
    text: str = field(default="", init=False)
    content: bytes = field(init=False)

    def __post_init__(self) -> None:
        """Read the state. Raises InputError where it is damaged."""
        self.content = read_bytes(self.path, MAX_BYTES)

    def is_on(self, landmark_map: LandmarkMap) -> bool:
        """Whether the state belongs to a map."""
        return belongs_to(checkpoint_of(self.content, self.path).identity, landmark_map)

    def begin(self, localiser: Localiser, timeline: Timeline, t_ns: int) -> Start:
        """Restore the saved state before the first image, which is at `t_ns`; return about where that is.

        Wheels that have gone on counting tell what happened in between; those that begin anew do not, and the robot
        is taken to be where it was. Raises InputError when the state belongs to another map, camera or setting.
        """
        localiser.restore(self.content, self.path)
        state, first = localiser.state, timeline.first_odometry
        if state.odometry and first is not None and is_driven(state.odometry[-1], first):
            timeline.resume(state.odometry[-1])
            self.text = "resumed; the wheels tell what happened in between"
        else:
            localiser.forget_wheels(t_ns if first is None else min(first.t_ns, t_ns))
            self.text = "resumed; the wheels begin anew, so the robot is taken to be where it was"
        self.content = localiser.save()
        found = state.belief.places(state.particles)[1]
        return Start(state.at_ns, found.pose, found.pose_cov)
