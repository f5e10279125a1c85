"""Setup help: what is installed, what a robot sends, and whether camera, clock, mount and map fit together."""

from __future__ import annotations

import platform
import time
from collections import Counter, deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from importlib import metadata
from pathlib import Path
from threading import Event, Lock
from typing import Any, Literal

import cv2
import numpy as np

from localiser import __version__, mapping
from localiser.calibration import check_mount, clock_offset
from localiser.camera import Camera
from localiser.commands.edge_picture import save_picture as save_edge_picture
from localiser.config import Config
from localiser.edges import Edges, find_edges
from localiser.errors import InputError
from localiser.geometry import Trajectory
from localiser.landmarks import LandmarkMap
from localiser.live import Arrival, CameraSource, Transport, message_of, topic_for, type_of
from localiser.storage import Image, check_whole, decoded, encode_image, write_bytes
from localiser.storage.bags import CameraFinder, floor_pose, grey_image, image_file, stamp_of

State = Literal["ok", "warning", "missing"]
LIBRARIES = ("numpy", "opencv-python-headless", "numba", "rosbags", "rerun-sdk", "eclipse-zenoh")
MOST_KEPT = 400
CLOCK_S = 0.2
_SOURCE = Path("image")


@dataclass(frozen=True, slots=True)
class Finding:
    """One thing that was looked at."""

    what: str
    state: State
    text: str


def versions() -> Iterator[Finding]:
    """Yield what is installed."""
    yield Finding("localiser", "ok", f"{__version__}, Python {platform.python_version()} on {platform.system()}")
    for library in LIBRARIES:
        try:
            yield Finding(library, "ok", metadata.version(library))
        except metadata.PackageNotFoundError:
            hint = "; pip install 'eclipse-zenoh<2'" if library == "eclipse-zenoh" else ""
            yield Finding(library, "missing", f"not installed{hint}")


def camera_check(address: str, seconds: float) -> tuple[Finding, Image | None]:
    """Return whether a camera that OpenCV reads can be opened and how many frames a second come, and the last one."""
    times: list[float] = []
    newest: deque[Image] = deque(maxlen=1)

    def take(_t_ns: int, image: Image) -> None:
        times.append(time.monotonic())
        newest.append(image)

    try:
        source = CameraSource(address, take)
    except InputError as error:
        return Finding("camera", "missing", str(error)), None
    source.start()
    time.sleep(seconds)
    source.close()
    if len(times) < 2:
        text = f"opened, but {len(times)} frames in {seconds:g} s"
        return Finding("camera", "warning", text), newest[0] if newest else None
    height, width = newest[0].shape[:2]
    rate = (len(times) - 1) / (times[-1] - times[0])
    return Finding("camera", "ok", f"{width}×{height} pixels, {rate:.1f} frames a second"), newest[0]


def save_picture(path: Path, image: Image, camera: Camera | None, config: Config) -> None:
    """Write an image (H, W) or (H, W, 3) as PNG, with its edges where the camera is known. Raises OutputError."""
    if camera is None or image.shape[:2] != (camera.height, camera.width):
        write_bytes(path, encode_image(image, ".png", 100))
        return
    grey = np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY) if image.ndim == 3 else image, dtype=np.uint8)
    edges = find_edges(grey, camera, config.edges, with_probabilities=True)
    save_edge_picture(path, grey, camera, edges, title="what the camera sees")


@dataclass(slots=True, eq=False)
class Heard:
    """What was heard on a network, by topic. kept: the newest messages of the topics that the live mode listens to."""

    topics: Mapping[str, str]
    counts: Counter[str] = field(default_factory=Counter)
    types: dict[str, str] = field(default_factory=dict)
    sizes: Counter[str] = field(default_factory=Counter)
    kept: dict[str, deque[Arrival]] = field(default_factory=dict)
    seconds: float = 0.0
    _lock: Lock = field(default_factory=Lock)

    def listen(self, transport: Transport, seconds: float) -> None:
        """Listen to everything for some time; what is kept for latecomers is asked for too."""
        roles = {topic: role for role, topic in self.topics.items()}

        def take(topic: str, msgtype: str | None, content: bytes) -> None:
            with self._lock:
                self.counts[topic] += 1
                self.sizes[topic] += len(content)
                if msgtype:
                    self.types[topic] = msgtype
                if role := roles.get(topic):
                    arrivals = self.kept.setdefault(role, deque(maxlen=MOST_KEPT))
                    arrivals.append(Arrival(role, topic, content))

        transport.listen_to_all(take)
        fixed = topic_for("transforms", self.topics["transforms"])  # sent before now, and kept
        transport.subscribe(fixed, lambda content, source: take(fixed.name, fixed.msgtype, content))
        Event().wait(seconds)
        self.seconds = seconds

    def messages(self, role: str) -> Iterator[tuple[Arrival, Any]]:
        """Yield the messages of a role that can be read."""
        with self._lock:
            arrivals = list(self.kept.get(role, ()))
        for arrival in arrivals:
            try:
                yield arrival, message_of(arrival)
            except ValueError:
                continue


def topic_checks(heard: Heard) -> Iterator[Finding]:
    """Yield every topic with its rate, and which are missing."""
    for role, topic in heard.topics.items():
        if topic not in heard.counts and role not in ("moving_transforms", "initialpose", "groundtruth", "clock"):
            state: State = "missing" if role in ("image", "odometry") else "warning"
            yield Finding(topic, state, f"nothing heard in {heard.seconds:g} s; {role}: --set live.topics.{role}=NAME")
    roles = {topic: role for role, topic in heard.topics.items()}
    for topic, count in sorted(heard.counts.items()):
        known = roles.get(topic)
        kind = heard.types.get(topic) or (type_of(known, topic) if known else "")
        text = f"{count / heard.seconds:.1f} Hz, {heard.sizes[topic] / count / 1000:.1f} kB {kind}".rstrip()
        text = f"{known}, {text}" if known else text
        readable = known is None or any(True for _ in heard.messages(known))
        yield Finding(topic, "ok" if readable else "warning", text if readable else f"{text}; none can be read")


def clock_checks(heard: Heard) -> Iterator[Finding]:
    """Yield how far the stamps of images and wheels are behind this machine's calendar when they come."""
    lags = {}
    for role in ("image", "odometry"):
        found = [(arrival.wall_ns - stamp_of(message)) / 1e9 for arrival, message in heard.messages(role)]
        if not found:
            continue
        lags[role] = lag = float(np.median(found))
        fine = -0.01 <= lag <= CLOCK_S
        hint = "" if fine else "; does the robot's clock agree with this machine's?"
        yield Finding(f"clock of {role}", "ok" if fine else "warning", f"stamps are {lag:.3f} s old on arrival{hint}")
    if len(lags) == 2 and abs(lags["image"] - lags["odometry"]) > CLOCK_S:
        apart = lags["image"] - lags["odometry"]
        yield Finding("clocks", "warning", f"images are stamped {apart:.3f} s before wheels; they must share a clock")


def camera_of(heard: Heard, given: Camera | None) -> tuple[Camera | None, str]:
    """Return the camera that a file or the robot tells, or why it is not known."""
    finder = CameraFinder(given, heard.topics["image"])
    take: dict[str, Callable[[Any], None]] = {
        "transforms": finder.take_transforms,
        "moving_transforms": finder.take_moving,
        "odometry": finder.take_odometry,
        "image": finder.take_image,
        "camera_info": finder.take_info,
    }
    try:
        for role, take_message in take.items():
            for _, message in heard.messages(role):
                take_message(message)
    except ValueError as error:
        return None, str(error)
    return finder.camera, finder.problem


def mount_check(heard: Heard, camera: Camera, config: Config) -> Iterator[Finding]:
    """Yield what the edges say of tilt and roll against what is stated, and of the clocks."""
    wheels = {stamp_of(message): floor_pose(message) for _, message in heard.messages("odometry")}
    if len(wheels) < 2:
        return
    track = Trajectory(np.array(sorted(wheels)), np.array([wheels[t_ns] for t_ns in sorted(wheels)]))
    fits = (camera.height, camera.width)
    images = [(t_ns, image) for t_ns, image in _images(heard, camera) if image.shape == fits]
    frames = [find_edges(image, camera, config.edges, twist=camera.twist_at(track, t_ns)) for t_ns, image in images]
    if not any(len(edges) for edges in frames):
        yield Finding("edges", "warning", "no vertical edge in any image")
        return
    yield Finding("edges", "ok", f"{np.median([len(edges) for edges in frames]):.0f} in an image")
    poses = track.sampled([t_ns for t_ns, _ in images]).poses
    check = check_mount(frames, poses, camera, config.edges.mount_sigma_rad)
    stated, found, sigma = (np.rad2deg(values) for values in (check.stated, check.found, check.sigma))
    for name, k in (("tilt", 0), ("roll", 1)):
        text = f"{found[k]:.2f}° ± {sigma[k]:.2f}° by the edges, {stated[k]:.2f}° stated"
        yield Finding(name, "warning" if check.disagrees else "ok", text)
    yield offset_finding([t_ns for t_ns, _ in images], frames, track, camera)


def offset_finding(times: Sequence[int], frames: Sequence[Edges], track: Trajectory, camera: Camera) -> Finding:
    """Return by how much images are stamped later than wheels, by the turns that both of them show."""
    found = clock_offset(times, frames.__getitem__, track, camera)
    text = f"images are stamped {found.text} than wheels, by {np.rad2deg(found.turned_rad):.0f}° of turning"
    if found.problem:
        text = "the turns do not tell the offset of images against wheels: turn the robot, with --seconds 15"
    return Finding("offset of clocks", "warning" if found.disagrees() else "ok", text)


def newest_image(heard: Heard, camera: Camera) -> Image | None:
    """Return the last image (H, W) that could be read."""
    images = _images(heard, camera)
    return images[-1][1] if images else None


def _images(heard: Heard, camera: Camera) -> list[tuple[int, Image]]:
    """Return stamp and pixels (H, W) of the images that can be read."""
    size, found = (camera.width, camera.height), []
    for _, message in heard.messages("image"):
        with suppress(ValueError, InputError):
            image = grey_image(message)
            if image is None:
                file = image_file(message)
                check_whole(file, size, path=_SOURCE)
                image = decoded(file, size, path=_SOURCE)
            found.append((stamp_of(message), image))
    return found


def map_check(landmark_map: LandmarkMap, camera: Camera, place: tuple[float, float]) -> Finding:
    """Return how many landmarks are in view from a place (x, z), over all headings."""
    count = mapping.in_view(landmark_map, camera, np.array([place]))[0]
    few = float((count < mapping.ENOUGH).mean())
    text = f"{np.median(count):.0f} landmarks in view at ({place[0]:.1f}, {place[1]:.1f}); fewer than {mapping.ENOUGH} "
    return Finding("map", "ok" if few < 0.25 else "warning", f"{text}from {few:.0%} of all headings")
