"""Save the state of a live run every few seconds, so that a restarted program is not lost."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from threading import Thread

from localiser.documents import read_bytes
from localiser.errors import InputError, OutputError
from localiser.filter import Start
from localiser.live.timeline import Timeline, is_driven
from localiser.localiser import Localiser, belongs_to
from localiser.storage import checkpoint_of, read_map, write_bytes

EVERY_S = 3.0
_BEGUN, _LOADED = "begun with the map", "loaded the map"  # notes with a state
MAX_BYTES = 2**30  # a state of ten million particles with five constant errors


@dataclass(slots=True, eq=False)
class Checkpoints:
    """Saves the state of a run, on a thread, because disks take their time. failed: is told when that did not work.

    begun_map: the file of the map that the run was begun with. loaded_map: of the map that a service loaded in its
    place; None while there is none.
    """

    path: Path
    failed: Callable[[str], None]
    begun_map: Path | None = None
    loaded_map: Path | None = None
    _due: float = 0.0
    _thread: Thread | None = None

    def save_if_due(self, localiser: Localiser, offset_ns: int) -> None:
        """Save every few seconds, unless the last one is still being written. offset_ns: of the robot's clock."""
        if time.monotonic() >= self._due and (self._thread is None or not self._thread.is_alive()):
            self._due = time.monotonic() + EVERY_S
            self._thread = Thread(target=self._write, args=(self._state_of(localiser, offset_ns),), name="checkpoint")
            self._thread.start()

    def close(self, localiser: Localiser | None, offset_ns: int) -> None:
        """Save how the run ended."""
        if self._thread is not None:
            self._thread.join()
        if localiser is not None and localiser.state.is_begun:
            self._write(self._state_of(localiser, offset_ns))

    def now_on(self, loaded_map: Path) -> None:
        """Save what belongs to a map that was loaded, from the next image on."""
        self.loaded_map, self._due = loaded_map, 0.0

    def _state_of(self, localiser: Localiser, offset_ns: int) -> bytes:
        maps = {_BEGUN: self.begun_map, _LOADED: self.loaded_map}
        return localiser.save(
            -offset_ns, {name: str(path.resolve()) for name, path in maps.items() if path is not None}
        )

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
    _identity: Mapping[str, str] = field(init=False)
    _notes: Mapping[str, str] = field(init=False)

    def __post_init__(self) -> None:
        """Read the state. Raises InputError where it is damaged."""
        self.content = read_bytes(self.path, MAX_BYTES)
        saved = checkpoint_of(self.content, self.path)
        self._identity, self._notes = saved.identity, saved.notes

    def map_file(self, begun_map: Path) -> Path | None:
        """Return the file of the map that the state belongs to: the run's, or the one that was loaded in its place.

        None where neither is that map any more. begun_map: what the run is begun with.
        """
        files = [begun_map]
        if self._notes.get(_BEGUN) == str(begun_map.resolve()) and _LOADED in self._notes:
            files.append(Path(self._notes[_LOADED]))
        return next((file for file in files if self._is_on(file)), None)

    def _is_on(self, map_file: Path) -> bool:
        try:
            return belongs_to(self._identity, read_map(map_file))
        except InputError:
            return False

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
