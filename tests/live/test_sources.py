"""Where live messages come from: names on the network, the inbox, cameras."""

from __future__ import annotations

import json
import time
from pathlib import Path
from threading import Event

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from live_processes import free_endpoint
from short_log import Localiser

from localiser.errors import InputError
from localiser.live.sources import Arrival, CameraSource, Inbox, Network, topic_of
from localiser.live.sources.keys import keys_of

NAMES = st.lists(st.text("abcxyz_0", min_size=1, max_size=6).filter(lambda name: not name.isdigit()), min_size=1)
PATIENCE_S = 30.0


@given(parts=NAMES)
def test_a_key_gives_its_topic_back(parts: list[str]) -> None:
    topic = "/" + "/".join(parts)
    bridge, middleware = keys_of(topic, "sensor_msgs/msg/Image")
    assert topic_of(bridge) == (topic, None)
    assert topic_of(middleware.replace("*", "0")) == (topic, "sensor_msgs/msg/Image")


def test_keys_are_those_of_ros() -> None:
    assert keys_of("/camera/image_raw", "sensor_msgs/msg/Image") == (
        "camera/image_raw",
        "*/camera/image_raw/sensor_msgs::msg::dds_::Image_/*",
    )


@given(roles=st.lists(st.sampled_from(["image", "odometry", "transforms"]), max_size=60))
def test_a_full_inbox_keeps_the_newest_of_each_role_in_order(roles: list[str]) -> None:
    inbox = Inbox(most_images=3, most_others=5)
    arrivals = [Arrival(role, role, b"", at_ns=k, wall_ns=k) for k, role in enumerate(roles)]
    for arrival in arrivals:
        inbox.put(arrival)
    expected = set()
    for role, most in (("image", 3), ("odometry", 5), ("transforms", 5)):
        of_role = [arrival.at_ns for arrival in arrivals if arrival.role == role]
        expected |= set(of_role[-most:])
        assert inbox.dropped[role] == max(len(of_role) - most, 0)
    assert [arrival.at_ns for arrival in inbox.take(0.0)] == sorted(expected)
    assert inbox.take(0.0) == []


def received(inbox: Inbox, count: int) -> list[Arrival]:
    end = time.monotonic() + PATIENCE_S
    found: list[Arrival] = []
    while len(found) < count and time.monotonic() < end:
        found += inbox.take(0.1)
    return found


def test_messages_cross_the_network_by_both_kinds_of_key() -> None:
    pytest.importorskip("zenoh")
    endpoint = free_endpoint()
    inbox = Inbox()
    with Network((), [endpoint]) as robot, Network([endpoint]) as live:
        live.subscribe("image", "/camera/image", "sensor_msgs/msg/Image", inbox)
        other = "/7/camera/image/sensor_msgs::msg::dds_::Image_/RIHS01_0"
        end = time.monotonic() + PATIENCE_S
        while not (robot.is_heard("/camera/image") and robot.is_heard(other)) and time.monotonic() < end:
            time.sleep(0.02)
        robot.publish("/camera/image", b"by a bridge")
        robot.publish(other, b"by rmw_zenoh")
        assert {arrival.content for arrival in received(inbox, 2)} == {b"by a bridge", b"by rmw_zenoh"}


def test_a_latecomer_gets_what_was_kept() -> None:
    pytest.importorskip("zenoh")
    endpoint = free_endpoint()
    inbox = Inbox()
    with Network((), [endpoint]) as robot:
        robot.keep("/tf_static", b"transforms")
        with Network([endpoint]) as live:
            live.subscribe("transforms", "/tf_static", "tf2_msgs/msg/TFMessage", inbox)
            assert [arrival.content for arrival in received(inbox, 1)] == [b"transforms"]


def test_who_has_not_the_password_is_not_heard(tmp_path: Path) -> None:
    """zenoh's own configuration decides who takes part; endpoints are those that are given."""
    pytest.importorskip("zenoh")
    endpoint, inbox = free_endpoint(), Inbox()
    (tmp_path / "users.txt").write_text("robot:secret\n")
    for name, more in (("live", {"dictionary_file": str(tmp_path / "users.txt")}), ("robot", {})):
        auth = {"usrpwd": {"user": "robot", "password": "secret", **more}}
        config = {"mode": "peer", "scouting": {"multicast": {"enabled": False}}, "transport": {"auth": auth}}
        (tmp_path / f"{name}.json5").write_text(json.dumps(config | {"listen": {"endpoints": []}}))
    with (
        Network((), [endpoint], config_file=tmp_path / "live.json5") as live,
        Network([endpoint], config_file=tmp_path / "robot.json5") as robot,
    ):
        live.subscribe("odometry", "/odom", "nav_msgs/msg/Odometry", inbox)
        end = time.monotonic() + PATIENCE_S
        while not robot.is_heard("/odom") and time.monotonic() < end:
            time.sleep(0.02)
        robot.publish("/odom", b"mine")
        assert [arrival.content for arrival in received(inbox, 1)] == [b"mine"]
        with pytest.raises(InputError, match="that can be reached"):
            Network([endpoint], client=True)


@pytest.mark.parametrize("text", ["{password: ", "mode: 7"])
def test_a_configuration_that_is_none_is_told_without_its_text(tmp_path: Path, text: str) -> None:
    pytest.importorskip("zenoh")
    (tmp_path / "zenoh.json5").write_text(text)
    with pytest.raises(InputError, match=r"zenoh.json5: --zenoh-config: expected a configuration of zenoh") as told:
        Network(config_file=tmp_path / "zenoh.json5")
    assert text not in str(told.value)
    with pytest.raises(InputError, match="no such file"):
        Network(config_file=tmp_path / "nothing.json5")


def test_names_that_are_none_are_refused() -> None:
    pytest.importorskip("zenoh")
    with Network((), [free_endpoint()]) as network, pytest.raises(InputError, match="name of a topic"):
        network.subscribe("image", "/camera//image#", "sensor_msgs/msg/Image", Inbox())
    with pytest.raises(InputError, match="endpoints such as"):
        Network(["nonsense"])


# -- cameras ----------------------------------------------------------------------------------------------------------


def test_a_video_file_is_a_camera(tmp_path: Path) -> None:
    """Every frame comes with the time that it has in the file."""
    path = tmp_path / "drive.avi"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"MJPG"), 20.0, (64, 48))
    for level in range(5):
        writer.write(np.full((48, 64, 3), 40 * level, dtype=np.uint8))
    writer.release()
    frames: list[tuple[int, np.ndarray]] = []
    last = Event()

    def take(t_ns: int, image: np.ndarray) -> None:
        frames.append((t_ns, image))
        if len(frames) == 5:
            last.set()

    source = CameraSource(str(path), take)
    source.start()
    assert last.wait(PATIENCE_S)
    source.close()
    assert [round(float(image.mean()) / 40) for _, image in frames] == [0, 1, 2, 3, 4]
    np.testing.assert_allclose(np.diff([t_ns for t_ns, _ in frames]), 5e7, atol=1e6)


def test_doctor_shows_what_a_camera_sees(tmp_path: Path, localiser: Localiser) -> None:
    path = tmp_path / "drive.avi"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"MJPG"), 50.0, (64, 48))
    for level in (40, 120, 200):
        writer.write(np.full((48, 64, 3), level, np.uint8))
    writer.release()
    result = localiser("doctor", "--image", path, "--seconds", 2, "--picture", tmp_path / "seen.png")
    assert result.exit_code == 0 and "64×48 pixels" in result.out, result.out
    seen = cv2.imread(str(tmp_path / "seen.png"))
    assert seen.shape == (48, 64, 3) and abs(int(seen.mean()) - 200) < 5, "the last frame"
    result = localiser("doctor", "--image", path, "--seconds", 2, "--picture", tmp_path / "seen.png")
    assert result.exit_code == 2 and "already" in result.err


def test_a_camera_that_is_not_there_is_told(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="camera that can be opened"):
        CameraSource(str(tmp_path / "none.mp4"), lambda t_ns, image: None)
