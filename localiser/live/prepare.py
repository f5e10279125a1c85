"""Prepare a live run: read files, join the network, open outputs."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, closing, contextmanager
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from localiser import view
from localiser.camera import Camera, Mount
from localiser.config import Config
from localiser.documents import nearest, read_text
from localiser.errors import InputError
from localiser.filter import Start
from localiser.landmarks import LandmarkMap
from localiser.live.clock import Clocks, SimulatedTime
from localiser.live.inbox import JPEG_QUALITY, Arrival, CameraSource, Inbox, check_outputs, input_topics, topic_for
from localiser.live.loop import LiveRun
from localiser.live.monitor import Monitor
from localiser.live.outputs import JsonLines, Outputs, Published, Publisher, Recording
from localiser.live.tracker import Checkpoints, Resumed, Tracker
from localiser.live.transport import Reply, Transport, network_of, open_transport, prefix_of
from localiser.localiser import Localiser, check_settings
from localiser.replay import close_all
from localiser.ros import SERVICES, Frames, Topic, outputs_named, topic_in
from localiser.storage import encode_image, map_text, read_camera, read_maps
from localiser.storage.bags import CAMERA_TOPIC, LOG_TOPIC, MAP_TOPIC, CameraFinder, Messages, live_label_text

_CAMERA = Camera(320, 240, 280.0, 280.0, 159.5, 119.5, Mount(tilt_rad=0.35, height_m=1.0), "plumb_bob", (-0.1,) * 5)
_MOVING_KEPT = 2000  # times of each transform that changes: longer than images wait


@dataclass(frozen=True, slots=True)
class LiveOptions:
    """What a live run is asked to do.

    map_files: of one map or list of maps, or of several. config: its section `live` says how to take part in the
    robot's network, and under which names. image: a camera or stream that OpenCV reads, in place of a topic. start:
    where the robot is at the first image, None where that is not known. json: a file descriptor for lines of JSON.
    view: where it is shown. checkpoint: where the state is saved, and gone on from where it is there and no start is
    given. stand_in: whether this program itself sends what is heard.
    """

    map_files: Sequence[Path]
    config: Config
    camera: Path | None = None
    image: str | None = None
    start: Start | None = None
    record: Path | None = None
    json: int | None = None
    view: str = "none"
    checkpoint: Path | None = None
    stand_in: bool = False


@contextmanager
def open_run(options: LiveOptions, say: Callable[[str, str], None]) -> Iterator[LiveRun]:
    """Yield a live run with everything open; closes it all. say: takes messages for the user. Raises InputError."""
    view.check_kind(options.view)
    landmark_map = read_maps(options.map_files)
    resumed = state_to_resume(options, landmark_map, say)
    given = read_camera(options.camera) if options.camera else None
    check_settings(options.config, given, images=True)
    live, prefix = options.config.live, prefix_of(options.config.live)
    topics, outputs = input_topics(live.topics, prefix), outputs_named(live.publish, prefix)
    check_outputs(topics, outputs)
    viewers: list[view.LiveView] = []

    def tell(text: str, level: str) -> None:
        say(text, level)
        for viewer in viewers:
            viewer.message(time.time_ns(), text, level)

    def localiser_of(camera: Camera, landmark_map: LandmarkMap) -> Localiser:
        localiser = Localiser(landmark_map, camera, options.config)
        localiser.measure(np.zeros((camera.height, camera.width), dtype=np.uint8))  # makes the tables of its lens
        if options.view != "none":
            viewers.append(view.LiveView(options.view, view.Context("live", camera, landmark_map)))
            if address := viewers[-1].address:
                say(f"Watch at {address}" if options.view == "web" else f"Watch with `rerun {address}`", "INFO")
        return localiser

    with ExitStack() as unbegun, ExitStack() as stack:
        inbox, clocks = Inbox(), Clocks(simulated=SimulatedTime() if live.use_sim_time else None)
        monitor = Monitor(tell, lambda roles: advice(options, topics, roles, joined=transport.is_joined()))
        recording = start_recording(options, landmark_map, topics, outputs, lambda why: tell(why, "WARNING"))
        if recording is not None and options.record is not None:
            unbegun.callback(options.record.unlink, missing_ok=True)
            stack.callback(recording.close)
        transport = stack.enter_context(closing(open_transport(live)))
        transport.report_to(lambda text: monitor.warn("network", text))
        publish: list[Callable[[Published], None]] = []
        if options.json is not None:
            lines = JsonLines(options.json)
            stack.callback(lines.close)
            publish.append(lambda published: lines.put(published.line()))
        stack.callback(lambda: close_all(viewers, complete=True))
        warm_up(landmark_map, options.config, say)
        finder = CameraFinder(given, topics["image"], topics["camera_info"], moving_kept=_MOVING_KEPT)
        frames, tolerance_ns = Frames(live.map_frame, live.odom_frame), round(live.transform_tolerance_s * 1e9)
        publisher = Publisher(transport, outputs, frames, tolerance_ns, recording.send if recording else None)
        targets = Outputs(monitor, publisher, recording, publish, viewers)
        failed = partial(monitor.warn, "no checkpoint")
        checkpoints = Checkpoints(options.checkpoint, failed) if options.checkpoint else None
        tracker = Tracker(finder, localiser_of, landmark_map, clocks, targets, options.start, resumed, checkpoints)
        serve(transport, inbox, prefix, live.services)
        unheard = {"image": options.image is not None, "clock": not live.use_sim_time}
        for role, topic in ((role, topic) for role, topic in topics.items() if not unheard.get(role)):
            transport.subscribe(topic_for(role, topic), partial(take_in, inbox, role, topic))
        if options.image is not None:
            stack.callback(open_camera(options.image, topics["image"], inbox).close)
        unbegun.pop_all()  # what was recorded stays
        yield LiveRun(inbox, tracker, clocks, targets, options.map_files[0].parent, live.map_frame)


def advice(options: LiveOptions, topics: Mapping[str, str], roles: list[str], *, joined: bool) -> str:
    """Return what to start or to set where nothing is heard of some roles. joined: whether the network is there."""
    if options.stand_in:
        return "the robot's stand-in is still getting ready"
    live = options.config.live
    sources = {**topics, "image": options.image or topics["image"]}
    awaited = " and ".join(f"{role} ({sources[role]})" for role in roles)
    text = f"nothing heard yet of {awaited}, at {network_of(live)}; "
    if not joined:
        return (
            f"{text}no zenoh router answers there: start one (`ros2 run rmw_zenoh_cpp rmw_zenohd`, or without a robot "
            "`localiser simulate LOG --serve`), or say where it is: --connect tcp/HOST:7447; over DDS: --dds DOMAIN"
        )
    beyond = "" if live.dds < 0 or live.interface != "lo" else "; beyond this machine: --set live.interface=eth0"
    return (
        f"{text}is the robot on, and in the same domain? Other names: --set live.topics.{roles[0]}=NAME{beyond}. "
        "`localiser doctor` with the same settings lists what is sent there"
    )


def serve(transport: Transport, inbox: Inbox, namespace: str, names: Mapping[str, str | None]) -> None:
    """Let the requests of all services come into the inbox. names: in place of those in SERVICES, None for none.

    namespace: of all names but those that are given with a leading slash. Raises InputError for an unknown kind.
    """
    for kind in names:
        if kind not in SERVICES:
            raise InputError(f"unknown kind of service; {nearest(kind, list(SERVICES))}", field="live.services")
    for kind, service in SERVICES.items():
        if name := topic_in(namespace, names.get(kind, service.name.removeprefix("/"))):

            def take(content: bytes, reply: Reply, kind: str = kind, name: str = name) -> None:
                inbox.put(Arrival(kind, name, content, reply=reply))

            transport.serve(replace(service, name=name), take)


def state_to_resume(options: LiveOptions, landmark_map: LandmarkMap, say: Callable[[str, str], None]) -> Resumed | None:
    """Return the state to go on from, None without one of this map. Raises InputError where it is damaged."""
    if options.checkpoint is None or options.start is not None or not options.checkpoint.exists():
        return None
    resumed = Resumed(options.checkpoint)
    if resumed.is_on(landmark_map):
        return resumed
    files = ", ".join(map(str, options.map_files))
    say(f"{options.checkpoint}: not resumed: the state belongs to another map than {files}", "WARNING")
    return None


def take_in(inbox: Inbox, role: str, topic: str, content: bytes, source: bytes) -> None:
    """Put a message on a topic into the inbox."""
    inbox.put(Arrival(role, topic, content, source=source))


def start_recording(
    options: LiveOptions,
    landmark_map: LandmarkMap,
    topics: Mapping[str, str],
    outputs: Mapping[str, Topic],
    failed: Callable[[str], None],
) -> Recording | None:
    """Return the recording that was asked for, with what a replay needs: settings, map, camera file.

    topics, outputs: what comes in, by role, and what goes out, by kind. failed: is called with the reason why it ended.
    """
    if options.record is None:
        return None
    latched = {output.name for output in outputs.values() if output.latched}
    recording = Recording(options.record, failed, latched | {topics["transforms"], LOG_TOPIC, MAP_TOPIC, CAMERA_TOPIC})
    texts = {
        LOG_TOPIC: live_label_text(options.record.stem, _changed_settings(options.config), topics),
        # Several maps are written out: they need not all be in one file.
        MAP_TOPIC: map_text(landmark_map) if len(landmark_map.maps) > 1 else read_text(options.map_files[0]),
    }
    if options.camera is not None:
        texts[CAMERA_TOPIC] = read_text(options.camera)
    for topic, text in texts.items():
        recording.tell(topic, text)
    return recording


def _changed_settings(config: Config) -> dict[str, Any]:
    """Return every setting that is not the default, by its name with dots."""
    found: dict[str, Any] = {}
    for name, value in config.model_dump(exclude_defaults=True, exclude={"versions", "live"}).items():
        section = isinstance(value, dict)
        found |= {f"{name}.{key}": part for key, part in value.items()} if section else {name: value}
    return found


def open_camera(address: str, topic: str, inbox: Inbox) -> CameraSource:
    """Return the camera whose frames come into the inbox as compressed images, as a robot would send them."""
    make = Messages()

    def take(t_ns: int, file: bytes) -> None:
        inbox.put(Arrival("image", topic, make.encode(make.compressed(t_ns, file))))

    return CameraSource(address, take)


def warm_up(landmark_map: LandmarkMap, config: Config, say: Callable[[str, str], None]) -> None:
    """Take a localiser of its own through images of stripes: libraries are loaded, loops compiled, before any waits."""
    say("getting ready; the first run compiles its loops, which takes up to a minute", "INFO")
    stripes = np.where(np.arange(_CAMERA.width) // 40 % 2, 200, 50).astype(np.uint8)
    file = encode_image(np.tile(stripes, (_CAMERA.height, 1)), ".jpg", JPEG_QUALITY)
    localiser = Localiser(landmark_map, _CAMERA, config)
    localiser.warm_up()
    localiser.start([*landmark_map.maps[0].points.mean(axis=0), 0.0], np.eye(3))
    for number, t_ns in enumerate((1, 100_000_000, 200_000_000)):
        localiser.odometry(t_ns, [0.0, -0.1 * number, 0.0])
        localiser.image(t_ns, file, by_wheels=number < 2)
    say("ready; waiting for the robot", "INFO")
