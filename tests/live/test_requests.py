"""Services of a live run, answered in its loop: look everywhere, load another map; and runs on several maps."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from live_feed import LOG, MAKE, Feed, arrival, camera, drive, image
from live_transport import KeepingTransport
from short_log import CORRIDOR

from localiser.config import LiveParameters, read_config
from localiser.errors import InputError
from localiser.live.inbox import Arrival
from localiser.live.outputs import Publisher
from localiser.live.prepare import LiveOptions, open_run, state_to_resume
from localiser.live.timeline import Timeline
from localiser.live.tracker import Checkpoints
from localiser.localiser import Localiser as RobotLocaliser
from localiser.ros import (
    MAP_INVALID,
    MAP_LOADED,
    MAP_NOT_THERE,
    SERVICES,
    outputs_named,
    service_bytes,
    service_message,
)
from localiser.storage import read_maps, write_map

N = 8


def asked(feed: Feed, kind: str, **fields: Any) -> Any:
    """Ask a service in the middle of a run; return its answer."""
    replies: list[bytes] = []
    arrival = Arrival(
        kind, SERVICES[kind].name, service_bytes(kind, "Request", **fields), feed.now_ns, reply=replies.append
    )
    feed([arrival])
    return service_message(kind, "Response", replies[0]) if replies else None


def fed(folder: Path, **settings: Any) -> tuple[Feed, KeepingTransport]:
    transport = KeepingTransport(heard={"/tf"})
    feed = Feed(**settings)
    feed.run.outputs.publisher = Publisher(transport, outputs_named())
    feed.run.maps = folder
    return feed, transport


def test_a_robot_that_is_looked_for_again_is_found_and_the_recording_replays(localiser, tmp_path):
    feed, transport = fed(tmp_path, record=tmp_path / "drive.db3")
    feed([*camera(), *drive(N)])
    before = len(transport.sent["/tf"])
    assert asked(feed, "look_everywhere") is not None
    assert feed.tracker.localiser is not None and not feed.tracker.localiser.state.is_begun
    rest = [message for message in drive(N + 6) if message.at_ns > LOG.frames[N - 1].t_ns + 60_000_000]
    feed(rest).close()
    assert len(feed.times) == N + 6 and feed.published[-1].located.p_correct > 0.5
    assert len(transport.sent["/tf"]) > before
    feed.assert_replays(localiser)


def test_another_map_is_loaded_while_running(tmp_path: Path) -> None:
    """Shifted by 100 m: the poses are, the landmarks go out again, the recording ends."""
    shifted = replace(LOG.landmark_map, name="upstairs", points=LOG.landmark_map.points + np.array([100.0, 0.0]))
    write_map(shifted, tmp_path / "upstairs.yaml")
    feed, transport = fed(tmp_path, record=tmp_path / "drive.db3")
    feed([*camera(), *drive(N)])
    assert asked(feed, "load_map", map_url="upstairs.yaml").result == MAP_LOADED
    assert feed.run.outputs.recording is None and len(transport.sent["/localiser/landmarks"]) == 2
    rest = [message for message in drive(N + 6) if message.at_ns > LOG.frames[N - 1].t_ns + 60_000_000]
    feed(rest)
    assert len(feed.times) == N + 6
    truth = LOG.groundtruth.at(feed.times[-1])
    assert np.hypot(*(feed.poses[-1] - truth - [100.0, 0.0, 0.0])[:2]) < 0.5
    assert any("upstairs" in text for text in feed.said)
    feed.close()


def test_an_image_from_before_another_map_was_loaded_is_not_weighed_on_it(tmp_path: Path) -> None:
    write_map(replace(LOG.landmark_map, name="upstairs"), tmp_path / "upstairs.yaml")
    feed, _ = fed(tmp_path)
    feed([*camera(), *drive(3), image(LOG.frames[3].t_ns, 3)])
    assert feed.tracker.timeline.waiting is not None, "for the wheels"
    assert asked(feed, "load_map", map_url="upstairs.yaml").result == MAP_LOADED
    feed([message for message in drive(3, first=3) if message.at_ns > LOG.frames[3].t_ns])
    assert feed.times == [frame.t_ns for frame in (*LOG.frames[:3], *LOG.frames[4:6])]
    assert feed.tracker.timeline.skipped == {"before the start": 1}


@pytest.mark.parametrize("name", ["nothing.yaml", "../other/map.yaml", "/etc/hostname", "", 300 * "a", "itself", "\0"])
def test_a_map_that_is_not_in_the_folder_is_not_loaded(tmp_path: Path, name: str) -> None:
    (tmp_path / "other").mkdir()
    write_map(LOG.landmark_map, tmp_path / "other" / "map.yaml")
    (tmp_path / "maps").mkdir()
    (tmp_path / "maps" / "itself").symlink_to("itself")
    feed, _ = fed(tmp_path / "maps")
    feed([*camera(), *drive(2)])
    kept = feed.tracker.localiser
    assert asked(feed, "load_map", map_url=name).result == MAP_NOT_THERE
    assert feed.tracker.localiser is kept


@pytest.mark.parametrize("text", ["x", "localiser-map/1\nlandmarks: [{id: 1, x: 0, z: 1, identity: 4x4_50:7:left}]"])
def test_a_map_that_is_refused_changes_nothing(tmp_path: Path, text: str) -> None:
    (tmp_path / "map.yaml").write_text(f"format: {text}\n")
    feed, _ = fed(tmp_path, config=read_config(None, ["edges.markers=tag36h11"]))
    feed([*camera(), *drive(2)])
    kept = feed.tracker.localiser
    assert asked(feed, "load_map", map_url="file://map.yaml").result == MAP_INVALID
    assert feed.tracker.localiser is kept and any("the map stays" in text for text in feed.said)
    assert feed.tracker.landmark_map is kept.landmark_map


def test_a_map_that_is_loaded_before_the_camera_is_known_is_the_map(tmp_path: Path) -> None:
    write_map(replace(LOG.landmark_map, name="upstairs"), tmp_path / "map.yaml")
    feed, _ = fed(tmp_path)
    assert asked(feed, "load_map", map_url="map.yaml").result == MAP_LOADED
    feed([*camera(), *drive(2)])
    assert feed.tracker.localiser is not None and feed.tracker.localiser.landmark_map.name == "upstairs"
    assert not any(text.startswith("started") for text in feed.said), "the start was on the map before"


def test_a_state_belongs_to_the_map_that_was_loaded(tmp_path: Path) -> None:
    """On another map, or where a start is stated, it is left out."""
    loaded = tmp_path / "upstairs.yaml"
    shifted = replace(LOG.landmark_map, name="upstairs", points=LOG.landmark_map.points + np.array([100.0, 0.0]))
    write_map(shifted, loaded)
    feed, _ = fed(tmp_path)
    feed.tracker.checkpoints = Checkpoints(tmp_path / "state", pytest.fail)
    feed([*camera(), *drive(3)])
    assert asked(feed, "load_map", map_url="upstairs.yaml").result == MAP_LOADED
    feed(drive(3, first=4))
    feed.tracker.checkpoints.close(feed.tracker.localiser, 0)

    options = LiveOptions([loaded], feed.config, checkpoint=tmp_path / "state")
    said: list[str] = []
    resumed = state_to_resume(options, shifted, lambda text, level: said.append(text))
    on = RobotLocaliser(shifted, LOG.camera, feed.config)
    assert resumed is not None and resumed.begin(on, Timeline(lambda _: None), feed.now_ns).mean[0] > 90
    assert state_to_resume(replace(options, start=LOG.start), shifted, pytest.fail) is None, "the start counts"
    live = LiveParameters(connect=("tcp/127.0.0.1:9",))  # where nobody is
    config = options.config.model_copy(update={"live": live})
    with open_run(replace(options, config=config), lambda text, level: None) as run:
        assert run.tracker.resumed is not None and run.tracker.checkpoints is not None
    assert state_to_resume(options, LOG.landmark_map, lambda text, level: said.append(text)) is None
    assert "the state belongs to another map than" in said[-1]


def test_a_request_that_is_none_is_told() -> None:
    feed, _ = fed(CORRIDOR)
    replies: list[bytes] = []
    feed([Arrival("load_map", "/localiser/load_map", b"\0", 0, reply=replies.append)])
    assert not replies and any("expected a request of nav2_msgs/srv/LoadMap" in text for text in feed.said)


def test_unknown_services_are_refused_and_leave_no_recording(tmp_path: Path) -> None:
    config, record = read_config(None, ["live.services={fly: /fly}"]), tmp_path / "drive.db3"
    with pytest.raises(InputError, match="unknown kind of service"):
        open_run(LiveOptions([CORRIDOR / "map.yaml"], config, record=record), lambda text, level: None).__enter__()
    assert not list(tmp_path.iterdir())


def test_hashes_are_those_of_another_implementation() -> None:
    utils = pytest.importorskip("zenoh_ros2_sdk.utils")
    from localiser.storage.bags import typestore

    grid, _ = typestore(ros1=False).generate_msgdef("nav_msgs/msg/OccupancyGrid", ros_version=2)
    first, *parts = grid.split("=" * 80 + "\n")
    named = {"nav_msgs/msg/OccupancyGrid": first}
    for part in parts:
        head, _, text = part.partition("\n")
        package, name = head.removeprefix("MSG: ").split("/")[:: 1 if head.count("/") == 1 else 2]
        named[f"{package}/msg/{name}"] = text
    for kind, service in SERVICES.items():
        found = utils.compute_service_type_hash(service.srvtype, service.request, service.response, named)
        assert found == service.type_hash, kind


SHIFT = np.array([5.0, 9.0])
IMAGES = 12


@pytest.fixture
def files(tmp_path: Path) -> list[Path]:
    paths = [tmp_path / "cellar.yaml", tmp_path / "up stairs.yaml"]
    write_map(replace(LOG.landmark_map, points=LOG.landmark_map.points[::-1] * [-1.0, 0.8]), paths[0])
    write_map(replace(LOG.landmark_map, points=LOG.landmark_map.points + SHIFT), paths[1])
    return paths


def test_poses_go_out_in_the_frame_of_the_map_that_is_believed(localiser, files, tmp_path):
    transport = KeepingTransport()
    feed = Feed(start=None, map_files=files, record=tmp_path / "drive.db3")
    feed.run.outputs.publisher = Publisher(transport, outputs_named())
    feed([*camera(), *drive(IMAGES)])
    line = json.loads(feed.published[-1].line())
    truth = LOG.groundtruth.at(feed.times[-1])
    assert line["map"] == "up stairs" and line["p_correct"] > 0.9
    assert [line["x"] - SHIFT[0], line["z"] - SHIFT[1]] == pytest.approx(truth[:2], abs=0.05)
    assert line["localized"] and line["localizationScore"] == line["p_correct"] and 0 < line["deviationRange"] < 0.2
    first, last = (json.loads(transport.messages("/localiser/places")[k].data) for k in (0, -1))
    assert first and all(0 <= place["probability"] <= 1 for place in first)
    assert sum(place["probability"] for place in first) <= 1.0
    assert last[0]["map"] == "up stairs" and last[0]["probability"] > 0.9
    assert [last[0]["x"], last[0]["z"]] == pytest.approx([line["x"], line["z"]], abs=0.05)
    pose = transport.messages("/localiser/pose")[-1]
    assert pose.header.frame_id == "map_up_stairs"
    assert pose.pose.pose.position.x == pytest.approx(line["x"])
    assert transport.messages("/tf")[-1].transforms[0].header.frame_id == "map_up_stairs"
    assert transport.messages("/localiser/landmarks")[-1].markers[0].header.frame_id == "map_up_stairs"
    feed.assert_replays(localiser)


def test_a_pose_is_stated_in_the_frame_of_one_of_the_maps(files: list[Path]) -> None:
    """What another program sends of a pose in no map's frame is left out."""
    feed = Feed(start=None, map_files=files)
    stated = LOG.groundtruth.at(LOG.frames[0].t_ns) + np.append(SHIFT, 0.0)

    def pose(frame: str) -> object:
        message = MAKE.encode(MAKE.pose_in_map(0, stated, np.diag([0.01, 0.01, 0.003]), frame))
        return arrival("initialpose", LOG.frames[0].t_ns, message)

    feed([*camera(), pose("map")])
    assert any(
        "expected a pose in the frame map_cellar or map_up_stairs, found one in map" in text for text in feed.said
    )
    feed([pose("map_up_stairs"), *drive(2)])
    assert {published.map_name for published in feed.published} == {"up stairs"}
    assert any(text.startswith(f"started at x = {stated[0]:.2f} m") and "on up stairs" in text for text in feed.said)


def test_a_list_of_maps_is_loaded_while_running(tmp_path: Path, files: list[Path]) -> None:
    write_map(read_maps(files), tmp_path / "site.yaml")
    feed, _ = fed(tmp_path)
    feed([*camera(), *drive(3)])
    assert asked(feed, "load_map", map_url="site.yaml").result == MAP_LOADED
    feed([message for message in drive(3 + IMAGES) if message.at_ns > LOG.frames[2].t_ns + 60_000_000])
    assert feed.published[-1].map_name == "up stairs" and not feed.published[2].map_name
