"""The live loop, fed by hand: time is what the messages say, so that nothing depends on how fast the machine is."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from live_feed import BEGIN_NS, LOG, MAKE, Feed, arrival, camera, drive, image, odometry, stated
from short_log import Localiser

from localiser.config import read_config
from localiser.filter import mcl
from localiser.geometry import between, compose
from localiser.live.inbox import Arrival
from localiser.live.timeline import Timeline
from localiser.live.tracker import Checkpoints, Resumed
from localiser.localiser import Localiser as RobotLocaliser
from localiser.storage import open_log, read_track

N = 6


@pytest.fixture(scope="module")
def undisturbed() -> Feed:
    return Feed()([*camera(), *drive(N)])


def test_every_image_is_located_once_the_wheels_have_passed_it(undisturbed: Feed) -> None:
    assert undisturbed.times == [frame.t_ns for frame in LOG.frames[:N]]
    assert undisturbed.worst_error_m() < 0.15


def test_the_pose_now_is_the_estimate_moved_on_by_the_wheels(undisturbed: Feed) -> None:
    published = undisturbed.published[-1]
    located = published.located
    since = LOG.odometry.at(published.now_ns - BEGIN_NS)
    from_map = compose(located.estimate.pose, between(located.odometry, since))
    np.testing.assert_allclose(published.now, from_map, atol=1e-8)
    assert published.now_ns >= located.t_ns


def test_duplicates_and_reordered_messages_change_nothing(undisturbed: Feed) -> None:
    messages = [*camera(), *drive(N)]
    twice = [message for message in messages for _ in range(2)]
    np.testing.assert_array_equal(Feed()(twice).poses, undisturbed.poses)
    swapped = messages[:]
    wheels = [k for k, message in enumerate(swapped) if message.role == "odometry"]
    for k in wheels[1:-1:3]:  # a pose that comes after the next one, where no image was weighed in between
        if swapped[k + 1].role == "odometry" and swapped[k - 1].role == "odometry":
            swapped[k], swapped[k + 1] = swapped[k + 1], swapped[k]
    assert [message.at_ns for message in swapped] != [message.at_ns for message in messages]
    assert Feed()(swapped).times == undisturbed.times


def test_an_image_that_comes_late_is_left_out(undisturbed: Feed) -> None:
    messages = [*camera(), *drive(N)]
    late = messages.pop(next(k for k, message in enumerate(messages) if message.role == "image" and k > 10))
    feed = Feed()([*messages, late])
    assert len(feed.times) == N - 1
    assert feed.tracker.timeline.skipped == {"late": 1}


@pytest.mark.parametrize("jump_s", [-3600, 7200])
def test_a_jump_of_the_clock_is_survived(undisturbed: Feed, jump_s: int) -> None:
    """The messages that tell of the jump are lost, then all goes on; stamps go out by the robot's clock."""
    feed = Feed()([*camera(), *drive(N), *stamped(drive(14, first=N), jump_s)])
    assert any("clock has jumped" in text for text in feed.said)
    assert len(feed.times) >= N + 12
    assert np.diff([published.stamp_ns for published in feed.published]).tolist().count(jump_s) == 0
    assert feed.published[-1].stamp_ns == BEGIN_NS + LOG.frames[N + 13].t_ns + jump_s * 10**9
    assert feed.published[-1].located.t_ns == pytest.approx(BEGIN_NS + LOG.frames[N + 13].t_ns, abs=3e8)


def stamped(messages: list[Arrival], jump_s: int) -> list[Arrival]:
    """Return messages that come when they did, with stamps that are off by a jump of the robot's clock."""
    number = {frame.t_ns: k for k, frame in enumerate(LOG.frames)}
    moved = []
    for one in messages:
        t_ns, stamp_ns = one.at_ns, BEGIN_NS + one.at_ns + jump_s * 10**9
        if one.role == "image":
            message = MAKE.compressed(stamp_ns, LOG.frames[number[t_ns]].encoded())
        else:
            message = MAKE.odometry(stamp_ns, "odom", LOG.odometry.at(t_ns))
        moved.append(replace(one, content=MAKE.encode(message)))
    return moved


def test_a_damaged_image_costs_no_more_than_itself(undisturbed: Feed) -> None:
    messages = [*camera(), *drive(N)]
    place = [k for k, message in enumerate(messages) if message.role == "image"][3]
    data = LOG.frames[3].encoded()
    messages[place] = image(messages[place].at_ns, 3, data[: len(data) // 2])
    feed = Feed()(messages)
    assert len(feed.times) == N - 1
    assert feed.tracker.timeline.skipped == {"damaged": 1}
    np.testing.assert_array_equal(feed.poses[:3], undisturbed.poses[:3])


def test_when_the_wheels_are_silent_edges_tell_the_way() -> None:
    """Every image is located, and the robot is not lost."""
    frames = 16
    messages = [*camera(), *drive(frames)]
    gap = range(LOG.frames[4].t_ns, LOG.frames[12].t_ns)
    feed = Feed()([message for message in messages if message.role != "odometry" or message.at_ns not in gap])
    assert len(feed.times) >= frames - 3
    assert feed.worst_error_m() < 0.3


def anew(messages: list[Arrival], origin: list[float], after_ns: int = 0) -> list[Arrival]:
    """Return messages of which those of the wheels have another origin after a time."""
    return [
        odometry(m.at_ns, compose(np.array(origin), LOG.odometry.at(m.at_ns)))
        if m.role == "odometry" and m.at_ns > after_ns
        else m
        for m in messages
    ]


@pytest.mark.parametrize("after_ns", [0, pytest.param(60_000_000, marks=pytest.mark.slow)])
def test_odometry_that_begins_anew_does_not_move_the_robot(localiser: Localiser, tmp_path: Path, after_ns: int) -> None:
    """Whether an image is taken between the last pose of old and the first of new, or not."""
    feed = Feed(record=tmp_path / "drive.db3")
    feed([*camera(), *anew(drive(12), [40.0, 3.0, 2.0], LOG.frames[4].t_ns + after_ns)])
    assert len(feed.times) == 12 and feed.worst_error_m() < 0.3
    feed.assert_replays(localiser)


def test_images_wait_for_the_first_word_of_the_wheels() -> None:
    """Before that nobody knows where the odometry's frame is."""
    feed = Feed()([*camera(), odometry(0)])
    messages = drive(N)
    silent = Feed()([*camera(), *[message for message in messages if message.role == "image"]])
    assert not silent.published
    assert feed(messages).published


def test_newest_image_wins_when_there_is_no_time() -> None:
    feed = Feed()(camera())
    messages = drive(N)
    feed.now_ns = messages[-1].at_ns
    feed.run.turn(messages)  # all at once
    feed.run.turn([])
    assert feed.times == [LOG.frames[N - 1].t_ns]
    assert feed.tracker.timeline.skipped == {"newer image": N - 1}


def test_images_wait_for_the_camera() -> None:
    feed = Feed()(drive(3))
    assert not feed.published and any("camera" in text for text in feed.said)
    feed([*camera(), *drive(2, first=3)])
    assert feed.times == [frame.t_ns for frame in LOG.frames[3:5]]


def test_a_pose_that_is_stated_while_driving_holds_from_then_on() -> None:
    wrong = mcl.Start(0, LOG.start.mean + np.array([3.0, 0.0, 0.5]), LOG.start.cov)
    feed = Feed(start=wrong)([*camera(), *drive(4)])
    pose = LOG.groundtruth.at(LOG.frames[4].t_ns)
    feed([stated(LOG.frames[4].t_ns - 1, pose)] * 3)
    assert sum(text.startswith("started") for text in feed.said) == 2, "the same message counts once"
    feed.published.clear()
    feed(drive(4, first=5))
    assert feed.times == [frame.t_ns for frame in LOG.frames[5:9]]
    assert feed.worst_error_m() < 0.3


def test_a_pose_that_is_stated_again_later_counts_again() -> None:
    """As `ros2 topic pub --once` sends it: without a time, the same bytes."""
    pose = LOG.groundtruth.at(LOG.frames[2].t_ns)
    feed = Feed()([*camera(), *drive(3)])
    seconds = range(0, 4_000_000_000, 1_000_000_000)
    feed([stated(feed.now_ns + after_ns, pose, 0) for after_ns in seconds])
    assert sum(text.startswith("started") for text in feed.said) == 2, "sent every second, it is stated once"
    feed.tracker.look_everywhere()
    feed([stated(feed.now_ns + 2_000_000_000, pose, 0)])
    assert sum(text.startswith("started") for text in feed.said) == 3


@pytest.mark.parametrize(
    ("frame", "map_frame", "taken"),
    [("map", "map", True), ("/map", "map", True), ("world", "world", True), ("odom", "map", False), ("", "map", True)],
)
def test_a_pose_in_another_frame_than_the_maps_is_left_out(frame: str, map_frame: str, taken: bool) -> None:
    feed = Feed()
    feed.run.map_frame = map_frame
    feed([*camera(), *drive(2)])
    feed([stated(feed.now_ns, LOG.groundtruth.at(feed.now_ns), frame=frame)])
    assert sum(text.startswith("started") for text in feed.said) == 1 + taken
    assert any("in the frame map, found one in odom" in text for text in feed.said) != taken
    assert any("names no frame" in text for text in feed.said) == (frame == "")


@pytest.mark.parametrize(
    ("x", "sigma", "told"),
    [(1e300, 1.0, "expected a position within"), (1e9, 1.0, "start within"), (0.0, 1e150, "most")],
)
def test_a_start_beyond_any_building_is_refused(x: float, sigma: float, told: str) -> None:
    feed = Feed()([*camera(), *drive(2)])
    far = MAKE.pose_in_map(BEGIN_NS, np.array([x, 0.0, 0.0]), np.diag([sigma**2, sigma**2, 0.01]))
    feed([arrival("initialpose", feed.now_ns, MAKE.encode(far))])
    assert any(told in text for text in feed.said), feed.said
    assert sum(text.startswith("started") for text in feed.said) == 1


def test_a_robot_without_a_start_is_looked_for(localiser: Localiser, tmp_path: Path) -> None:
    feed = Feed(start=None, record=tmp_path / "drive.db3")([*camera(), *drive(5, first=100)])
    feed([stated(feed.now_ns, LOG.groundtruth.at(feed.now_ns)), *drive(3, first=106)])
    feed.assert_replays(localiser)


def test_a_recording_replays_to_the_same_poses(localiser: Localiser, tmp_path: Path) -> None:
    """Also with silent wheels, a jump of the clock, damaged and repeated messages, and a start in between."""
    feed = Feed(record=tmp_path / "drive.db3")
    messages = drive(20)
    gap = range(LOG.frames[8].t_ns, LOG.frames[12].t_ns)
    messages = [message for message in messages if message.role != "odometry" or message.at_ns not in gap]
    last = LOG.frames[15].t_ns
    pose = stated(messages[-30].at_ns, LOG.groundtruth.at(last), BEGIN_NS + last)
    messages.insert(messages.index(messages[-30]), pose)
    messages[20:20] = [image(messages[20].at_ns, 3, b"no image"), messages[10], messages[19]]
    feed([*camera(), *messages])
    assert sum(text.startswith("started") for text in feed.said) == 2
    feed.assert_replays(localiser)


def test_a_recording_of_a_jump_of_the_clock_replays_to_the_same_poses(localiser: Localiser, tmp_path: Path) -> None:
    feed = Feed(record=tmp_path / "drive.db3")
    feed([*camera(), *drive(N), *stamped(drive(10, first=N), -50)])
    feed.assert_replays(localiser)
    assert len(feed.times) > N


def test_a_recording_keeps_what_the_run_was_set_to(tmp_path: Path) -> None:
    feed = Feed(record=tmp_path / "drive.db3")([*camera(), *drive(2)])
    feed.close()
    log = open_log(tmp_path / "drive.db3")
    assert log.settings["mcl.particles"] == 300 and read_config(None, (), log.settings) == feed.config
    assert log.start is not None and log.start.t_ns == BEGIN_NS + LOG.frames[0].t_ns


@pytest.mark.parametrize("asked", ["a pose", "everywhere"])
def test_what_is_said_before_the_camera_is_known_comes_before_a_saved_state(tmp_path: Path, asked: str) -> None:
    first = Feed()([*camera(), *drive(N)])
    Checkpoints(tmp_path / "state", first.said.append).close(first.tracker.localiser, 0)
    again = Feed(start=None, resumed=Resumed(tmp_path / "state"))
    if asked == "a pose":
        again([stated(0, np.array([1.0, 2.0, 0.0]))])
    else:
        again.tracker.look_everywhere()
    again([*camera(), *drive(2, first=N)])
    told = "started at x = 1.00 m, z = 2.00 m" if asked == "a pose" else "looked for on the whole map"
    assert any(told in text for text in again.said) and not any("resumed" in text for text in again.said)


@pytest.mark.parametrize("origin", [None, [50.0, 0.0, 1.0]], ids=["wheels go on", "wheels begin anew"])
def test_a_run_that_is_resumed_knows_where_it_is_and_its_recording_replays(localiser, tmp_path, origin):
    """Without a start, after half a second without anything. Wheels that begin anew do not move the robot.

    The replay begins with the very particles; with other settings from about there.
    """
    first = Feed()([*camera(), *drive(N)])
    Checkpoints(tmp_path / "state", first.said.append).close(first.tracker.localiser, 0)
    again = Feed(start=None, resumed=Resumed(tmp_path / "state"), record=tmp_path / "drive.db3")
    rest = [message for message in drive(N + 6) if message.at_ns > LOG.frames[N - 1].t_ns + 60_000_000]
    again([*camera(), *(anew(rest, origin) if origin else rest)])
    told = [any(word in text for text in again.said) for word in ("anew", "in between")]
    assert told == [origin is not None, origin is None]
    assert again.worst_error_m() < 0.3
    again.assert_replays(localiser)
    assert len(again.times) == 6
    other = localiser.replay(tmp_path / "drive.db3", tmp_path / "other", "--set", "mcl.particles=400", few=False)
    np.testing.assert_allclose(read_track(other / "trajectory.csv").poses, again.poses, rtol=0, atol=0.2)


def test_lines_of_json(undisturbed: Feed) -> None:
    line = json.loads(undisturbed.published[-1].line())
    assert line["t_ns"] == undisturbed.published[-1].located.t_ns
    assert [line["x"], line["z"], line["heading"]] == undisturbed.poses[-1].tolist()


def test_a_run_that_still_looks_for_its_place_is_saved_and_resumed(tmp_path: Path) -> None:
    """On a mirrored map no place is tracked: there are candidates only."""
    mirrored = replace(LOG.landmark_map, points=LOG.landmark_map.points * [-1.0, 1.0])
    settings = read_config(None, ["search.particles_most=2000", "search.fresh=300"])
    first, again = (RobotLocaliser(mirrored, LOG.camera, settings) for _ in range(2))
    frames = LOG.frames[:3]
    first.odometry(frames[0].t_ns - 1, np.zeros(3))
    first.odometry(frames[2].t_ns, np.zeros(3))
    first.image(frames[0].t_ns, frames[0].encoded())
    assert first.state.particles is None and first.state.is_begun
    Checkpoints(tmp_path / "state", pytest.fail).close(first, 0)
    start = Resumed(tmp_path / "state").begin(again, Timeline(lambda _: None), frames[1].t_ns - 1)
    assert np.isfinite(start.mean).all() and not again.state.scene.images, "wheels that begin anew begin a new scene"
    again.odometry(frames[2].t_ns, np.zeros(3))
    assert len(again.image(frames[1].t_ns, frames[1].encoded())) == 1


def test_two_publishers_on_one_topic_are_told() -> None:
    """The robot's images, and those of another camera in turn."""
    messages = drive(N)
    images = [message for message in messages if message.role == "image"]
    turns = [replace(message, source=bytes([k % 2 + 1]) * 16) for k, message in enumerate(images)]
    others = [message for message in messages if message.role != "image"]
    feed = Feed()([*camera(), *sorted([*others, *turns], key=lambda message: message.at_ns)])
    assert feed.run.outputs.monitor.wrong == {"two publishers of image": N - 2}
    assert sum("expected one publisher" in text for text in feed.said) == 1
    assert len(feed.times) == N


def test_a_robot_that_was_started_again_is_not_told() -> None:
    half = LOG.frames[N // 2].t_ns
    messages = [replace(message, source=bytes([1 + (message.at_ns > half)]) * 16) for message in drive(N)]
    feed = Feed()([*camera(), *messages])
    assert not feed.run.outputs.monitor.wrong and len(feed.times) == N
