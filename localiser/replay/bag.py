"""Write a log together with what was located in it as one ROS 2 bag, for RViz, Foxglove, PlotJuggler and Rerun."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np

from localiser.errors import InputError
from localiser.filter import LocatedFrame
from localiser.geometry import Array
from localiser.landmarks import LandmarkMap
from localiser.ros import OUTPUTS, Message, Outgoing
from localiser.storage import Log, require_new_file
from localiser.storage.bags import (
    FILE_KINDS,
    TRANSFORMS,
    WHEELS_TOPIC,
    Messages,
    NewBag,
    check_times,
    floor_pose,
    log_messages,
    new_bag,
    write_message,
)

SUFFIXES = (".mcap", ".db3")


class ReplayBag:
    """A sink that writes a bag: everything that the log has, and the topics of `localiser.ros` beside it.

    Everything has the time of the log. The transform from the map to the odometry's frame is written for every pose of
    the wheels and for every image, with its own stamp; the one from there to the robot too, which a robot sends itself.
    A run that ends early leaves a bag until there.
    """

    def __init__(self, path: Path, log: Log, landmark_map: LandmarkMap, *, by_wheels: bool = True) -> None:
        """Prepare; the bag is made with the first image. Raises InputError, OutputError for a path that is taken.

        by_wheels: whether the wheels are the odometry of the run, and not its images.
        """
        if path.suffix not in SUFFIXES:
            raise InputError(f"expected a path that ends in {' or '.join(SUFFIXES)}, found {path}", field="--bag")
        require_new_file(path)
        check_times(log)
        self._path, self._log, self._by_wheels = path, log, by_wheels
        self._make = Messages()
        self._outgoing = Outgoing(landmark_map, log.camera, tolerance_ns=0)
        self._stack = ExitStack()
        self._bag: NewBag | None = None
        self._messages: Iterator[tuple[str, int, Any]] = iter(())
        self._next: tuple[str, int, Any] | None = None

    def frame(self, frame: LocatedFrame) -> None:
        """Write what the log has until an image, and what was located in it. Raises OutputError."""
        bag = self._bag or self._begun()
        t_ns = frame.located.t_ns
        self._write_log(bag, t_ns)
        for message in self._outgoing.image(frame, t_ns, facts=_facts(frame)):
            self._write(bag, message)
        self._write_transforms(bag, t_ns, None if self._by_wheels else frame.located.odometry)

    def close(self, complete: bool) -> None:
        """Write the rest of the log, if the run came to its end, and end the bag. Raises OutputError."""
        with self._stack:
            if complete and self._bag is not None:
                self._write_log(self._bag, None)

    def _begun(self) -> NewBag:
        bag = self._bag = self._stack.enter_context(new_bag(self._path, FILE_KINDS[self._path.suffix]))
        self._messages = log_messages(self._log, self._make)
        self._next = next(self._messages, None)
        for message in self._outgoing.landmarks(self._log.start_ns):
            self._write(bag, message)
        return bag

    def _write_log(self, bag: NewBag, until_ns: int | None) -> None:
        """Write what the log has until a time, or all of it."""
        while self._next is not None and (until_ns is None or self._next[1] <= until_ns):
            topic, t_ns, message = self._next
            write_message(bag, topic, t_ns, message)
            if topic == WHEELS_TOPIC and self._by_wheels:
                self._write_transforms(bag, t_ns, np.array(floor_pose(message)))
            self._next = next(self._messages, None)

    def _write_transforms(self, bag: NewBag, t_ns: int, odometry: Array | None) -> None:
        """Write map → odom, and odom → robot where a pose (3,) of the odometry is given, both for this time."""
        for message in self._outgoing.transform(t_ns):
            self._write(bag, message)
        if odometry is not None:
            driven = self._make.encode(self._make.robot_in_odometry(t_ns, odometry))
            bag.write(OUTPUTS["tf"].topic, TRANSFORMS, t_ns, driven)

    def _write(self, bag: NewBag, message: Message) -> None:
        output = OUTPUTS[message.kind]
        bag.write(output.topic, output.msgtype, message.stamp_ns, message.content, latched=output.latched)


def _facts(frame: LocatedFrame) -> dict[str, str]:
    """Return the error of a pose, where the truth is known."""
    if frame.truth is None:
        return {}
    return {"error_m": f"{np.hypot(*(frame.located.estimate.pose - frame.truth)[:2]):.4f}"}
