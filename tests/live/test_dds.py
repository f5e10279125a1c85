"""Names of topics for every transport; over DDS, on the loopback interface: both directions, and what is latched."""

import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from threading import Event

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from live_feed import LOG, Feed, camera, drive
from live_networks import KINDS, Network, domains
from live_processes import SETTINGS, START, free_domain, program, wait_until
from short_log import CORRIDOR, Localiser

from localiser.config import LiveParameters
from localiser.errors import InputError
from localiser.live import TOPICS, check_outputs, input_topics, open_transport
from localiser.live.dds_transport import dds_name, dds_type
from localiser.live.outputs import Publisher
from localiser.live.transport import Reply, Service, Topic, Transport
from localiser.live.zenoh_transport import RmwNames, attachment, gid_of, mangled, parts_of, quality
from localiser.ros import SERVICES, outputs_named, service_bytes
from localiser.storage import open_log, read_track
from localiser.storage.bags import ODOM, Messages, RosType, floor_pose, stamp_of, typestore

COUNTERPART = Path(__file__).resolve().parents[1] / "support" / "dds_counterpart.py"
PATIENCE_S = 60.0
FLOOD = 2000  # as many as dds_counterpart.py writes
NAMES, HEARS, RECALLS, LATE, MISMATCHED, ASKED, NODES, EXAMINED, FLOODED = (free_domain() for _ in range(9))


def test_names_are_those_of_ros() -> None:
    topic = Topic("/camera/image_raw", "sensor_msgs/msg/Image")
    assert (dds_name(topic), dds_type(topic.msgtype)) == ("rt/camera/image_raw", "sensor_msgs::msg::dds_::Image_")


@pytest.mark.parametrize("name", ["/", "/a b", "/a//b", "/ä", "/a*"])
def test_a_name_that_ros_does_not_allow_is_refused(name: str) -> None:
    with pytest.raises(InputError, match="expected the name of a topic"):
        dds_name(Topic(name, RosType.POSE))


@contextmanager
def joined(domain: int, **options: str) -> Iterator[Transport]:
    pytest.importorskip("cyclonedds")
    with closing(open_transport(LiveParameters(dds=domain, **options))) as transport:
        yield transport


@contextmanager
def counterpart(domain: int, what: str) -> Iterator[subprocess.Popen[str]]:
    pipe = subprocess.PIPE
    process = subprocess.Popen([sys.executable, COUNTERPART, str(domain), what], stdin=pipe, stdout=pipe, text=True)
    try:
        yield process
    finally:
        process.kill()
        process.wait()


def test_an_interface_that_is_not_there_is_told() -> None:
    pytest.importorskip("cyclonedds")
    with pytest.raises(InputError, match="network interface"):
        open_transport(LiveParameters(dds=NAMES, interface="nothing0"))


def test_a_pose_is_heard_by_types_that_are_not_ours() -> None:
    make, topic = Messages(), Topic("/localiser/pose", RosType.POSE)
    content = make.encode(make.pose_in_map(7_000_000_009, np.array([1.0, 2.0, 0.5]), np.diag([0.04, 0.05, 0.06])))
    with joined(HEARS) as transport, counterpart(HEARS, "hear") as other:
        wait_until(lambda: transport.is_heard(topic))
        transport.publish(topic, content)
        header, position, variance = other.stdout.read().splitlines()
        assert other.wait(PATIENCE_S) == 0
    assert "sec=7, nanosec=9" in header and "frame_id='map'" in header
    assert position.startswith("Point(x=1.0, y=-2.0") and float(variance) == 0.04


def test_the_last_pose_reaches_a_transient_local_subscriber_that_comes_late() -> None:
    """As Nav2's programs subscribe to the pose of AMCL."""
    with joined(RECALLS) as transport:
        feed = Feed()
        feed.run.outputs.publisher = Publisher(transport, outputs_named())
        feed([*camera(), *drive(2)])
        with counterpart(RECALLS, "recall") as other:
            header, position, _ = other.stdout.read().splitlines()
            assert other.wait(PATIENCE_S) == 0
    assert f"nanosec={LOG.frames[1].t_ns}" in header and "frame_id='map'" in header
    assert position.startswith("Point(x=")


def test_what_is_latched_reaches_those_who_come_late() -> None:
    heard: list[tuple[bytes, bytes]] = []
    topic = Topic("/initialpose", RosType.POSE, latched=True, depth=1)
    with joined(LATE) as transport, counterpart(LATE, "latched") as other:
        assert other.stdout is not None and other.stdout.readline() == "ready\n"
        transport.subscribe(topic, lambda content, source: heard.append((content, source)))
        wait_until(lambda: heard)
    message = typestore(ros1=False).deserialize_cdr(heard[0][0], RosType.POSE)
    assert stamp_of(message) == 12_000_000_034 and floor_pose(message)[:2] == (1.5, 2.0)
    assert heard[0][1], "who sent it"


def test_a_quality_of_service_that_does_not_fit_is_told() -> None:
    told: list[str] = []
    with joined(MISMATCHED) as transport, counterpart(MISMATCHED, "mismatched"):
        transport.report_to(told.append)
        transport.subscribe(Topic("/initialpose", RosType.POSE, latched=True), lambda content, source: None)
        wait_until(lambda: told)
    assert "/initialpose: a publisher has another quality of service" in told[0]
    assert "durability" in told[0] or "reliability" in told[0]


def test_who_is_slow_gets_the_newest_messages_of_a_flood() -> None:
    """The network's thread does not wait for whom messages are handed to: all are received, and the oldest dropped."""
    heard: list[int] = []
    received = Event()

    def take(content: bytes, source: bytes) -> None:
        received.wait(PATIENCE_S)
        heard.append(stamp_of(typestore(ros1=False).deserialize_cdr(content, RosType.POSE)) // 10**9)

    topic = Topic("/initialpose", RosType.POSE, depth=10)
    with joined(FLOODED) as transport, counterpart(FLOODED, "flood") as other:
        transport.subscribe(topic, take)
        assert other.stdout is not None and other.stdout.readline() == "received\n"
        received.set()
        wait_until(lambda: heard and heard[-1] == FLOOD - 1)
    assert heard == sorted(heard) and len(heard) < FLOOD // 10


def test_a_service_answers_who_asks() -> None:
    """As Cyclone's middleware of ROS 2 asks: who it is and which request stand before the message."""
    service = SERVICES["look_everywhere"]
    requests: list[bytes] = []

    def answer(content: bytes, reply: Reply) -> None:
        requests.append(content)
        reply(service_bytes("look_everywhere", "Response"))

    with joined(ASKED) as transport, counterpart(ASKED, "ask") as other:
        transport.serve(service, answer)
        assert other.stdout is not None and other.stdout.read() == "5 answered\n"
    assert requests[0].startswith(service_bytes("look_everywhere", "Request")), "and what fills it up to four bytes"


def test_a_node_has_a_name_and_its_topics() -> None:
    with joined(NODES, namespace="robot1") as transport, counterpart(NODES, "nodes") as other:
        transport.advertise(Topic("/localiser/pose", RosType.POSE))
        transport.subscribe(Topic("/initialpose", RosType.POSE), lambda content, source: None)
        assert other.stdout.read() == "/robot1 localiser [['rt/localiser/pose'], ['rt/initialpose']]\n"


WHEELS = Topic("/odom", RosType.ODOMETRY)
LIVE = ("live", "--map", CORRIDOR / "map.yaml", "--start", START, "--json", *SETTINGS)
ROBOT = ("simulate", CORRIDOR, "--serve", "--quiet")
MAKE = Messages()


@pytest.fixture(params=KINDS)
def domain(request: pytest.FixtureRequest) -> Iterator[Callable[[], Network]]:
    """Return what makes domains of ROS 2, each over the same router, or each of DDS."""
    with domains(request.param) as made:
        yield made


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_a_demo_is_identical_to_the_replay_of_its_recording(localiser: Localiser, tmp_path: Path, kind: str) -> None:
    pytest.importorskip("cyclonedds" if kind == "dds" else "zenoh")
    bag = tmp_path / "drive.db3"
    settings = ("--set", "mcl.particles=300", "--set", "mcl.start_particles=1000")
    network = ("--set", f"live.dds={free_domain()}") if kind == "dds" else ()
    with program("live", "demo", CORRIDOR, *network, "--json", "--record", bag, *settings) as live:
        lines = live.poses(15)
        assert live.end() == 0, live.all_said()
        live.all_said()
        lines += live.rest()
    track = read_track(localiser.replay(bag, tmp_path / "results", few=False) / "trajectory.csv")
    assert len(track.t_ns) == len(open_log(bag).frames) >= 15
    assert track.t_ns.tolist() == [line["t_ns"] for line in lines]
    poses = [[line["x"], line["z"], line["heading"]] for line in lines]
    np.testing.assert_allclose(track.poses, poses, rtol=0, atol=1e-9)


def test_messages_do_not_leave_their_domain(domain: Callable[[], Network]) -> None:
    mine, other = domain(), domain()
    heard: list[bytes] = []
    wanted, unwanted = (MAKE.encode(MAKE.odometry(t_ns, ODOM, np.zeros(3))) for t_ns in (1, 2))
    with closing(open_transport(mine.options)) as member, closing(open_transport(other.options)) as beside:
        member.subscribe(WHEELS, lambda content, source: heard.append(content))
        wait_until(lambda: member.is_heard(WHEELS))
        assert not beside.is_heard(WHEELS)
        beside.publish(WHEELS, unwanted)
        wait_until(lambda: member.publish(WHEELS, wanted) or heard)
    assert set(heard) == {wanted}


def test_a_namespace_holds_what_is_named_without_a_leading_slash() -> None:
    """As in ROS; without a namespace, that is the topic with the slash."""
    topics = input_topics({"odometry": "/wheels", "groundtruth": "truth"}, "/robot1")
    assert (topics["odometry"], topics["image"]) == ("/wheels", "/robot1/camera/image_raw/compressed")
    assert (
        topics["groundtruth"] == "/robot1/truth" and input_topics({"groundtruth": "truth"})["groundtruth"] == "/truth"
    )
    assert list(topics) == list(TOPICS)
    assert topics["clock"] == "/clock", "as every node of ROS has it"
    assert input_topics({"clock": "time"}, "/robot1")["clock"] == "/robot1/time"
    assert outputs_named({"pose": "amcl_pose"}, "/robot1")["pose"].name == "/robot1/amcl_pose"
    assert outputs_named({"pose": "/amcl_pose"}, "/robot1")["pose"].name == "/amcl_pose"


@pytest.mark.parametrize("name", ["/odom", "odom", "/odom/"])
def test_one_topic_for_two_kinds_is_refused(name: str) -> None:
    with pytest.raises(InputError, match="unknown kind of message"):
        outputs_named({"poses": name})
    with pytest.raises(InputError, match=r"live\.topics: expected .* for odometry and for groundtruth"):
        input_topics({"groundtruth": name})
    with pytest.raises(InputError, match="unknown kind of topic"):
        input_topics({"truth": name})


@pytest.mark.parametrize(
    ("publish", "told"),
    [
        ({"pose": "/initialpose"}, "/initialpose for what comes in as initialpose and for what goes out as pose"),
        ({"pose": "/here", "path": "/here"}, "/here for what goes out as pose and for what goes out as path"),
    ],
)
def test_one_topic_in_and_out_is_refused(publish: dict[str, str], told: str) -> None:
    with pytest.raises(InputError, match=f"live.publish: expected .* found {told}"):
        check_outputs(input_topics({}), outputs_named(publish))
    check_outputs(input_topics({}), outputs_named({"pose": "/amcl_pose", "path": None}))


@pytest.mark.parametrize(
    "arguments", [("live", "--map", CORRIDOR / "map.yaml"), ("doctor", "--set", "live.connect=tcp/127.0.0.1:9")]
)
def test_commands_refuse_it_before_they_join_a_network(localiser: Localiser, arguments: tuple[object, ...]) -> None:
    result = localiser(*arguments, "--set", "live.topics.groundtruth=/odom")
    assert result.exit_code == 2 and "for odometry and for groundtruth" in result.err


ZID = "ac50be7e5e2b5b0a28fd5e8f2e1ad1d5"
IMAGE = Topic("/camera/image_raw", "sensor_msgs/msg/Image", reliable=False, depth=5)
FIXED = Topic("/tf_static", "tf2_msgs/msg/TFMessage", latched=True, depth=1)
CHATTER = Topic("/chatter", "std_msgs/msg/String")
CHATTER_HASH = "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18"
EMPTY = Service("/global_localization", "std_srvs/srv/Empty", "RIHS01_0")


def test_keys_have_domain_topic_type_and_hash() -> None:
    assert RmwNames().key(CHATTER) == f"0/chatter/std_msgs::msg::dds_::String_/{CHATTER_HASH}"
    assert RmwNames(domain=7).pattern(IMAGE) == "7/camera/image_raw/sensor_msgs::msg::dds_::Image_/*"
    assert RmwNames(hashes=False).key(CHATTER) == "0/chatter/std_msgs::msg::dds_::String_/TypeHashNotSupported"
    assert RmwNames().service_key(EMPTY) == "0/global_localization/std_srvs::srv::dds_::Empty_/RIHS01_0"


def test_tokens_tell_node_publisher_subscriber_and_service() -> None:
    names = RmwNames(2)
    assert names.node_token(ZID) == f"@ros2_lv/2/{ZID}/0/0/NN/%/%/localiser"
    assert names.topic_token(ZID, 3, CHATTER, "MP") == (
        f"@ros2_lv/2/{ZID}/0/3/MP/%/%/localiser/%chatter/std_msgs::msg::dds_::String_/{CHATTER_HASH}/::,10:,:,:,,"
    )
    token = RmwNames(0, "/robot1").topic_token(ZID, 4, IMAGE, "MS")
    assert token.startswith(f"@ros2_lv/0/{ZID}/0/4/MS/%/%robot1/localiser/%camera%image_raw/sensor_msgs::msg::dds_::")
    assert token.endswith("/2::,5:,:,:,,")
    assert names.service_token(ZID, 5, EMPTY) == (
        f"@ros2_lv/2/{ZID}/0/5/SS/%/%/localiser/%global_localization/std_srvs::srv::dds_::Empty_/RIHS01_0/::,10:,:,:,,"
    )


def test_quality_of_service() -> None:
    assert quality(CHATTER) == "::,10:,:,:,,"
    assert quality(FIXED) == ":1:,1:,:,:,,"
    assert quality(IMAGE) == "2::,5:,:,:,,"


def test_names_in_tokens_have_no_slashes() -> None:
    assert [mangled(name) for name in ("", "/", "/robot1", "/a/b")] == ["%", "%", "%robot1", "%a%b"]


def test_an_attachment_is_33_bytes() -> None:
    """Sequence number, time, length of the gid, gid; the gid is the token's XXH3-128, lower half first."""
    assert gid_of("").hex() == "7f498d4624c30160d8984701d306aa99"  # 99aa06d3014798d8 6001c324468d497f, as published
    content = attachment(1, 1_700_000_000_000_000_000, bytes(range(16)))
    assert content.hex() == "010000000000000000002a36fe9c971710000102030405060708090a0b0c0d0e0f"
    assert len(content) == 33 and parts_of(content) == (1, 1_700_000_000_000_000_000, bytes(range(16)))


@pytest.mark.parametrize("content", [b"", bytes(33), bytes(34)])
def test_what_is_no_attachment_is_refused(content: bytes) -> None:
    with pytest.raises(ValueError, match="expected"):
        parts_of(content)


PARTS = st.lists(st.text("abcxyz_0", min_size=1, max_size=6).filter(lambda name: not name.isdigit()), min_size=1)


@given(parts=PARTS)
def test_a_key_gives_its_topic_back(parts: list[str]) -> None:
    topic = Topic("/" + "/".join(parts), "sensor_msgs/msg/Image")
    assert RmwNames(5).topic_of(RmwNames(5).key(topic)) == (topic.name, topic.msgtype)
