"""The layouts that ship show topics that there are."""

from __future__ import annotations

import json
import re

import yaml

from localiser.ros import LAYOUTS, OUTPUTS, outputs_named

TOPICS = {output.topic: output for output in (*OUTPUTS.values(), outputs_named({"pose": "amcl_pose"})["pose"])}
OTHERS = {"/initialpose", "/camera/image_raw/compressed"}


def test_every_topic_of_a_layout_exists() -> None:
    for file in ("localiser.rviz", "foxglove.json"):
        named = set(re.findall(r"/[a-z_]+(?:/[a-z_]+)*(?=[\",:])", (LAYOUTS / file).read_text()))
        named = {
            name
            for name in named
            if name.split("/")[1] in ("localiser", "diagnostics", "camera", "initialpose", "amcl_pose")
        }
        assert len(named) >= 6 and named <= TOPICS.keys() | OTHERS, named


SHOWS = {
    "rviz_default_plugins/MarkerArray": "visualization_msgs/msg/MarkerArray",
    "rviz_default_plugins/PoseArray": "geometry_msgs/msg/PoseArray",
    "rviz_default_plugins/Path": "nav_msgs/msg/Path",
    "rviz_default_plugins/PoseWithCovariance": "geometry_msgs/msg/PoseWithCovarianceStamped",
    "rviz_default_plugins/Image": "sensor_msgs/msg/CompressedImage",  # by the last part of the topic's name
}
"""What each display of RViz takes."""


def test_a_display_asks_for_the_type_and_the_quality_of_service_that_are_offered() -> None:
    """What is offered is reliable, which serves those who ask for less too."""
    layout = yaml.safe_load((LAYOUTS / "localiser.rviz").read_text())
    manager = layout["Visualization Manager"]
    shown = [display for display in manager["Displays"] if "Topic" in display]
    assert manager["Global Options"]["Fixed Frame"] == "map" and len(shown) == 7
    for display in shown:
        topic, offered = display["Topic"], TOPICS[display["Topic"]["Value"]]
        assert SHOWS[display["Class"]] == offered.msgtype
        assert topic["Durability Policy"] == ("Transient Local" if offered.latched else "Volatile")
        assert topic["Reliability Policy"] in ("Reliable", "Best Effort") and topic["Depth"] >= 1


def test_the_pose_is_shown_under_both_names_that_the_guide_has() -> None:
    layout = yaml.safe_load((LAYOUTS / "localiser.rviz").read_text())
    shown = {display["Topic"]["Value"] for display in layout["Visualization Manager"]["Displays"] if "Topic" in display}
    assert {"/localiser/pose", "/amcl_pose"} <= shown


def test_every_panel_of_foxglove_has_its_place() -> None:
    layout = json.loads((LAYOUTS / "foxglove.json").read_text())
    assert set(layout["configById"]) == set(re.findall(r"\w+!localiser", json.dumps(layout["layout"])))
