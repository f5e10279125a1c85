"""What `localiser doctor` looks at: what is installed, a camera, the topics of a robot or a bag, clocks and mount."""

from __future__ import annotations

import platform
import time
from collections import Counter, deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing, suppress
from dataclasses import dataclass, field, replace
from functools import cache
from importlib import metadata
from pathlib import Path
from threading import Lock
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from localiser import __version__
from localiser.calibration import check_mount, clock_offset, spread
from localiser.camera import Camera
from localiser.config import Config, LiveParameters
from localiser.edges import Edges, find_edges
from localiser.errors import InputError
from localiser.geometry import Trajectory
from localiser.live import Arrival, input_topics, message_of, open_transport, prefix_of, topic_for, type_of
from localiser.storage import Image, Log, check_whole, decoded
from localiser.storage.bags import Bag, BagReader, CameraFinder, RosType, floor_pose, grey_image, image_file, stamp_of

State = Literal["ok", "optional", "warning", "missing"]
LIBRARIES = ("numpy", "opencv-python-headless", "numba", "rosbags", "rerun-sdk")
OF_A_ROBOT = {"eclipse-zenoh": "live", "cyclonedds": "dds"}
"""What only a running robot needs, with the extra that installs it."""

MOST_KEPT = 400
MOST_IMAGES, MOST_PAIRS = 60, 30  # of a log, whose edges are found
CLOCK_S = 0.2
GAP_S, GAP_INTERVALS = 1.0, 5.0  # what is longer than both is a gap, in seconds and in usual intervals
_STAMPED = (RosType.IMAGE, RosType.COMPRESSED, RosType.ODOMETRY)  # whose rates, gaps and clocks are shown
_SOURCE = Path("image")


@dataclass(frozen=True, slots=True)
class Check:
    """One thing that was looked at."""

    what: str
    state: State
    text: str


def versions() -> Iterator[Check]:
    """Yield what is installed."""
    yield Check("localiser", "ok", f"{__version__}, Python {platform.python_version()} on {platform.system()}")
    for library in (*LIBRARIES, *OF_A_ROBOT):
        try:
            yield Check(library, "ok", metadata.version(library))
        except metadata.PackageNotFoundError:
            if extra := OF_A_ROBOT.get(library):
                text = f"not installed; for a running robot: pip install '.[{extra}]' in a clone"
                yield Check(library, "optional", text)
            else:
                yield Check(library, "missing", "not installed")


@dataclass(slots=True, eq=False)
class Heard:
    """What was heard on a network, by topic. kept: the newest messages of the topics that the live mode listens to."""

    topics: Mapping[str, str]
    seconds: float
    counts: Counter[str] = field(default_factory=Counter)
    types: dict[str, str] = field(default_factory=dict)
    sizes: Counter[str] = field(default_factory=Counter)
    kept: dict[str, deque[Arrival]] = field(default_factory=dict)

    def messages(self, role: str) -> Iterator[tuple[Arrival, Any]]:
        """Yield the messages of a role that can be read."""
        for arrival in self.kept.get(role, ()):
            with suppress(ValueError):
                yield arrival, message_of(arrival)


def listen_to_robot(live: LiveParameters, seconds: float) -> Heard:
    """Return what was heard on a robot's network in some time, also what is kept for latecomers. Raises InputError."""
    heard, lock = Heard(input_topics(live.topics, prefix_of(live)), seconds), Lock()
    roles = {topic: role for role, topic in heard.topics.items()}

    def take(topic: str, msgtype: str | None, content: bytes) -> None:
        with lock:
            heard.counts[topic] += 1
            heard.sizes[topic] += len(content)
            heard.types |= {topic: msgtype} if msgtype else {}
            if role := roles.get(topic):
                heard.kept.setdefault(role, deque(maxlen=MOST_KEPT)).append(Arrival(role, topic, content))

    fixed = topic_for("transforms", heard.topics["transforms"])  # sent before now, and kept
    with closing(open_transport(live, "localiser_doctor")) as transport:
        transport.listen_to_all(take)
        transport.subscribe(fixed, lambda content, source: take(fixed.name, fixed.msgtype, content))
        time.sleep(seconds)
    return heard


def topic_checks(heard: Heard) -> Iterator[Check]:
    """Yield every topic with its rate, and which are missing."""
    for role, topic in heard.topics.items():
        if topic not in heard.counts and role not in ("moving_transforms", "initialpose", "groundtruth", "clock"):
            state: State = "missing" if role in ("image", "odometry") else "warning"
            yield Check(topic, state, f"nothing heard in {heard.seconds:g} s; {role}: --set live.topics.{role}=NAME")
    roles = {topic: role for role, topic in heard.topics.items()}
    for topic, count in sorted(heard.counts.items()):
        known = roles.get(topic)
        kind = heard.types.get(topic) or (type_of(known, topic) if known else "")
        text = f"{count / heard.seconds:.1f} Hz, {heard.sizes[topic] / count / 1000:.1f} kB {kind}".rstrip()
        text = f"{known}, {text}" if known else text
        readable = known is None or any(True for _ in heard.messages(known))
        yield Check(topic, "ok" if readable else "warning", text if readable else f"{text}; none can be read")


def clock_checks(heard: Heard) -> Iterator[Check]:
    """Yield how far the stamps of images and wheels are behind this machine's calendar when they come."""
    lags = {}
    for role in ("image", "odometry"):
        found = [(arrival.wall_ns - stamp_of(message)) / 1e9 for arrival, message in heard.messages(role)]
        if not found:
            continue
        lags[role] = lag = float(np.median(found))
        fine = -0.01 <= lag <= CLOCK_S
        hint = "" if fine else "; does the robot's clock agree with this machine's?"
        yield Check(f"clock of {role}", "ok" if fine else "warning", f"stamps are {lag:.3f} s old on arrival{hint}")
    if len(lags) == 2 and abs(lags["image"] - lags["odometry"]) > CLOCK_S:
        apart = lags["image"] - lags["odometry"]
        yield Check("clocks", "warning", f"images are stamped {apart:.3f} s before wheels; they must share a clock")


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


def camera_finding(camera: Camera) -> Check:
    """Return what is known of a camera."""
    mount = camera.mount
    tilt, roll = np.rad2deg([mount.tilt_rad, mount.roll_rad]).round(1) + 0.0
    text = f"{camera.width}×{camera.height} pixels, {mount.height_m:.2f} m high, tilt {tilt:.1f}°, roll {roll:.1f}°"
    return Check("camera", "ok", text)


def heard_checks(heard: Heard, camera: Camera, config: Config) -> Iterator[Check]:
    """Yield what the edges say of tilt, roll and clocks of a robot that was heard."""
    wheels = {stamp_of(message): floor_pose(message) for _, message in heard.messages("odometry")}
    if len(wheels) < 2:
        return
    track = Trajectory(np.array(sorted(wheels)), np.array([wheels[t_ns] for t_ns in sorted(wheels)]))
    size, images = (camera.width, camera.height), {}
    for _, message in heard.messages("image"):
        with suppress(ValueError, InputError):
            image = grey_image(message)
            if image is None:
                file = image_file(message)
                check_whole(file, size, path=_SOURCE)
                image = decoded(file, size, path=_SOURCE)
            if image.shape == size[::-1]:
                images[stamp_of(message)] = image
    times = list(images)
    yield from edge_checks(times, lambda k: images[times[k]], track, camera, config)


def edge_checks(
    times: Sequence[int], image_of: Callable[[int], Image], track: Trajectory, camera: Camera, config: Config
) -> Iterator[Check]:
    """Yield what the edges of images say of tilt and roll against what is stated, and of the clocks.

    times: of the images, by the clock of the odometry, `track`. image_of: returns an image (H, W) by its number.
    """

    @cache
    def edges_of(k: int) -> Edges:
        return find_edges(image_of(k), camera, config.edges, twist=camera.twist_at(track, times[k]))

    chosen = spread(len(times), MOST_IMAGES)
    frames = [edges_of(k) for k in chosen]
    if not any(len(edges) for edges in frames):
        yield Check("edges", "warning", "no vertical edge in any image")
        return
    yield Check("edges", "ok", f"{np.median([len(edges) for edges in frames]):.0f} in an image")
    poses = track.sampled([times[k] for k in chosen]).poses
    check = check_mount(frames.__getitem__, poses, camera, config.edges.mount_sigma_rad)
    stated, found, sigma = (np.rad2deg(values).round(2) + 0.0 for values in (check.stated, check.mount, check.sigma))
    for name, k in (("tilt", 0), ("roll", 1)):
        text = f"{found[k]:.2f}° ± {sigma[k]:.2f}° by the edges, {stated[k]:.2f}° stated"
        yield Check(name, "warning" if check.disagrees else "ok", text)
    yield offset_finding(times, edges_of, track, camera)


def offset_finding(times: Sequence[int], edges_of: Callable[[int], Edges], track: Trajectory, camera: Camera) -> Check:
    """Return by how much images are stamped later than wheels, by the turns that both of them show."""
    found = clock_offset(times, edges_of, track, camera, most=MOST_PAIRS)
    text = f"images are stamped {found.text} than wheels, by {np.rad2deg(found.turned_rad):.0f}° of turning"
    if found.problem:
        text = "the turns do not tell the offset of images against wheels: the robot must turn for a while"
    return Check("offset of clocks", "warning" if found.disagrees() else "ok", text)


# -- a log ------------------------------------------------------------------------------------------------------------


def topics_of(path: Path) -> Iterator[Check]:
    """Yield the topics of a bag with their rates, gaps and clocks; nothing for another log. Raises InputError.

    Clocks and gaps are those of the messages that a log is made of.
    """
    if not BagReader().recognises(path):
        return
    with Bag(path) as bag:
        topics = bag.topics
        times: dict[str, list[tuple[int, int]]] = {topic.name: [] for topic in topics}
        try:
            for message in bag.messages([topic for topic in topics if topic.msgtype in _STAMPED]):
                times[message.topic].append((message.stamp_ns, message.t_ns))
        except InputError as error:
            yield Check("bag", "warning", str(error))
    for topic in topics:
        kind = f"{topic.count} × {topic.msgtype}"
        if not times[topic.name]:
            yield Check(topic.name, "ok", kind)
            continue
        stamps, recorded = np.array(times[topic.name], dtype=np.int64).T
        if not stamps.any():
            yield Check(topic.name, "warning", f"{kind}; headers without stamps")
            continue
        finding = times_finding(topic.name, stamps, kind)
        lag_s = float(np.median(recorded - stamps)) / 1e9
        yield replace(finding, text=f"{finding.text}; stamps are {lag_s:.3f} s older than the recording")


def times_finding(what: str, stamps_ns: Sequence[int] | NDArray[np.int64], text: str) -> Check:
    """Return the rate of something, and where it was missing for long or went back in time."""
    times_s = np.asarray(stamps_ns, dtype=np.int64) / 1e9
    if len(times_s) < 2 or times_s.max() == times_s.min():
        return Check(what, "ok", text)
    steps_s = np.diff(times_s)
    usual_s = float(np.median(steps_s))
    text += f", {1 / usual_s:.1f} Hz" if usual_s > 0 else ""
    gaps = np.flatnonzero(steps_s > max(GAP_S, GAP_INTERVALS * usual_s))
    back = int((steps_s <= 0).sum())
    if len(gaps):
        longest = gaps[steps_s[gaps].argmax()]
        since_s = times_s[longest] - times_s[0]
        text += (
            f"; {len(gaps)} gap{'s' * (len(gaps) > 1)}, the longest of {steps_s[longest]:.1f} s after {since_s:.1f} s"
        )
    if back:
        text += f"; {back} stamp{'s' * (back > 1)} not later than the one before"
    return Check(what, "warning" if back or len(gaps) else "ok", text)


def log_checks(log: Log, config: Config) -> Iterator[Check]:
    """Yield what a log that can be read has, whether its camera and clocks fit, and what a replay still needs."""
    kind = "images" if log.has_images else "images, of which the log has the edges"
    times = [frame.t_ns for frame in log.frames]
    yield times_finding("images", times, f"{len(times)} {kind}, {(times[-1] - times[0]) / 1e9:.1f} s")
    if len(log.odometry):
        way_m = float(np.hypot(*np.diff(log.odometry.poses[:, :2], axis=0).T).sum())
        text = f"{len(log.odometry)} poses, {way_m:.1f} m"
        yield times_finding("odometry", log.odometry.t_ns, text)
        outside = sum(not log.odometry.covers(t_ns) for t_ns in times)
        if outside:
            text = f"does not reach {outside} of {len(times)} images, in which the wheels tell no motion"
            yield Check("odometry", "warning", text)
    else:
        yield Check("odometry", "optional", "none: the images alone tell how the robot moved")
    yield camera_finding(log.camera)
    if log.mount_moves:
        yield Check("mount", "ok", "moves on the robot; each image has its own")
    elif log.has_images and len(log.odometry) > 1:
        images = log.images
        yield from edge_checks(times, lambda k: images[k].load(), log.odometry, log.camera, config)
    lacks: tuple[tuple[str, object, State, str], ...] = (
        ("truth", log.groundtruth, "optional", "errors are not known; a topic of a bag or a file of a folder has it"),
        ("start", log.start, "optional", "it is looked for on the whole map; --start x,z,heading_deg states it"),
        ("map", log.landmark_map, "missing", f"`localiser map build {log.path} -o map.yaml` makes one; replay takes it "
         "by --map map.yaml"),
    )  # fmt: skip
    for what, known, state, text in lacks:
        yield Check(what, state, f"none: {text}") if known is None else Check(what, "ok", "known")
