"""Transports between sessions of our own, through a router in this process."""

import json
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest
from live_networks import router
from live_processes import free_endpoint, wait_until

from localiser.config import LiveParameters
from localiser.errors import InputError
from localiser.live.transport import Service, Topic, Transport, open_transport
from localiser.live.zenoh_transport import ZenohTransport, attachment

zenoh = pytest.importorskip("zenoh")

PATIENCE_S = 30.0
ODOMETRY = Topic("/odom", "nav_msgs/msg/Odometry", reliable=False, depth=5)
RELIABLE = Topic("/odom", "nav_msgs/msg/Odometry", depth=10)
FIXED = Topic("/tf_static", "tf2_msgs/msg/TFMessage", latched=True, depth=1)


@pytest.fixture
def endpoint() -> Iterator[str]:
    """Run a router; return its endpoint."""
    at = free_endpoint()
    with router(at):
        yield at


def joined(endpoint: str, **options: Any) -> closing[ZenohTransport]:
    return closing(open_transport(LiveParameters([endpoint], **options)))


def test_messages_go_from_client_to_client(endpoint: str) -> None:
    got: list[tuple[bytes, bytes]] = []
    with joined(endpoint) as robot, joined(endpoint) as live:
        live.subscribe(RELIABLE, lambda *message: got.append(message))
        wait_until(lambda: robot.is_heard(RELIABLE))
        contents = [bytes([number]) for number in range(5)]
        for content in contents:
            # A sender that gets no processor has a full queue, and drops what is published then.
            wait_until(lambda content=content: robot.publish(RELIABLE, content) or content in [one for one, _ in got])
    received = [content for content, _ in got]
    assert received == sorted(received)
    assert sorted(set(received)) == contents
    assert {len(source) for _, source in got} == {16}


def test_what_is_latched_reaches_those_who_came_before_and_after(endpoint: str) -> None:
    early: list[bytes] = []
    late: list[bytes] = []
    with joined(endpoint) as first, joined(endpoint) as robot:
        first.subscribe(FIXED, lambda content, source: early.append(content))
        robot.publish(FIXED, b"old")
        robot.publish(FIXED, b"new")
        wait_until(lambda: b"new" in early)
        with joined(endpoint) as live:
            live.subscribe(FIXED, lambda content, source: late.append(content))
            wait_until(lambda: late)
    assert late == [b"new"]


def test_a_peer_of_a_router_is_told_by_tokens(endpoint: str) -> None:
    """As `ros2 topic list` and `ros2 node info` find it; all go when it leaves."""
    with closing_session(endpoint) as session:
        tokens = lambda: sorted(str(reply.ok.key_expr) for reply in session.liveliness().get("@ros2_lv/**"))  # noqa: E731
        with joined(endpoint, namespace="robot1") as live:
            live.advertise(FIXED)
            live.subscribe(ODOMETRY, lambda content, source: None)
            live.serve(Service("/go", "std_srvs/srv/Empty", "RIHS01_1"), lambda content, reply: None)
            wait_until(lambda: len(tokens()) == 4)
            kinds = sorted(token.split("/")[5:9] for token in tokens())
            node = ["%", "%robot1", "localiser"]
            assert kinds == [["MP", *node], ["MS", *node], ["NN", *node], ["SS", *node]]
        wait_until(lambda: not tokens())


def closing_session(endpoint: str) -> Any:
    config = zenoh.Config()
    for name, value in {"mode": "client", "connect/endpoints": [endpoint]}.items():
        config.insert_json5(name, json.dumps(value))
    return zenoh.open(config)


def test_a_router_that_comes_late_or_goes_away_is_waited_for() -> None:
    at, got = free_endpoint(), []
    with joined(at) as robot, joined(at) as live:
        live.subscribe(ODOMETRY, lambda content, source: got.append(content))
        robot.publish(FIXED, b"kept")
        assert not robot.is_heard(ODOMETRY)
        for content in (b"first", b"second"):
            running = router(at)
            wait_until(lambda: robot.is_heard(ODOMETRY))
            if content == b"first":
                live.subscribe(FIXED, lambda content, source: got.append(content))
                wait_until(lambda: b"kept" in got)

            def heard(content: bytes = content) -> bool:
                robot.publish(ODOMETRY, content)
                return content in got

            wait_until(heard)
            running.close()


def test_a_service_answers_with_the_attachment_of_the_request(endpoint: str) -> None:
    asked: list[bytes] = []
    service = Service("/go", "std_srvs/srv/Empty", "RIHS01_1")
    with joined(endpoint) as live, closing_session(endpoint) as session:

        def answer(request: bytes, reply: Callable[[bytes], None]) -> None:
            asked.append(request)
            reply(b"done")

        live.serve(service, answer)
        replies: list[Any] = []

        def ask(extra: bytes) -> list[Any]:
            key = "0/go/std_srvs::srv::dds_::Empty_/RIHS01_1"
            return list(session.get(key, payload=b"please", attachment=extra, timeout=2.0))

        wait_until(lambda: replies.extend(ask(attachment(7, 1, bytes(16)))) or replies)
        ok = replies[0].ok
        assert ok.payload.to_bytes() == b"done" and asked[-1] == b"please"
        assert ok.attachment.to_bytes()[:8] == (7).to_bytes(8, "little") and len(ok.attachment.to_bytes()) == 33
        count = len(asked)
        assert ask(b"none") == [] and len(asked) == count


def test_all_topics_can_be_listened_to(endpoint: str) -> None:
    got: list[tuple[str, str | None, bytes]] = []
    with joined(endpoint) as robot, joined(endpoint) as live:
        live.listen_to_all(lambda *message: got.append(message))
        wait_until(lambda: robot.publish(ODOMETRY, b"1") or got)
        assert all(hasattr(live, name) for name in vars(Transport) if not name.startswith("_"))
    assert set(got) == {("/odom", "nav_msgs/msg/Odometry", b"1")}


def test_who_has_not_the_password_is_not_heard(tmp_path: Path) -> None:
    """zenoh's own configuration decides who takes part; endpoints are those that are given."""
    at, got = free_endpoint(), []
    (tmp_path / "users.txt").write_text("robot:secret\n")
    for name, more in (("live", {"dictionary_file": str(tmp_path / "users.txt")}), ("robot", {})):
        auth = {"usrpwd": {"user": "robot", "password": "secret", **more}}
        config = {"mode": "peer", "scouting": {"multicast": {"enabled": False}}, "transport": {"auth": auth}}
        (tmp_path / f"{name}.json5").write_text(json.dumps(config | {"listen": {"endpoints": []}}))
    opened = [
        closing(open_transport(LiveParameters(*ends, zenoh_config=str(tmp_path / f"{name}.json5"))))
        for name, ends in (("live", ([], [at])), ("robot", ([at], [])))
    ]
    with opened[0] as live, opened[1] as robot:
        live.subscribe(ODOMETRY, lambda content, source: got.append(content))
        wait_until(lambda: robot.is_heard(ODOMETRY))
        wait_until(lambda: robot.publish(ODOMETRY, b"mine") or got)
        with pytest.raises(InputError, match="that can be reached"):
            open_transport(LiveParameters([at]), wait=False)


@pytest.mark.parametrize("text", ["{password: ", "mode: 7"])
def test_a_configuration_that_is_none_is_told_without_its_text(tmp_path: Path, text: str) -> None:
    (tmp_path / "zenoh.json5").write_text(text)
    with pytest.raises(InputError, match=r"zenoh.json5: live.zenoh_config: expected a configuration of zenoh") as told:
        open_transport(LiveParameters(zenoh_config=str(tmp_path / "zenoh.json5")))
    assert text not in str(told.value)
    with pytest.raises(InputError, match="no such file"):
        open_transport(LiveParameters(zenoh_config=str(tmp_path / "nothing.json5")))


@pytest.mark.parametrize("name", ["/camera//image#", "/camera/*", "/", ""])
def test_names_that_are_none_are_refused(name: str) -> None:
    with (
        closing(open_transport(LiveParameters([], [free_endpoint()]))) as live,
        pytest.raises(InputError, match="name of a topic"),
    ):
        live.subscribe(Topic(name, "sensor_msgs/msg/Image"), lambda content, source: None)


@pytest.mark.parametrize(
    ("options", "told"),
    [({"connect": ["nonsense"]}, "endpoints such as"), ({"namespace": "robot one"}, "live.namespace")],
)
def test_options_that_are_none_are_refused(options: dict[str, Any], told: str) -> None:
    with pytest.raises(InputError, match=told):
        open_transport(LiveParameters(**options))


def test_the_domain_is_that_of_the_environment(monkeypatch: pytest.MonkeyPatch, endpoint: str) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", "5")
    monkeypatch.setenv("ROS_DISTRO", "humble")
    got: list[str] = []
    with closing_session(endpoint) as session, joined(endpoint) as robot:
        session.declare_subscriber("**", lambda sample: got.append(str(sample.key_expr)))
        wait_until(lambda: robot.publish(ODOMETRY, b"1") or got)
    assert got[0] == "5/odom/nav_msgs::msg::dds_::Odometry_/TypeHashNotSupported"
    monkeypatch.setenv("ROS_DOMAIN_ID", "many")
    with pytest.raises(InputError, match="ROS_DOMAIN_ID"):
        open_transport(LiveParameters([endpoint]))


PEER = """
import os, sys, time
from localiser.config import LiveParameters
from localiser.live.transport import Topic, open_transport
topic = Topic("/odom", "nav_msgs/msg/Odometry", reliable=False, depth=5)
transport = open_transport(LiveParameters([sys.argv[1]]))
end = time.monotonic() + 30
while time.monotonic() < end and not transport.is_heard(topic):
    time.sleep(0.05)
for _ in range(10):
    transport.publish(topic, bytes(40_000))
    time.sleep(0.05)
os.kill(os.getpid(), 9)
"""


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="descriptors as Linux lists them")
def test_peers_that_are_killed_leave_nothing_open() -> None:
    at, counts = free_endpoint(), []
    got: list[bytes] = []
    with closing(open_transport(LiveParameters([], [at]))) as live:
        live.subscribe(ODOMETRY, lambda content, source: got.append(content))
        for _ in range(4):
            got.clear()
            subprocess.run([sys.executable, "-c", PEER, at], check=False, timeout=PATIENCE_S + 30)
            assert got, "it was connected"
            counts.append(settled_descriptors())
    assert counts[-1] <= counts[0] + 1


def settled_descriptors() -> int:
    """Return how many descriptors are open, once that is the same for a second: peers take time to be left."""
    counts = [-1]
    while len(counts) < 11 or len(set(counts[-10:])) > 1:
        time.sleep(0.1)
        counts.append(len(list(Path("/proc/self/fd").iterdir())))
    return counts[-1]
