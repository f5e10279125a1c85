"""Names of topics, each for one thing; keys, liveliness tokens and attachments as rmw_zenoh has them: golden values."""

import pytest
from hypothesis import given
from hypothesis import strategies as st
from short_log import CORRIDOR, Localiser

from localiser.errors import InputError
from localiser.live import TOPICS, check_outputs, input_topics
from localiser.live.transport import Service, Topic
from localiser.live.zenoh_transport import RmwNames, attachment, gid_of, mangled, parts_of, quality
from localiser.ros import outputs_named


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


NAMES = st.lists(st.text("abcxyz_0", min_size=1, max_size=6).filter(lambda name: not name.isdigit()), min_size=1)


@given(parts=NAMES)
def test_a_key_gives_its_topic_back(parts: list[str]) -> None:
    topic = Topic("/" + "/".join(parts), "sensor_msgs/msg/Image")
    assert RmwNames(5).topic_of(RmwNames(5).key(topic)) == (topic.name, topic.msgtype)
