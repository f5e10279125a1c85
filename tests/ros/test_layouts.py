"""The layouts that ship show topics that there are."""

from __future__ import annotations

import json
import re

import yaml

from localiser.ros import OUTPUTS
from localiser.ros.layouts import FOLDER

TOPICS = {output.topic: output for output in OUTPUTS.values()}
OTHERS = {"/initialpose", "/camera/image_raw/compressed"}


def test_every_topic_of_a_layout_exists() -> None:
    for file in ("localiser.rviz", "foxglove.json"):
        named = set(re.findall(r"/[a-z_]+(?:/[a-z_]+)*(?=[\",:])", (FOLDER / file).read_text()))
        named = {name for name in named if name.split("/")[1] in ("localiser", "diagnostics", "camera", "initialpose")}
        assert len(named) >= 6 and named <= TOPICS.keys() | OTHERS, named


def test_a_display_asks_for_the_quality_of_service_that_is_offered() -> None:
    layout = yaml.safe_load((FOLDER / "localiser.rviz").read_text())
    manager = layout["Visualization Manager"]
    shown = [display["Topic"] for display in manager["Displays"] if "Topic" in display]
    assert manager["Global Options"]["Fixed Frame"] == "map" and len(shown) == 6
    for topic in shown:
        latched = topic["Durability Policy"] == "Transient Local"
        assert TOPICS[topic["Value"]].latched == latched


def test_every_panel_of_foxglove_has_its_place() -> None:
    layout = json.loads((FOLDER / "foxglove.json").read_text())
    assert set(layout["configById"]) == set(re.findall(r"\w+!localiser", json.dumps(layout["layout"])))
