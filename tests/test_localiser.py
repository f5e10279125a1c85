"""The one object: it locates what a replay does, goes on from a saved state, and refuses what cannot work."""

import math
import os
import subprocess
import sys
from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path
from textwrap import dedent
from typing import Any

import numpy as np
import pytest
from folders import ROOT
from live_feed import CONFIG, LOG, Feed, camera, drive
from short_log import CORRIDOR, FRAMES, cut_log
from short_log import Localiser as CommandLine
from small_log import write_edge_log

from localiser.camera import Camera, Mount
from localiser.config import Config, read_config
from localiser.edges import Edges, find_edges
from localiser.errors import InputError
from localiser.filter import LocatedFrame, Odometry, Sighting, Start
from localiser.geometry import Increment, Trajectory
from localiser.landmarks import LandmarkMap
from localiser.live import LiveOptions, open_run
from localiser.localiser import Localiser
from localiser.motion import MotionModel, covariance_of
from localiser.observation import EarlierFrame, EdgeObservation, Observation, PlaceLandmarks, persistent_clutter
from localiser.particles import Particles
from localiser.replay import replay_log
from localiser.storage import Event, ImageEvent, Log, open_log, read_track, write_camera

SECOND = 1_000_000_000
KNOWN = "observation.association=known"
SLOPE = "observation.kind=slope"


def feed(localiser: Localiser, events: Iterable[Event]) -> list[LocatedFrame]:
    """Give a localiser what a log holds."""
    found = []
    for event in events:
        match event:
            case Start():
                found += localiser.start(event.mean, event.cov, event.t_ns)
            case Odometry():
                found += localiser.odometry(event.t_ns, event.pose)
            case Sighting():
                found += localiser.edges(event.t_ns, event.edges)
            case ImageEvent():
                found += localiser.image(event.t_ns, event.encoded())
    return found


def first_events(images: int) -> list[Event]:
    end_ns = LOG.frames[images].t_ns
    return [event for event in LOG.events() if event.t_ns < end_ns]


def of_corridor(config: Config = CONFIG, seed: int | None = None) -> Localiser:
    assert LOG.landmark_map is not None
    return Localiser(LOG.landmark_map, LOG.camera, config, seed)


def poses(frames: list[LocatedFrame]) -> np.ndarray:
    return np.array([frame.located.estimate.pose for frame in frames])


# -- what is located --------------------------------------------------------------------------------------------------


def test_it_locates_what_a_replay_does(localiser: CommandLine, tmp_path: Path) -> None:
    """Also the last images, which no odometry has reached, and as the function of the library does."""
    log = cut_log(CORRIDOR, tmp_path / "log", FRAMES)
    rows = (log / "odometry.csv").read_text().splitlines()
    last_ns = LOG.frames[FRAMES - 3].t_ns
    kept = [row for row in rows[1:] if int(row.split(",")[0]) <= last_ns]
    (log / "odometry.csv").write_text("\n".join([rows[0], *kept]) + "\n")
    few = ["mcl.particles=200", "mcl.start_particles=300"]
    settings = ("--seed", 4, "--set", few[0], "--set", few[1])
    track = read_track(localiser.replay(log, tmp_path / "out", *settings) / "trajectory.csv")

    recorded = open_log(log)
    config = read_config(None, few, recorded.settings)
    one = of_corridor(config, seed=4)
    found = feed(one, recorded.events())
    assert 0 < len(found) < FRAMES
    found += one.finish()
    assert [frame.located.t_ns for frame in found] == track.t_ns.tolist()
    np.testing.assert_allclose(poses(found), track.poses, atol=1e-9)
    assert set(found[0].stage_ms) == {"load", "edges", "filter"} and min(found[0].stage_ms.values()) > 0

    by_library = replay_log(log, read_config(None, ["seed=4", *few], recorded.settings))
    np.testing.assert_array_equal(by_library.track.poses, poses(found))
    assert by_library.metrics["frames"] == FRAMES and by_library.metrics["seed"] == 4


def test_pixels_and_files_and_edges_are_the_same_image() -> None:
    results = []
    for kind in ("file", "pixels", "edges"):
        one = of_corridor()
        feed(one, [event for event in first_events(1) if not isinstance(event, ImageEvent)])
        image = LOG.frames[0]
        if kind == "edges":
            one.edges(image.t_ns, one.measure(image.load()).edges)
        else:
            one.image(image.t_ns, image.encoded() if kind == "file" else image.load())
        results.append(poses(one.finish()))
    np.testing.assert_array_equal(results[0], results[1])
    np.testing.assert_array_equal(results[0], results[2])


def test_bearings_of_ones_own_are_enough() -> None:
    """Eight landmarks, their bearings to half a degree from ten places, and a start to half a metre."""
    points = [[-1.0, -3.0], [0.8, -2.5], [0.2, -4.0], [1.5, -5.0], [-2.0, -6.0], [-0.6, -5.0], [0.7, -7.0], [2.2, -6.5]]
    landmark_map = LandmarkMap.from_points(np.array(points))
    one = Localiser(landmark_map, LOG.camera, seed=3)
    one.start([0.0, 0.0, 0.0], np.diag([0.5, 0.5, 0.2]) ** 2)
    for k in range(10):
        true = np.array([0.1, -0.3 - 0.1 * k, 0.05])
        one.odometry(k * SECOND, [0.0, -0.1 * k, 0.0])
        bearing = bearings_from(one, true, landmark_map)
        (found,) = one.edges(k * SECOND, Edges.from_bearings(bearing, math.radians(0.5)))
    assert np.hypot(*(found.located.estimate.pose - true)[:2]) < 0.1
    matched = np.flatnonzero(found.matches.landmark >= 0)
    assert len(matched) and (found.matches.landmark[matched] == matched).all()


def bearings_from(localiser: Localiser, pose: np.ndarray, landmark_map: LandmarkMap) -> np.ndarray:
    x, z, heading = localiser.camera.pose_in_map(pose)
    right = np.array([math.cos(heading), -math.sin(heading)])
    back = np.array([math.sin(heading), math.cos(heading)])
    relative = landmark_map.points - [x, z]
    return np.arctan2(relative @ right, -(relative @ back))


def test_a_start_without_a_time_holds_from_the_next_measurement() -> None:
    measured = [event for event in first_events(3) if not isinstance(event, Start)]
    timed, untimed = of_corridor(), of_corridor()
    timed.start(LOG.start.mean, LOG.start.cov, measured[0].t_ns)
    untimed.start(LOG.start.mean, LOG.start.cov)
    np.testing.assert_array_equal(poses(feed(untimed, measured)), poses(feed(timed, measured)))


def test_matches_are_those_of_the_edges_that_were_weighed() -> None:
    """With a tilt that is stated wrongly the edges are corrected before they are weighed, and so are the matches."""
    assert LOG.landmark_map is not None
    tilted = LOG.camera.with_mount(tilt_rad=LOG.camera.mount.tilt_rad + math.radians(1.0))
    config = read_config(None, ["edges.tilt_sigma_deg=2", "mcl.particles=500"])
    one = Localiser(LOG.landmark_map, tilted, config)
    found = [(frame, seen) for event in first_events(8) for seen in [one.state.seen] for frame in feed(one, [event])]
    (before, _), (last, seen) = found[-2:]
    as_weighed, as_measured = last.located.sighting.edges, last.located.edges
    assert np.abs(as_weighed.bearing - as_measured.bearing).max() > 1e-4
    assert isinstance(one.observation, EdgeObservation)
    pose = last.located.estimate.as_seen.pose
    expected = one.observation.associate(pose, last.located.sighting, LOG.landmark_map).matches()
    np.testing.assert_array_equal(last.matches.landmark, expected.landmark)
    np.testing.assert_array_equal(last.matches.residual, expected.residual)
    # They are compared with those of the image before, which were corrected, too.
    now, then = (one.observation.frame(frame.located.sighting.edges) for frame in (last, before))
    since = last.located.increment
    earlier = EarlierFrame.of(then, now, since, float(covariance_of(config.motion, since)[2, 2]))
    persistent = persistent_clutter(now, earlier, seen.clutter)
    np.testing.assert_array_equal(last.located.sighting.persistent, persistent)
    assert persistent.max() > 2.0


def test_an_image_after_silent_wheels_is_located_at_once() -> None:
    one = of_corridor()
    events = first_events(6)
    last = max(k for k, event in enumerate(events) if isinstance(event, ImageEvent))
    heard_until_ns = LOG.frames[4].t_ns + SECOND // 20
    feed(one, [event for event in events[:last] if not isinstance(event, Odometry) or event.t_ns <= heard_until_ns])
    image = events[last]
    assert one.config.increments.source != "vision"
    (found,) = one.image(image.t_ns, image.encoded(), by_wheels=False)
    assert np.trace(found.located.increment.cov) > 0, "edges tell the way with a covariance, wheels exactly"
    assert np.hypot(*(found.located.estimate.pose - LOG.groundtruth.at(image.t_ns))[:2]) < 0.3


# -- the state --------------------------------------------------------------------------------------------------------


def test_a_saved_state_goes_on_to_the_last_bit() -> None:
    """Also with an image that waits for the wheels, and after a warm-up, which changes nothing."""
    events = first_events(8)
    whole = of_corridor()
    expected = feed(whole, events)
    place = [k for k, event in enumerate(events) if isinstance(event, ImageEvent)][4] + 1
    first = of_corridor()
    begun = feed(first, events[:place])
    assert first.state.waiting
    again = of_corridor(seed=CONFIG.seed)
    again.warm_up()
    again.restore(first.save())
    assert again.save() == first.save()
    rest = feed(again, events[place:])
    np.testing.assert_array_equal(poses([*begun, *rest]), poses(expected))
    assert again.save() == whole.save()


def test_a_state_of_another_map_camera_or_setting_is_refused() -> None:
    content = of_corridor().save()
    others = {
        "seed: expected 0": of_corridor(seed=1),
        "search.fresh: expected 300": of_corridor(
            CONFIG.model_copy(update={"search": replace(CONFIG.search, fresh=301)})
        ),
        "map: expected": Localiser(LOG.landmark_map.take(np.arange(5)), LOG.camera, CONFIG),
        "camera: expected": Localiser(LOG.landmark_map, LOG.camera.with_mount(height_m=1.5), CONFIG),
    }
    for told, other in others.items():
        with pytest.raises(InputError, match=told):
            other.restore(content)
    with pytest.raises(InputError, match=r"here: expected a whole checkpoint"):
        of_corridor().restore(content[:-1], "here")
    made, scenes = of_corridor(), np.ones((1, 2))
    beyond = PlaceLandmarks(np.array([len(LOG.landmark_map)]), scenes, scenes)
    made.state.belief = replace(made.state.belief, landmarks=beyond)
    with pytest.raises(InputError, match=rf"here: expected {len(LOG.landmark_map)} landmarks"):
        of_corridor().restore(made.save(), "here")


def test_a_state_can_be_moved_to_another_clock() -> None:
    one = of_corridor()
    feed(one, first_events(2))
    moved = of_corridor()
    moved.restore(one.save(shift_ns=7 * SECOND))
    assert moved.state.at_ns - one.state.at_ns == 7 * SECOND
    assert [pose.t_ns for pose in moved.state.odometry] == [pose.t_ns + 7 * SECOND for pose in one.state.odometry]


WARMED_UP = """
    from numba.core import event
    from localiser import Localiser, open_log, read_config

    compiled = []

    class Listener(event.Listener):
        def on_start(self, one):
            compiled.append(one.data["dispatcher"].py_func.__name__)

        def on_end(self, one):
            pass

    event.register("numba:compile", Listener())
    log = open_log("logs/corridor")
    for kind in ("line", "slope"):
        robot = Localiser(log.landmark_map, log.camera, read_config(None, [f"observation.kind={kind}"], log.settings))
        robot.warm_up()
        before = len(compiled)
        robot.start(log.start.mean, log.start.cov)
        located = []
        for one in log.events():
            if hasattr(one, "pose"):
                located += robot.odometry(one.t_ns, one.pose)
            elif hasattr(one, "encoded"):
                located += robot.image(one.t_ns, one.encoded())
        print(kind, before > 0, len(located) + len(robot.finish()) == len(log.frames), compiled[before:])
"""


@pytest.mark.slow  # quick: that it changes nothing, above
def test_a_warm_up_compiles_all_that_a_run_uses(tmp_path: Path) -> None:
    """Nothing is kept from earlier runs. In the corridor the wheels come under suspicion, and edges are followed."""
    environment = os.environ | {"LOCALISER_CACHE": str(tmp_path), "PYTHONPATH": str(ROOT)}
    command = [sys.executable, "-c", dedent(WARMED_UP)]
    ran = subprocess.run(command, cwd=ROOT, env=environment, check=False, capture_output=True, text=True)
    assert ran.stdout.splitlines() == ["line True True []", "slope True True []"], ran.stderr


# -- one's own observation, motion model and detector -----------------------------------------------------------------


class Beacon:
    """An observation of how far the robot is from the origin of the map: a measurement (1,) in metres."""

    def log_likelihood(self, particles: Particles, sighting: Sighting, landmark_map: LandmarkMap) -> np.ndarray:
        return -0.5 * ((np.hypot(*particles.columns[:2]) - sighting.measurement[0]) / 0.05) ** 2


class Other(Beacon):
    """Another observation."""


class Shifted:
    """A motion model without noise that moves every particle 1 m to the right."""

    def predict(self, particles: Particles, increment: Increment, rng: np.random.Generator) -> Particles:
        return replace(particles, columns=particles.columns + np.array([[1.0], [0.0], [0.0]]))


def by_beacon(observation: Observation | None = None, motion: MotionModel | None = None) -> Localiser:
    return Localiser(LandmarkMap.from_points(np.zeros((1, 2))), observation=observation or Beacon(), motion=motion)


def started(one: Localiser, sigma: float = 0.5) -> Localiser:
    one.start([3.0, 0.0, 0.0], np.diag([sigma, 1e-3, 1e-3]) ** 2)
    one.odometry(0, [0.0, 0.0, 0.0])
    return one


def test_ones_own_observation_is_weighed_without_a_camera() -> None:
    one = started(by_beacon())
    one.warm_up()
    (found,) = one.measurement(0, [3.5])
    assert abs(found.located.estimate.pose[0] - 3.5) < 0.05
    assert found.matches.landmark.size == 0 and found.image is None


def test_ones_own_motion_model_moves_the_particles() -> None:
    one = started(by_beacon(motion=Shifted()), sigma=1e-3)
    one.odometry(SECOND, [0.0, -0.1, 0.0])
    (found,) = one.measurement(SECOND, [4.0])
    assert abs(found.located.estimate.pose[0] - 4.0) < 0.05


def test_ones_own_detector_is_asked_for_lines() -> None:
    asked = []

    def nothing(image: np.ndarray, camera: Camera) -> np.ndarray:
        asked.append(image.shape)
        return np.zeros((0, 4))

    assert LOG.landmark_map is not None
    one = Localiser(LOG.landmark_map, LOG.camera, detector=nothing)
    image = LOG.frames[0]
    assert len(one.measure(image.load()).edges) == 0 and asked == [image.load().shape]


def test_a_state_with_ones_own_observation_goes_on_to_the_last_bit() -> None:
    """Also with a measurement that waits for the wheels. A state belongs to the class of the observation."""
    first, again = started(by_beacon()), by_beacon()
    first.measurement(0, [3.5])
    first.measurement(SECOND, [3.4])
    again.restore(first.save())
    expected = first.odometry(SECOND, [0.0, 0.0, 0.0])
    np.testing.assert_array_equal(poses(again.odometry(SECOND, [0.0, 0.0, 0.0])), poses(expected))
    assert len(expected) == 1
    with pytest.raises(InputError, match=r"own observation: expected .*Beacon, .* found .*Other"):
        by_beacon(Other()).restore(first.save())


def test_a_log_of_measurements_is_replayed() -> None:
    frames = [Sighting(t_ns, measurement=np.array([3.5])) for t_ns in (0, SECOND)]
    standing = Trajectory(np.array([0, SECOND]), np.zeros((2, 3)))
    start = Start(0, np.array([3.0, 0.0, 0.0]), np.diag([0.5, 1e-3, 1e-3]) ** 2)
    landmark_map = LandmarkMap.from_points(np.zeros((1, 2)))
    log = Log("beacon", Path("beacon"), LOG.camera, standing, frames, landmark_map, start)
    run = replay_log(log, observation=Beacon())
    np.testing.assert_allclose(run.track.poses[:, 0], 3.5, atol=0.05)
    same = replay_log(replace(log, camera=UNTILTED), read_config(None, [SLOPE]), observation=Beacon())
    np.testing.assert_array_equal(same.track.poses, run.track.poses)


# -- what is refused --------------------------------------------------------------------------------------------------


def test_measurements_that_cannot_be_are_refused() -> None:
    one = of_corridor()
    one.start([0, 0, 0], np.eye(3), SECOND)
    one.odometry(SECOND, [0, 0, 0])
    nothing = Edges.none()
    with pytest.raises(InputError, match="odometry: expected a time after"):
        one.odometry(SECOND, [0, 0, 0])
    with pytest.raises(InputError, match="image: expected a time after the start"):
        one.edges(SECOND - 1, nothing)
    assert len(one.edges(SECOND, nothing)) == 1
    with pytest.raises(InputError, match="image: expected a later time"):
        one.edges(SECOND, nothing)
    one.edges(SECOND + 1, nothing)
    with pytest.raises(InputError, match="image: expected a later time"):
        one.edges(SECOND + 1, nothing)
    with pytest.raises(InputError, match=r"pose: expected \(3,\) finite numbers"):
        one.start([0, 0, math.nan], np.eye(3))
    with pytest.raises(InputError, match=r"cov: expected \(3, 3\) finite numbers"):
        one.start([0, 0, 0], np.eye(2))
    with pytest.raises(InputError, match="image: expected a JPEG or PNG image"):
        one.image(2 * SECOND, b"no image")
    with pytest.raises(InputError, match="expected 640×480 as the camera says, found 320×240"):
        one.image(2 * SECOND, np.zeros((240, 320), dtype=np.uint8))


def test_an_image_may_have_the_cameras_mount_or_one_of_its_own() -> None:
    one = of_corridor()
    one.start([0, 0, 0], np.eye(3))
    one.edges(1, Edges.none(), LOG.camera.mount)
    one.edges(2, Edges.none(), Mount(0.1, 1.0))
    assert [sighting.edges.mount for sighting in one.state.waiting] == [LOG.camera.mount, Mount(0.1, 1.0)]


NOT_KNOWN = "observation.association: `known` believes edges that say which landmark they belong to, found images"
LEVEL = "mount.tilt_deg: the observation `slope` needs a tilted camera, found a tilt of 0°"
UNTILTED = LOG.camera.with_mount(tilt_rad=0.0)


def refused_by_replay(command: CommandLine, log: Path, out: Path, *settings: str) -> str:
    """Return the words with which a replay refuses settings, before it makes a folder."""
    result = command("replay", log, "--out", out, *(part for setting in settings for part in ("--set", setting)))
    assert result.exit_code == 2 and not out.exists()
    return result.err.strip()


@pytest.mark.parametrize(("settings", "told"), [([KNOWN], NOT_KNOWN), ([SLOPE], LEVEL), ([KNOWN, SLOPE], NOT_KNOWN)])
def test_replay_and_live_refuse_the_same_settings_with_the_same_words(localiser, tmp_path, settings, told):
    """All that a live run may refuse; a replay also says which file of the log does not fit."""
    log = cut_log(CORRIDOR, tmp_path / "log", 2)
    write_camera(UNTILTED, log / "camera.yaml")
    options = LiveOptions([log / "map.yaml"], read_config(None, settings), camera=log / "camera.yaml")
    with pytest.raises(InputError) as by_live, open_run(options, lambda text, level: None):
        pass
    assert str(by_live.value).startswith(told)
    assert refused_by_replay(localiser, log, tmp_path / "out", *settings).endswith(str(by_live.value))


def test_a_camera_that_live_learns_of_later_is_refused_with_the_same_words() -> None:
    with pytest.raises(InputError, match=LEVEL):
        Feed(config=read_config(None, [SLOPE]))([*camera(of=UNTILTED), *drive(1)])
    with pytest.raises(InputError, match=LEVEL):
        Localiser(LandmarkMap.from_points(np.zeros((1, 2))), UNTILTED, read_config(None, [SLOPE]))


@pytest.mark.parametrize(
    ("setting", "told"),
    [
        ("increments.source=vision", "increments.source: `vision` follows edges from image to image"),
        (KNOWN, "observation.association: `known` cannot look for a robot on the whole map"),
    ],
)
def test_settings_that_only_edges_measured_elsewhere_do_not_fit(localiser, tmp_path, setting, told):
    """A live run has images; users of the library may have bearings alone."""
    log = write_edge_log(tmp_path / "log")
    one = Localiser(open_log(log).landmark_map, LOG.camera, read_config(None, [setting]))
    with pytest.raises(InputError) as by_library:
        one.edges(1, Edges.from_columns(*np.zeros((4, 1))))
    assert str(by_library.value).startswith(told)
    assert refused_by_replay(localiser, log, tmp_path / "out", setting).endswith(str(by_library.value))


def test_an_edge_of_a_landmark_that_the_map_does_not_have_is_refused() -> None:
    landmarks = LandmarkMap.from_points(np.array([[0.0, -2.0], [1.0, -2.0]]))
    one = Localiser(landmarks, LOG.camera, read_config(None, [KNOWN]))
    one.start([0, 0, 0], np.eye(3))
    edges = Edges.from_columns(*np.full((4, 1), 0.1), landmark_id=np.array([2]))
    with pytest.raises(InputError, match="landmark_id: expected at most 1, the map's last landmark, found 2"):
        one.edges(1, edges)


# -- what is given wrongly --------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("start_ns", "located_ns"), [(None, []), (30, []), (20, [20]), (15, [20])])
def test_a_start_drops_the_images_that_wait_and_were_taken_before_it(start_ns, located_ns):
    one = of_corridor()
    one.start([0, 0, 0], np.eye(3))
    one.odometry(10, [0, 0, 0])
    assert one.edges(20, Edges.none()) == []
    found = one.start([1, 0, 0], 1e-6 * np.eye(3), start_ns)
    found += one.odometry(40, [0, 0, 0])
    assert [frame.located.t_ns for frame in found] == located_ns
    (last,) = one.edges(40, Edges.none())
    np.testing.assert_allclose(last.located.estimate.pose, [1, 0, 0], atol=0.01)


@pytest.mark.parametrize("t_ns", [1.5, "a", math.nan, None, 2**63])
def test_a_time_that_is_no_integer_is_refused(t_ns: object) -> None:
    one, by_own = started(of_corridor()), started(by_beacon())
    calls = [
        lambda: one.odometry(t_ns, [0, 0, 0]),
        lambda: one.edges(t_ns, Edges.none()),
        lambda: one.image(t_ns, LOG.frames[0].load()),
        lambda: by_own.measurement(t_ns, [3.5]),
    ]
    if t_ns is not None:
        calls += [lambda: one.start([0, 0, 0], np.eye(3), t_ns), lambda: one.look_everywhere(t_ns)]
    one.edges(10, Edges.none())
    for call in calls:
        with pytest.raises(InputError, match=r"^t_ns: expected an integer of nanoseconds, found"):
            call()
    assert [image.t_ns for image in one.state.waiting] == [10], "nothing is lost"


def test_edges_without_wheels_need_a_camera() -> None:
    one = by_beacon()
    one.start([0.0, 0.0, 0.0], np.eye(3), 0)
    with pytest.raises(InputError, match="camera: expected a camera"):
        one.edges(0, Edges.from_bearings([0.1], 0.01), by_wheels=False)


@pytest.mark.parametrize("cov", [-np.eye(3), np.diag([1.0, 1.0, -1e-6]), np.eye(3) + np.eye(3, k=1)])
def test_a_start_with_a_matrix_that_is_no_covariance_is_refused(cov: np.ndarray) -> None:
    one = of_corridor()
    with pytest.raises(InputError, match=r"^cov: expected a symmetric matrix without negative eigenvalues"):
        one.start([0, 0, 0], cov)
    one.start([0, 0, 0], np.zeros((3, 3)))
    one.start([0, 0, 0], np.ones((3, 3)))


class Returns:
    """An observation that returns what it is told to, of N particles."""

    def __init__(self, make: Callable[[int], object]) -> None:
        self.make = make

    def log_likelihood(self, particles: Particles, sighting: Sighting, landmark_map: LandmarkMap) -> Any:
        return self.make(len(particles))


@pytest.mark.parametrize(
    ("make", "told"),
    [
        (lambda n: np.full(n, np.nan), "found nan or inf"),
        (lambda n: np.r_[np.inf, np.zeros(n - 1)], "found nan or inf"),
        (lambda n: np.full(n, -np.inf), "found -inf for all particles"),
        (lambda n: np.zeros((n, 1)), r"numbers, found float64 \(\d+, 1\)"),
        (lambda n: 0.0, r"found float64 \(\)"),
        (lambda n: None, r"found object \(\)"),
    ],
)
def test_an_observation_that_returns_no_log_likelihoods_is_refused(make: Callable[[int], object], told: str) -> None:
    with pytest.raises(InputError, match=f"^Returns.log_likelihood: expected .*{told}"):
        started(by_beacon(Returns(make))).measurement(0, [3.5])


def test_an_observation_may_exclude_some_particles() -> None:
    one = started(by_beacon(Returns(lambda n: np.where(np.arange(n) % 2, 0.0, -np.inf))))
    (found,) = one.measurement(0, [3.5])
    possible = found.located.particles.weight[1::2]
    np.testing.assert_allclose(possible, 1 / len(possible))
    assert np.isfinite(one.state.inliers.mean)


def test_settings_of_the_observation_do_not_concern_ones_own() -> None:
    config = read_config(None, [SLOPE, KNOWN])
    one = Localiser(LandmarkMap.from_points(np.zeros((1, 2))), UNTILTED, config, observation=Returns(np.zeros))
    assert len(started(one).image(0, np.zeros((480, 640), dtype=np.uint8))) == 1


def test_a_start_without_a_time_holds_from_the_next_measurement_on_another_clock_too() -> None:
    one, moved = of_corridor(), of_corridor()
    one.start([0, 0, 0], np.eye(3))
    moved.restore(one.save(shift_ns=7 * SECOND))
    moved.odometry(9 * SECOND, [0, 0, 0])
    assert moved.state.at_ns == 9 * SECOND


def by_corridor_known() -> Localiser:
    return of_corridor(read_config(None, [KNOWN]))


@pytest.mark.parametrize(
    ("call", "told"),
    [
        (lambda: started(by_beacon()).edges(0, [0.1]), "^edges: expected Edges, found list"),
        (lambda: started(by_beacon()).odometry(0, "abc"), r"^odometry: expected \(3,\) finite numbers, found 'abc'"),
        (lambda: started(by_beacon()).odometry(0, [[0], [0, 0]]), r"^odometry: expected \(3,\) finite numbers"),
        (lambda: started(by_beacon()).measurement(0, [[1], [1, 2]]), "^measurement: expected an array of numbers"),
        (lambda: started(by_beacon()).measurement(0, "abc"), "^measurement: expected an array of numbers, found 'abc'"),
        (lambda: by_beacon().restore(None), "^state: expected the bytes of a saved state, found NoneType"),
        (lambda: by_beacon().restore("str"), "^state: expected the bytes of a saved state, found str"),
        (lambda: by_beacon(object()), "^observation: expected a method `log_likelihood`, found object without one"),
        (lambda: of_corridor().image(0, None), "^image: expected an array of 8-bit grey or BGR, found NoneType"),
        (lambda: of_corridor().image(0, [[0, 1]]), "^image: expected an array of 8-bit grey or BGR, found list"),
        (lambda: of_corridor().image(0, "a.png"), "^image: expected an array of 8-bit grey or BGR, found str"),
        *((lambda seed=seed: of_corridor(seed=seed), "^seed: expected .*, found") for seed in (-1, 1.5, 2**32, "a")),
        (
            lambda: Localiser(LOG.landmark_map.take(np.arange(0)), LOG.camera),
            "^landmark_map: expected at least one landmark, found",
        ),
        (lambda: of_corridor().start([2e8, 0.0, 0.0], np.eye(3)), "start: expected a start within 1e.08 m"),
        (lambda: of_corridor().start([0.0] * 3, 1e7 * np.eye(3)), "start: expected sigmas of at most 1000 m"),
        (lambda: of_corridor().odometry(1, [0.0, -1e300, 0.0]), "odometry: expected a pose within ±1e.09 m"),
        (lambda: by_corridor_known().image(1, LOG.frames[0].encoded()), NOT_KNOWN),
        (lambda: Localiser(LandmarkMap.from_points(np.zeros((1, 2)))), "camera: expected a camera"),
        (lambda: by_beacon().image(0, np.zeros((480, 640), dtype=np.uint8)), "camera: expected a camera"),
        (lambda: by_beacon().measurement(0, [3.5]), "expected a start before the first measurement"),
        (lambda: of_corridor().measurement(0, [3.5]), r"measurement: expected Localiser\(…, observation=…\)"),
    ],
)
def test_what_cannot_be_is_refused(call: Callable[[], object], told: str) -> None:
    with pytest.raises(InputError, match=told):
        call()


def test_edges_of_an_image_are_refused_where_landmarks_have_to_be_known() -> None:
    one = by_corridor_known()
    one.start([0, 0, 0], np.eye(3))
    with pytest.raises(InputError, match=NOT_KNOWN):
        one.edges(0, find_edges(LOG.frames[0].load(), LOG.camera))
    one.edges(0, Edges.none())
    one.edges(1, Edges.from_bearings([0.1], 0.01))  # of clutter, which no landmark belongs to


def test_a_measurement_that_comes_too_early_is_not_called_an_image() -> None:
    one = started(by_beacon())
    one.odometry(SECOND, [0, 0, 0])
    with pytest.raises(InputError, match=r"^measurement: expected a time after the start"):
        one.measurement(-1, [3.5])
    one.measurement(SECOND, [3.5])
    with pytest.raises(InputError, match=r"^measurement: expected a later time than that of the last measurement"):
        one.measurement(SECOND, [3.5])
