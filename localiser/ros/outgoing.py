"""Build the messages of one located image, and the transform for every pose of the wheels."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from localiser.camera import Camera
from localiser.filter import Located, LocatedFrame
from localiser.geometry import Array
from localiser.landmarks import LandmarkMap, landmark_ends
from localiser.ros.diagnostics import LEAST_SURE, diagnostics
from localiser.ros.markers import landmark_markers, match_markers
from localiser.ros.outputs import OUTPUTS
from localiser.ros.path import DrivenPath
from localiser.ros.picture import annotated
from localiser.storage import map_text
from localiser.storage.bags import MAP, ODOM, OPTICAL, POSES, Messages, header

MOST_PARTICLES = 300


@dataclass(frozen=True, slots=True)
class Frames:
    """Names of the frames that messages speak of."""

    map: str = MAP
    odom: str = ODOM
    camera: str = OPTICAL


@dataclass(frozen=True, slots=True, eq=False)
class Message:
    """A message to send or to write. kind: one of OUTPUTS. stamp_ns: in its header. content: CDR, as ROS 2 has it."""

    kind: str
    stamp_ns: int
    content: bytes


@dataclass(slots=True, eq=False)
class Outgoing:
    """Makes messages of what was located. It knows the path so far, so there is one for each run.

    tolerance_ns: by how much the transform's stamp lies ahead of the pose of the wheels that it is for. kinds: what is
    made at all.
    """

    landmark_map: LandmarkMap
    camera: Camera
    frames: Frames = field(default_factory=Frames)
    tolerance_ns: int = 200_000_000
    kinds: Collection[str] = tuple(OUTPUTS)
    _make: Messages = field(default_factory=Messages)
    _path: DrivenPath = field(default_factory=DrivenPath)
    _located: Located | None = None
    _ends: Array = field(init=False)

    def __post_init__(self) -> None:
        self._ends = landmark_ends(self.landmark_map, self.camera)

    def map(self, stamp_ns: int) -> list[Message]:
        """Return the map as the text of its file, which is latched. To be sent when a run begins or its map changes."""
        if "map" not in self.kinds:
            return []
        return [self._message("map", stamp_ns, self._make.text(map_text(self.landmark_map)))]

    def landmarks(self, stamp_ns: int) -> list[Message]:
        """Return the map's landmarks to draw, which are latched like the map."""
        if "landmarks" not in self.kinds:
            return []
        markers = landmark_markers(self._make, self._ends, stamp_ns, self.frames.map)
        return [self._message("landmarks", stamp_ns, markers)]

    def image(
        self,
        frame: LocatedFrame,
        stamp_ns: int,
        wanted: Callable[[str], bool] = lambda kind: True,
        facts: Mapping[str, str] | None = None,
    ) -> list[Message]:
        """Return the messages of a located image, stamped with its time by the robot's clock.

        wanted: whether anybody needs a kind now; what nobody needs is not made. facts: more for the diagnostics, such
        as warnings of a live run. The transform is not among them: it goes out with the wheels, see `transform`.
        """
        self._located = frame.located
        makers: dict[str, Callable[[], Any]] = {
            "pose": lambda: self._pose(frame.located, stamp_ns),
            "particles": lambda: self._particles(frame.located, stamp_ns),
            "matches": lambda: match_markers(self._make, frame, self._ends, self.camera, stamp_ns, self.frames.map),
            "path": lambda: self._path.message(self._make, stamp_ns, self.frames.map),
            "image": lambda: annotated(self._make, frame, self._ends, self.camera, stamp_ns, self.frames.camera),
            "diagnostics": lambda: diagnostics(self._make, frame, stamp_ns, facts or {}),
        }
        if not self._path.grows(stamp_ns, frame.located.estimate.pose):
            del makers["path"]
        made = ((kind, make()) for kind, make in makers.items() if kind in self.kinds and wanted(kind))
        return [self._message(kind, stamp_ns, message) for kind, message in made if message is not None]

    def transform(self, stamp_ns: int) -> list[Message]:
        """Return the transform from the map to the odometry's frame for a pose of the wheels with this stamp.

        Empty before the first image was located, and while the last one is more likely wrong than right.
        """
        located = self._located
        if located is None or located.p_correct < LEAST_SURE or "tf" not in self.kinds:
            return []
        stamp_ns += self.tolerance_ns
        frames = (self.frames.map, self.frames.odom)
        message = self._make.map_from_odometry(stamp_ns, located.estimate.pose, located.odometry, frames)
        return [self._message("tf", stamp_ns, message)]

    def forget(self) -> None:
        """Begin anew: what was located before says nothing any more."""
        self._located, self._path = None, DrivenPath()

    def odometry_frame(self, name: str) -> None:
        """Take the name of the odometry's frame, as its messages have it."""
        self.frames = replace(self.frames, odom=name)

    def camera_frame(self, name: str) -> None:
        """Take the name of the camera's frame, as its images have it; nothing where they do not name it."""
        if name:
            self.frames = replace(self.frames, camera=name)

    def _message(self, kind: str, stamp_ns: int, message: Any) -> Message:
        return Message(kind, stamp_ns, self._make.encode(message))

    def _pose(self, located: Located, stamp_ns: int) -> Any:
        estimate = located.estimate
        return self._make.pose_in_map(stamp_ns, estimate.pose, estimate.pose_cov, self.frames.map)

    def _particles(self, located: Located, stamp_ns: int) -> Any:
        """Return a geometry_msgs/PoseArray of at most MOST_PARTICLES, each as likely as its weight."""
        poses = self._make.poses(spread_out(located))
        return self._make.make(POSES, header=header(stamp_ns, self.frames.map), poses=poses)


def spread_out(located: Located) -> Array:
    """Return poses (N, 3) of at most MOST_PARTICLES particles, chosen evenly by their cumulated weights."""
    cloud = located.particles
    count = min(len(cloud), MOST_PARTICLES)
    if not count:
        return np.zeros((0, 3))
    cumulated = np.cumsum(cloud.weight)
    at = (np.arange(count) + 0.5) / count * cumulated[-1]
    return np.asarray(cloud.poses[np.minimum(np.searchsorted(cumulated, at), len(cloud) - 1)])
