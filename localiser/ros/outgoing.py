"""Build the messages of one located image, with landmarks and matched edges to look at, and the transform of wheels."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from localiser.camera import Camera
from localiser.filter import LEAST_SURE, SURE, Located, LocatedFrame
from localiser.geometry import Array, wrap_angle
from localiser.image_files import decode
from localiser.landmarks import LandmarkMap, landmark_ends, predicted_lines
from localiser.ros.interfaces import OUTPUTS
from localiser.storage import encode_image, map_text
from localiser.storage.bags import MAP, ODOM, OPTICAL, Messages, RosType, header
from localiser.view import MATCHED, UNMATCHED, VISIBLE, Colour

_LINES, _ADD, _DELETE = 5, 0, 2  # LINE_LIST, ADD and DELETE of visualization_msgs/Marker
JPEG_QUALITY = 80
_SHIFT = 4  # bits after the point in the pixels that OpenCV draws to
_MARKER = "visualization_msgs/msg/Marker"
_POST_M, _SIGHT_M = 0.03, 0.01


def match_markers(make: Messages, found: LocatedFrame, ends: Array, camera: Camera, stamp_ns: int, frame: str) -> Any:
    """Return two markers: the landmarks that edges match, and lines to them from the camera. Without any, they go.

    ends: (L, 2, 3) of the landmarks. frame: the name of the map's.
    """
    landmark = found.matches.landmark
    seen = ends[np.unique(landmark[landmark >= 0])]
    x, z, _ = camera.pose_in_map(found.located.estimate.pose)
    here = np.broadcast_to([x, camera.mount.height_m, z], (len(seen), 3))
    sights = np.stack([here, seen.mean(axis=1)], axis=1)
    posts = _lines(make, stamp_ns, frame, "matched", seen, MATCHED, _POST_M)
    lines = _lines(make, stamp_ns, frame, "sights", sights, MATCHED, _SIGHT_M)
    return make.make(RosType.MARKERS, markers=[posts, lines])


def _lines(make: Messages, stamp_ns: int, frame: str, name: str, ends: Array, colour: Colour, width_m: float) -> Any:
    """Return a marker of lines with these ends (N, 2, 3) in the map; one that deletes it where there are none."""
    red, green, blue, alpha = (value / 255 for value in colour)
    return make.make(
        _MARKER,
        header=header(stamp_ns, frame),
        ns=name,
        type=_LINES,
        action=_ADD if len(ends) else _DELETE,
        pose={"orientation": {"w": 1.0}},
        scale={"x": width_m},
        color={"r": red, "g": green, "b": blue, "a": alpha},
        points=make.points(ends.reshape(-1, 3)),
    )


def annotated(
    make: Messages, frame: LocatedFrame, ends: Array, camera: Camera, stamp_ns: int, camera_frame: str = OPTICAL
) -> Any | None:
    """Return the image with expected landmarks, matched and unmatched edges; None where none can be decoded.

    ends: (L, 2, 3) of the landmarks in the map. camera_frame: the name of the camera's frame.
    """
    image = frame.image
    if isinstance(image, bytes):
        image = decode(image, cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION)
    if image is None:
        return None
    grey = image.ndim == 2
    pixels = np.asarray(cv2.cvtColor(image, cv2.COLOR_GRAY2BGR) if grey else image.copy(), dtype=np.uint8)
    pose = frame.located.estimate.as_seen.pose
    _, expected = predicted_lines(camera, pose, ends, frame.matches.visible)
    edges, matched = frame.located.edges, frame.matches.landmark >= 0
    known = np.isfinite(edges.ends_px).all(axis=(1, 2))
    _draw(pixels, expected, VISIBLE, 1)
    _draw(pixels, edges.ends_px[known & ~matched], UNMATCHED, 2)
    _draw(pixels, edges.ends_px[known & matched], MATCHED, 2)
    return make.compressed(stamp_ns, encode_image(pixels, ".jpg", JPEG_QUALITY), camera_frame)


def _draw(pixels: NDArray[np.uint8], lines: Array, colour: Colour, width: int) -> None:
    """Draw lines (N, S, 2) in pixels."""
    red, green, blue, _ = colour
    strips = [np.round(line * 2**_SHIFT).astype(np.int32) for line in lines]
    cv2.polylines(pixels, strips, False, (blue, green, red), width, cv2.LINE_AA, _SHIFT)


MOST_PARTICLES = 300
LEAST_PLACE = 0.02  # weight from which on a place is reported
MOST_POSES = 1000  # of the path
STEP_M, STEP_RAD = 0.1, np.deg2rad(10.0)
"""How far a robot moves or turns between two poses of the path."""
_NS = 10**9
NAME = "localiser: pose"
OK, WARN, ERROR = 0, 1, 2


def diagnostics(make: Messages, frame: LocatedFrame, stamp_ns: int, facts: Mapping[str, str]) -> Any:
    """Return the probability that the pose is correct, why it may not be, and the figures of the image.

    facts: more of them. Level: ERROR where the pose is more likely wrong than right, WARN where it is not sure.
    """
    located, landmark = frame.located, frame.matches.landmark
    sigma_m = float(np.sqrt(np.trace(frame.pose_cov[:2, :2])))
    sigma_deg = float(np.degrees(np.sqrt(frame.pose_cov[2, 2])))
    values = {
        "p_correct": f"{located.p_correct:.4f}",
        "reason": located.reason,
        "warning": located.warning,
        "sigma_m": f"{sigma_m:.4f}",
        "sigma_deg": f"{sigma_deg:.3f}",
        "edges": str(len(landmark)),
        "edges_matched": str(int((landmark >= 0).sum())),
        "wheels_are_wrong": str(located.wheels_are_wrong).lower(),
        "height_off_m": f"{located.height.mean_m:.3f}",
        "height_off_sigma_m": f"{located.height.sigma_m:.3f}",
        **facts,
    }
    level = OK if located.p_correct > SURE else WARN if located.p_correct >= LEAST_SURE else ERROR
    text = located.warning or located.reason or "sure of the pose"
    status = make.make(
        "diagnostic_msgs/msg/DiagnosticStatus",
        level=level,
        name=NAME,
        message=text,
        values=[make.make("diagnostic_msgs/msg/KeyValue", key=key, value=value) for key, value in values.items()],
    )
    return make.make(RosType.DIAGNOSTICS, header=header(stamp_ns, ""), status=[status])


@dataclass(slots=True, eq=False)
class DrivenPath:
    """Poses of one run. When there are too many, every other one is left out, so the whole path stays visible."""

    _stamps_ns: list[int] = field(default_factory=list)
    _poses: list[Array] = field(default_factory=list)

    def grows(self, stamp_ns: int, pose: Array) -> bool:
        """Take a pose (3,), and return whether it is far enough from the last one to be part of the path."""
        if self._poses:
            moved = pose - self._poses[-1]
            if np.hypot(*moved[:2]) < STEP_M and abs(wrap_angle(moved[2])) < STEP_RAD:
                return False
        if len(self._poses) >= MOST_POSES:
            del self._poses[1::2], self._stamps_ns[1::2]
        self._poses.append(np.asarray(pose))
        self._stamps_ns.append(stamp_ns)
        return True

    def message(self, make: Messages, stamp_ns: int, frame: str) -> Any:
        """Return a nav_msgs/Path."""
        types = make.store.types
        time, head, stamped = (
            types[name]
            for name in ("builtin_interfaces/msg/Time", "std_msgs/msg/Header", "geometry_msgs/msg/PoseStamped")
        )
        poses = [
            stamped(header=head(stamp=time(*divmod(at_ns, _NS)), frame_id=frame), pose=pose)
            for at_ns, pose in zip(self._stamps_ns, make.poses(np.array(self._poses)), strict=True)
        ]
        return make.make(RosType.PATH, header=header(stamp_ns, frame), poses=poses)


@dataclass(frozen=True, slots=True)
class Frames:
    """Names of the frames that messages speak of."""

    map: str = MAP
    odom: str = ODOM
    camera: str = OPTICAL


def map_frames(frame: str, landmark_map: LandmarkMap) -> dict[str, str]:
    """Return the name of each of several maps by that of its frame: `frame`, _ and the map's, as frames are called."""
    maps = landmark_map.maps
    if len(maps) == 1:
        return {frame: ""}
    return {f"{frame}_{re.sub('[^A-Za-z0-9_]', '_', one.name)}": one.name for one in maps}


@dataclass(frozen=True, slots=True, eq=False)
class Message:
    """A message to send or to write. kind: one of OUTPUTS. stamp_ns: in its header. content: CDR, as ROS 2 has it."""

    kind: str
    stamp_ns: int
    content: bytes


@dataclass(slots=True, eq=False)
class Outgoing:
    """Makes messages of what was located. It knows the path so far, so there is one for each run.

    Of several maps, landmarks, path and poses are those of the map that the robot was last located on, in its frame.

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
    _map_name: str = field(init=False)

    def __post_init__(self) -> None:
        maps = self.landmark_map.maps
        self._change_map(maps[0].name if len(maps) > 1 else "")

    def _change_map(self, name: str) -> None:
        self._map_name, self._path = name, DrivenPath()
        self._ends = landmark_ends(self.landmark_map.seen_on(name), self.camera)

    @property
    def map_frame(self) -> str:
        """The name of the frame of the map that is believed."""
        frames = map_frames(self.frames.map, self.landmark_map)
        return next(frame for frame, name in frames.items() if name == self._map_name)

    def map(self, stamp_ns: int) -> list[Message]:
        """Return the map as the text of its file, which is latched. To be sent when a run begins or its map changes."""
        if "map" not in self.kinds:
            return []
        return [self._message("map", stamp_ns, self._make.text(map_text(self.landmark_map)))]

    def landmarks(self, stamp_ns: int) -> list[Message]:
        """Return the map's landmarks to draw, which are latched like the map."""
        if "landmarks" not in self.kinds:
            return []
        here = self.landmark_map.is_on(self._map_name, self._ends[:, 0, [0, 2]])
        lines = _lines(self._make, stamp_ns, self.map_frame, "landmarks", self._ends[here], VISIBLE, _POST_M)
        return [self._message("landmarks", stamp_ns, self._make.make(RosType.MARKERS, markers=[lines]))]

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
        changed = frame.map_name != self._map_name
        if changed:
            self._change_map(frame.map_name)
        makers: dict[str, Callable[[], Any]] = {
            "pose": lambda: self._pose(frame, stamp_ns),
            "particles": lambda: self._particles(frame.located, stamp_ns),
            "matches": lambda: match_markers(self._make, frame, self._ends, self.camera, stamp_ns, self.map_frame),
            "places": lambda: self._make.text(json.dumps(places_of(frame, self.landmark_map))),
            "path": lambda: self._path.message(self._make, stamp_ns, self.map_frame),
            "image": lambda: annotated(self._make, frame, self._ends, self.camera, stamp_ns, self.frames.camera),
            "diagnostics": lambda: diagnostics(self._make, frame, stamp_ns, facts or {}),
        }
        if not frame.is_found or not self._path.grows(stamp_ns, frame.located.estimate.pose):
            del makers["path"]
        made = ((kind, make()) for kind, make in makers.items() if kind in self.kinds and wanted(kind))
        messages = [self._message(kind, stamp_ns, message) for kind, message in made if message is not None]
        return [*(self.landmarks(stamp_ns) if changed else []), *messages]

    def transform(self, stamp_ns: int) -> list[Message]:
        """Return the transform from the map to the odometry's frame for a pose of the wheels with this stamp.

        Empty before the first image was located, and while the last one is more likely wrong than right.
        """
        located = self._located
        if located is None or located.p_correct < LEAST_SURE or "tf" not in self.kinds:
            return []
        stamp_ns += self.tolerance_ns
        frames = (self.map_frame, self.frames.odom)
        message = self._make.map_from_odometry(stamp_ns, located.estimate.pose, located.odometry, frames)
        return [self._message("tf", stamp_ns, message)]

    def forget(self) -> None:
        """Begin anew: what was located before says nothing any more."""
        self._located, self._path = None, DrivenPath()

    def _message(self, kind: str, stamp_ns: int, message: Any) -> Message:
        return Message(kind, stamp_ns, self._make.encode(message))

    def _pose(self, frame: LocatedFrame, stamp_ns: int) -> Any:
        pose = frame.located.estimate.pose
        return self._make.pose_in_map(stamp_ns, pose, frame.pose_cov, self.map_frame)

    def _particles(self, located: Located, stamp_ns: int) -> Any:
        """Return a geometry_msgs/PoseArray of at most MOST_PARTICLES, chosen evenly by their cumulated weights."""
        cloud, count = located.particles, min(len(located.particles), MOST_PARTICLES)
        cumulated = np.cumsum(cloud.weight)
        at = (np.arange(count) + 0.5) / max(count, 1) * cumulated[-1:]
        poses = cloud.poses[np.minimum(np.searchsorted(cumulated, at), len(cloud) - 1)]
        here = self._make.poses(poses[self.landmark_map.is_on(self._map_name, poses)])
        return self._make.make(RosType.POSES, header=header(stamp_ns, self.map_frame), poses=here)


def places_of(frame: LocatedFrame, landmark_map: LandmarkMap) -> list[dict[str, Any]]:
    """Return the places where the robot may be, each with its map, pose and probability, the likeliest first.

    What is missing from 1 is the probability that it is at none of them.
    """
    located, clusters = frame.located, frame.located.clusters
    if clusters is None or not len(clusters):
        return []
    own = int(np.hypot(*(clusters.mean - located.estimate.pose)[:, :2].T).argmin())
    known = min(located.p_correct / max(float(clusters.weight[own]), 1e-9), 1.0)
    found, origin = [], landmark_map.origin(frame.map_name)
    for weight, mean in zip(clusters.weight, clusters.mean + origin, strict=True):
        if weight >= LEAST_PLACE:
            name = landmark_map.map_at(mean)
            pose = dict(zip(("x", "z", "heading"), (mean - landmark_map.origin(name)).tolist(), strict=True))
            found.append({"map": name, **pose, "probability": round(float(weight) * known, 4)})
    return found
