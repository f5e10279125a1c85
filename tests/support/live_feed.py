"""A robot's messages for a live run in this process: time is what the messages say, nothing waits."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from live_transport import KeepingTransport
from short_log import CORRIDOR

from localiser.camera import Camera
from localiser.config import Config, read_config
from localiser.filter import mcl
from localiser.landmarks import LandmarkMap
from localiser.live import TOPICS, LiveOptions
from localiser.live.clock import Clocks
from localiser.live.inbox import Arrival, Inbox
from localiser.live.loop import LiveRun
from localiser.live.monitor import Monitor
from localiser.live.outputs import Outputs, Published, Publisher
from localiser.live.prepare import start_recording
from localiser.live.tracker import Resumed, Tracker
from localiser.localiser import Localiser
from localiser.ros import outputs_named
from localiser.storage import open_log, read_maps, read_track
from localiser.storage.bags import ODOM, CameraFinder, Messages

MAKE = Messages()
LOG = open_log(CORRIDOR)
BEGIN_NS = 1_700_000_000_000_000_000  # when the robot's calendar says that the log begins
CONFIG = read_config(
    None, ["mcl.particles=300", "mcl.start_particles=300", "search.particles_most=2000", "search.fresh=300"]
)


def image(t_ns: int, index: int, data: bytes | None = None) -> Arrival:
    frame = LOG.frames[index]
    return arrival("image", t_ns, MAKE.encode(MAKE.compressed(BEGIN_NS + t_ns, data or frame.encoded())))


def odometry(t_ns: int, pose: np.ndarray | None = None) -> Arrival:
    pose = LOG.odometry.at(t_ns) if pose is None else pose
    return arrival("odometry", t_ns, MAKE.encode(MAKE.odometry(BEGIN_NS + t_ns, ODOM, pose)))


def stated(t_ns: int, pose: np.ndarray, stamp_ns: int = BEGIN_NS, frame: str = "map") -> Arrival:
    """Return the pose of the robot as somebody states it, to 10 cm and 3°."""
    message = MAKE.pose_in_map(stamp_ns, pose, np.diag([0.01, 0.01, 0.003]), frame)
    return arrival("initialpose", t_ns, MAKE.encode(message))


def arrival(role: str, t_ns: int, content: bytes) -> Arrival:
    return Arrival(role, TOPICS[role], content, at_ns=t_ns, wall_ns=BEGIN_NS + t_ns)


def camera(t_ns: int = 0, of: Camera = LOG.camera) -> list[Arrival]:
    info = MAKE.encode(MAKE.camera_info(BEGIN_NS + t_ns, of))
    mount = MAKE.encode(MAKE.mount(BEGIN_NS + t_ns, of))
    return [arrival("camera_info", t_ns, info), arrival("transforms", t_ns, mount)]


def drive(images: int, first: int = 0, late_ns: int = 0) -> list[Arrival]:
    """Return what a robot sends during some images of the log, in the order of time, each `late_ns` after its stamp."""
    end_ns = LOG.frames[first + images - 1].t_ns + 60_000_000
    begin_ns = LOG.frames[first].t_ns - 60_000_000
    wheels = [odometry(int(t_ns)) for t_ns in LOG.odometry.t_ns if max(begin_ns, 0) <= t_ns <= end_ns]
    pictures = [image(LOG.frames[k].t_ns, k) for k in range(first, first + images)]
    return sorted([*wheels, *pictures], key=lambda message: message.at_ns)


@dataclass
class Feed:
    """A live run that is fed by hand."""

    config: Config = CONFIG
    record: Path | None = None
    start: mcl.Start | None = LOG.start
    resumed: Resumed | None = None
    published: list[Published] = field(default_factory=list)
    said: list[str] = field(default_factory=list)
    now_ns: int = 0
    map_files: Sequence[Path] = (CORRIDOR / "map.yaml",)

    def __post_init__(self) -> None:
        def localiser_of(camera: Camera, landmark_map: LandmarkMap) -> Localiser:
            return Localiser(landmark_map, camera, self.config)

        options = LiveOptions(self.map_files, self.config, record=self.record)
        landmark_map = read_maps(self.map_files)
        self.recording = start_recording(options, landmark_map, TOPICS, outputs_named(), self.said.append)
        clocks = Clocks(machine_ns=lambda: self.now_ns)
        monitor = Monitor(lambda text, level: self.said.append(text))
        outputs = Outputs(
            monitor, Publisher(KeepingTransport(), {}), recording=self.recording, publish=[self.published.append]
        )
        finder = CameraFinder(None, TOPICS["image"], moving_kept=2000)
        self.tracker = Tracker(finder, localiser_of, landmark_map, clocks, outputs, self.start, self.resumed)
        self.run = LiveRun(Inbox(), self.tracker, clocks, outputs, CORRIDOR)

    def __call__(self, arrivals: Iterable[Arrival], each: Callable[[], None] = lambda: None) -> "Feed":
        """Feed messages one after another, as a robot would that is never too fast."""
        for message in arrivals:
            self.now_ns = max(self.now_ns, message.at_ns)
            self.run.turn([message])
            self.run.turn([])
            each()
        return self

    def close(self) -> None:
        if self.recording is not None:
            self.recording.close()

    def assert_replays(self, localiser: Any) -> None:
        """Close the recording, and assert that its replay gives the same poses. localiser: the fixture."""
        self.close()
        run = localiser.replay(self.record, self.record.parent / "results", few=False)
        track = read_track(run / "trajectory.csv")
        assert (track.t_ns - BEGIN_NS).tolist() == self.times
        np.testing.assert_allclose(track.poses, self.poses, rtol=0, atol=1e-9)

    @property
    def poses(self) -> np.ndarray:
        return np.array([published.located.estimate.pose for published in self.published])

    @property
    def times(self) -> list[int]:
        return [published.located.t_ns - BEGIN_NS for published in self.published]

    def worst_error_m(self) -> float:
        truth = LOG.groundtruth.sampled(self.times).poses
        return float(np.hypot(*(self.poses - truth)[:, :2].T).max())
