"""A live run on several maps: frames of what is published, a start on one of them, a recording that replays."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from live_feed import LOG, MAKE, Feed, arrival, camera, drive
from live_transport import KeepingTransport
from short_log import Localiser

from localiser.live.inbox import Arrival
from localiser.live.outputs import Publisher
from localiser.ros import MAP_LOADED, SERVICES, outputs_named, service_bytes, service_message
from localiser.storage import read_maps, write_map

SHIFT = np.array([5.0, 9.0])
N = 6


@pytest.fixture
def files(tmp_path: Path) -> list[Path]:
    paths = [tmp_path / "cellar.yaml", tmp_path / "up stairs.yaml"]
    write_map(replace(LOG.landmark_map, points=LOG.landmark_map.points[::-1] * [-1.0, 0.8]), paths[0])
    write_map(replace(LOG.landmark_map, points=LOG.landmark_map.points + SHIFT), paths[1])
    return paths


def test_poses_go_out_in_the_frame_of_the_map_that_is_believed(
    localiser: Localiser, files: list[Path], tmp_path: Path
) -> None:
    transport = KeepingTransport()
    feed = Feed(start=None, map_files=files, record=tmp_path / "drive.db3")
    feed.run.outputs.publisher = Publisher(transport, outputs_named())
    feed([*camera(), *drive(N)])
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
    feed = Feed()
    feed.run.maps = tmp_path
    feed([*camera(), *drive(3)])
    replies: list[bytes] = []
    request = service_bytes("load_map", "Request", map_url="site.yaml")
    feed([Arrival("load_map", SERVICES["load_map"].name, request, feed.now_ns, reply=replies.append)])
    assert service_message("load_map", "Response", replies[0]).result == MAP_LOADED
    feed([message for message in drive(3 + N) if message.at_ns > LOG.frames[2].t_ns + 60_000_000])
    assert feed.published[-1].map_name == "up stairs" and not feed.published[2].map_name
