"""Names of topics: each is for one thing."""

from __future__ import annotations

import pytest
from short_log import CORRIDOR, Localiser

from localiser.errors import InputError
from localiser.live import TOPICS, check_outputs, input_topics
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
    assert outputs_named({"pose": "amcl_pose"}, "/robot1")["pose"].topic == "/robot1/amcl_pose"
    assert outputs_named({"pose": "/amcl_pose"}, "/robot1")["pose"].topic == "/amcl_pose"


@pytest.mark.parametrize("name", ["/odom", "odom", "/odom/"])
def test_one_topic_for_two_kinds_is_refused(name: str) -> None:
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
