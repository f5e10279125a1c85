"""What a live run knows, saved every few seconds, so that a program that starts again is not lost."""

from __future__ import annotations

import copy
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from threading import Thread

import numpy as np

from localiser import particles
from localiser.errors import OutputError
from localiser.filter import FilterState, Start
from localiser.live.located import Filter
from localiser.live.timeline import Timeline, is_driven
from localiser.localiser import identity
from localiser.storage import checkpoint_bytes, load_checkpoint, save_checkpoint

EVERY_S = 3.0


def _identity(filter_: Filter) -> dict[str, str]:
    return identity(filter_.config, filter_.landmark_map, filter_.camera)


@dataclass(slots=True, eq=False)
class Checkpoints:
    """Saves the state of a run, on a thread, because disks take their time. failed: is told when that did not work."""

    path: Path
    failed: Callable[[str], None]
    _due: float = 0.0
    _thread: Thread | None = None

    def save_if_due(self, filter_: Filter, offset_ns: int) -> None:
        """Save every few seconds, unless the last one is still being written. offset_ns: of the robot's clock."""
        if time.monotonic() >= self._due and (self._thread is None or not self._thread.is_alive()):
            self._due = time.monotonic() + EVERY_S
            self._thread = Thread(target=self._save, args=self._moment(filter_, offset_ns), name="checkpoint")
            self._thread.start()

    def close(self, filter_: Filter | None, offset_ns: int) -> None:
        """Save how the run ended."""
        if self._thread is not None:
            self._thread.join()
        if filter_ is not None and filter_.state.particles is not None:
            self._save(*self._moment(filter_, offset_ns))

    def _moment(self, filter_: Filter, offset_ns: int) -> tuple[FilterState, np.random.Generator, dict[str, str]]:
        """Return the state by the robot's clock, and what goes with it; arrays are never changed in place."""
        state = filter_.state
        wheels = deque(replace(pose, t_ns=pose.t_ns - offset_ns) for pose in state.odometry)
        moment = replace(state, at_ns=state.at_ns - offset_ns, odometry=wheels, waiting=deque())
        return moment, copy.deepcopy(filter_.rng), _identity(filter_)

    def _save(self, state: FilterState, rng: np.random.Generator, belongs_to: dict[str, str]) -> None:
        try:
            save_checkpoint(self.path, state, rng, belongs_to)
        except OutputError as error:
            self.failed(f"The state is not saved: {error}")


@dataclass(slots=True, eq=False)
class Resumed:
    """A run that goes on from what was saved. text: what there is to say of that. content: what it went on from."""

    path: Path
    text: str = field(default="", init=False)
    content: bytes = field(default=b"", init=False)

    def begin(self, filter_: Filter, timeline: Timeline, t_ns: int) -> Start:
        """Put the saved state into a filter whose first image is at `t_ns`; return about where that is.

        Wheels that have gone on counting tell what happened in between; those that begin anew do not, and the robot
        is taken to be where it was. Raises InputError when the state belongs to another map, camera or setting.
        """
        saved = load_checkpoint(self.path, _identity(filter_))
        state, first = saved.state, timeline.first_odometry
        if state.odometry and first is not None and is_driven(state.odometry[-1], first):
            timeline.resume(state.odometry[-1])
            self.text = "resumed; the wheels tell what happened in between"
        else:
            state.odometry.clear()
            state.at_ns, state.seen = t_ns if first is None else min(first.t_ns, t_ns), None
            self.text = "resumed; the wheels begin anew, so the robot is taken to be where it was"
        filter_.state, filter_.rng = state, saved.rng
        self.content = checkpoint_bytes(state, saved.rng, saved.identity)
        assert state.particles is not None
        found = particles.estimate(state.particles)
        return Start(state.at_ns, found.pose, found.pose_cov)
