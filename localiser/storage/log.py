"""A recorded log: what was measured, in the order of time. It is the same for every format."""

from __future__ import annotations

import heapq
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from localiser.camera import Camera
from localiser.documents import Place, shown
from localiser.edges import BearingSensor
from localiser.errors import InputError
from localiser.filter import Anywhere, Odometry, Sighting, Start
from localiser.geometry import Trajectory, Twist, bridged
from localiser.landmarks import LandmarkMap
from localiser.storage.images import ImageEvent

Frame = ImageEvent | Sighting
NO_ODOMETRY = Trajectory(np.zeros(0, dtype=np.int64), np.zeros((0, 3)))
"""The odometry of a log that has images alone, such as a video."""
VISION_ALONE = {"increments.source": "vision"}
"""What such a log asks for: how the robot moved is taken from its images."""
Event = Start | Anywhere | Odometry | ImageEvent | Sighting


@dataclass(frozen=True, slots=True, eq=False)
class Log:
    """What a robot recorded.

    odometry: poses in the odometry's own frame; none where nothing but images was recorded. frames: images, or edges
    that were measured already, in the order of time. landmark_map, start, groundtruth (in the map frame): where the log
    has them. path: what was read.
    settings: what it says about the robot, as settings of the configuration by name, such as `motion.alpha1`.
    named: the landmarks that edges are said to belong to, by id, and where that is first said; without a map of its own
    `landmark_id` of an edge is the number of a landmark here, else in its map.
    restarts: where the robot was said to be later on, or that it was looked for. resumed: the state that a live run
    went on from, in place of its start, as the content of a checkpoint; empty for any other log.
    """

    name: str
    path: Path
    camera: Camera
    odometry: Trajectory
    frames: Sequence[Frame]
    landmark_map: LandmarkMap | None = None
    start: Start | None = None
    groundtruth: Trajectory | None = None
    settings: Mapping[str, Any] = field(default_factory=dict)
    named: Mapping[str, Place] = field(default_factory=dict)
    restarts: Sequence[Start | Anywhere] = ()
    resumed: bytes = b""

    @property
    def start_ns(self) -> int:
        """The time of the first event."""
        return min([self.frames[0].t_ns, *map(int, self.odometry.t_ns[:1])])

    @property
    def duration_s(self) -> float:
        """From the first to the last event."""
        return (max([self.frames[-1].t_ns, *map(int, self.odometry.t_ns[-1:])]) - self.start_ns) / 1e9

    @property
    def mount_moves(self) -> bool:
        """Whether the camera moves on the robot: images have mounts of their own."""
        return any(image.mount is not None for image in self.images)

    @property
    def landmark_ids(self) -> tuple[int | str, ...]:
        """The ids of the landmarks that `landmark_id` of an edge numbers."""
        return tuple(self.named) if self.landmark_map is None else self.landmark_map.ids

    def identified_on(self, landmark_map: LandmarkMap) -> Log:
        """Return the log with edges whose `landmark_id` is the number of the same landmark, by its id, on a map.

        Raises InputError for an edge of a landmark that is not on the map.
        """
        ids = self.landmark_ids
        number = {str(name): place for place, name in enumerate(landmark_map.ids)}
        moved = np.array([*(number.get(str(name), -1) for name in ids), -1], dtype=np.int64)
        frames: list[Frame] = []
        for frame in self.frames:
            if isinstance(frame, Sighting):
                before = frame.edges.landmark_id
                if (lost := before[(before >= 0) & (moved[before] < 0)]).size:
                    name, where = str(ids[lost[0]]), f"the map {shown(landmark_map.name)}".removesuffix(" ''")
                    problem = f"expected the id of a landmark of {where}, found {shown(name)}"
                    raise self.named.get(name, Place(str(self.path))).error(("landmark_id",), problem)
                frame = replace(frame, edges=replace(frame.edges, landmark_id=moved[before]))  # noqa: PLW2901
            frames.append(frame)
        return replace(self, frames=frames)

    @property
    def has_images(self) -> bool:
        """Whether the frames are images, not edges."""
        return isinstance(self.frames[0], ImageEvent)

    @property
    def images(self) -> list[ImageEvent]:
        """Those of the frames that are images."""
        return [frame for frame in self.frames if isinstance(frame, ImageEvent)]

    def twist_at(self, t_ns: int) -> Twist | None:
        """Return how the robot moved while it took the image of a time, by its wheels.

        None where that does not matter, because the camera takes all rows at once.
        """
        return self.camera.twist_at(self.odometry, t_ns)

    def events(self, start: Start | None = None, *, anywhere: bool = False) -> Iterator[Event]:
        """Yield everything in the order of time: the start first, odometry before an image of the same time.

        start: used in place of the log's own. anywhere: whether the log's own is passed over.
        """
        if first := start or (None if anywhere else self.start):
            yield first
        wheels = (Odometry(int(t_ns), pose) for t_ns, pose in zip(self.odometry.t_ns, self.odometry.poses, strict=True))
        yield from heapq.merge(wheels, self.frames, self.restarts, key=lambda event: event.t_ns)


@dataclass(frozen=True, slots=True)
class ReadOptions:
    """What a user may say of a log that is opened.

    sensor: stands in for the camera where a log has bearings only. topics: names of a bag's topics by what they are
    for. camera: a camera file in place of what a bag says of its camera.
    """

    sensor: BearingSensor = field(default_factory=BearingSensor)
    topics: Mapping[str, str] = field(default_factory=dict)
    camera: Path | None = None


class LogReader(Protocol):
    """Reads logs of one format."""

    @property
    def format(self) -> str:
        """Its name, as `open_log` takes it."""

    @property
    def looks_like(self) -> str:
        """What such a log is, for people."""

    @property
    def options(self) -> tuple[str, ...]:
        """Which of "topics" (`--topic`) and "camera" (`--camera`) it takes."""

    def recognises(self, path: Path) -> bool:
        """Whether `path` looks like a log of this format."""

    def read(self, path: Path, options: ReadOptions) -> Log:
        """Return the log; images are read later, one by one. Raises InputError."""


def require_odometry(log: Log, purpose: str) -> None:
    """Raise InputError where a log has no odometry, which `purpose` needs."""
    if not len(log.odometry):
        raise InputError(f"{purpose} needs odometry, which this log has not: it is images alone", path=log.path)


def thinned(log: Log, every_s: float) -> Log:
    """Return the log with the first frame, and of the others those at least `every_s` (to 1 %) after the one before."""
    least_ns, kept = 0.99 * every_s * 1e9, [log.frames[0]]
    for frame in log.frames[1:]:
        if frame.t_ns - kept[-1].t_ns >= least_ns:
            kept.append(frame)
    return require_overlap(replace(log, frames=kept))


def jump_text(log: Log) -> str:
    """Return how often the odometry of a log jumps, when and how far first, as a text for people; "" if never."""
    wheels, jumps = log.odometry, bridged(log.odometry)[1]
    if not len(jumps):
        return ""
    way_m = float(np.hypot(*(wheels.poses[jumps[0]] - wheels.poses[jumps[0] - 1])[:2]))
    return (
        f"The odometry jumps {len(jumps)}×, for the first time by {way_m:.1f} m after "
        f"{(int(wheels.t_ns[jumps[0]]) - log.start_ns) / 1e9:.1f} s, faster than a robot moves: did the base restart? "
        "There the robot was taken to have gone on as before."
    )


def require_overlap(log: Log) -> Log:
    """Return the log if odometry and frames share some time, or it has no odometry. Raises InputError."""
    if len(log.odometry) and not any(log.odometry.covers(frame.t_ns) for frame in log.frames):
        raise InputError(
            f"expected odometry during the images, found odometry from {log.odometry.t_ns[0]} to "
            f"{log.odometry.t_ns[-1]} ns and images from {log.frames[0].t_ns} to {log.frames[-1].t_ns} ns",
            path=log.path,
        )
    return log
