"""What a located image is as messages of ROS 2: read back by rosbags, compared with what was located."""

import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import yaml
from short_log import CORRIDOR

from localiser import Localiser
from localiser.config import read_config
from localiser.filter import LocatedFrame
from localiser.geometry import pose_from_ros
from localiser.ros import LAYOUTS, OUTPUTS, Frames, Message, Outgoing, outputs_named
from localiser.ros.outgoing import MOST_PARTICLES, MOST_POSES
from localiser.storage import open_log, read_map
from localiser.storage.bags import stamp_of, typestore

LOG = open_log(CORRIDOR)
STAMP_NS = 1_700_000_000_123_456_789


@pytest.fixture(scope="module")
def frames() -> list[LocatedFrame]:
    """Return the first images of the log, located."""
    localiser = Localiser(LOG.landmark_map, LOG.camera, read_config(None, ["mcl.particles=500"]))
    localiser.start(LOG.start.mean, LOG.start.cov, LOG.start.t_ns)
    found = []
    for event in LOG.events(None, anywhere=True):
        if hasattr(event, "encoded"):
            found += localiser.image(event.t_ns, event.encoded())
        else:
            found += localiser.odometry(event.t_ns, event.pose)
        if len(found) >= 6:
            break
    return found


def outgoing(**settings: Any) -> Outgoing:
    return Outgoing(LOG.landmark_map, LOG.camera, **settings)


def read(message: Message) -> Any:
    return typestore(ros1=False).deserialize_cdr(message.content, OUTPUTS[message.kind].msgtype)


def test_every_kind_is_made_and_can_be_read(frames: list[LocatedFrame]) -> None:
    make = outgoing()
    made = [
        *make.map(STAMP_NS),
        *make.landmarks(STAMP_NS),
        *make.image(frames[-1], STAMP_NS),
        *make.transform(STAMP_NS),
    ]
    assert sorted(message.kind for message in made) == sorted(OUTPUTS)
    for message in made:
        assert read(message) is not None


def test_the_pose_is_that_of_the_estimate_with_its_covariance(frames: list[LocatedFrame]) -> None:
    (message,) = outgoing(kinds=("pose",)).image(frames[-1], STAMP_NS)
    pose = read(message)
    at, turned = pose.pose.pose.position, pose.pose.pose.orientation
    found = pose_from_ros([at.x, at.y, 2 * np.arctan2(turned.z, turned.w)])
    np.testing.assert_allclose(found, frames[-1].located.estimate.pose, atol=1e-12)
    assert (pose.header.frame_id, stamp_of(pose)) == ("map", STAMP_NS)
    cov = np.array(pose.pose.covariance).reshape(6, 6)
    assert cov[5, 5] == pytest.approx(frames[-1].located.estimate.pose_cov[2, 2])


def test_wheels_after_the_transform_give_the_pose(frames: list[LocatedFrame]) -> None:
    """map→odom ∘ odom→base is map→base at the image, and the stamp lies ahead by the tolerance."""
    located = frames[-1].located
    make = outgoing(frames=Frames("world", "wheels"), tolerance_ns=50_000_000)
    assert make.transform(STAMP_NS) == []
    make.image(frames[-1], STAMP_NS)
    (message,) = make.transform(STAMP_NS)
    (stamped,) = read(message).transforms
    moved, turned = stamped.transform.translation, stamped.transform.rotation
    cos, sin = np.cos(2 * np.arctan2(turned.z, turned.w)), np.sin(2 * np.arctan2(turned.z, turned.w))
    x, z, _ = located.odometry
    place = [moved.x + cos * x + sin * z, -(moved.y + sin * x - cos * z)]
    np.testing.assert_allclose(place, located.estimate.pose[:2], atol=1e-9)
    assert (stamped.header.frame_id, stamped.child_frame_id) == ("world", "wheels")
    assert stamp_of(stamped) == STAMP_NS + 50_000_000


def test_the_transform_is_held_back_while_the_pose_is_more_likely_wrong(frames: list[LocatedFrame]) -> None:
    make = outgoing()
    make.image(replace(frames[-1], located=replace(frames[-1].located, p_correct=0.4)), STAMP_NS)
    assert make.transform(STAMP_NS) == []
    make.image(frames[-1], STAMP_NS)
    assert len(make.transform(STAMP_NS)) == 1
    make.forget()
    assert make.transform(STAMP_NS) == []


def test_particles_are_few_and_lie_where_the_cloud_does(frames: list[LocatedFrame]) -> None:
    (message,) = outgoing(kinds=("particles",)).image(frames[-1], STAMP_NS)
    poses = read(message).poses
    assert len(poses) == MOST_PARTICLES < len(frames[-1].located.particles)
    x, z, _ = frames[-1].located.estimate.pose
    assert np.mean([pose.position.x for pose in poses]) == pytest.approx(x, abs=0.02)
    assert np.mean([-pose.position.y for pose in poses]) == pytest.approx(z, abs=0.02)


def test_the_map_is_the_text_of_its_file(tmp_path: Path) -> None:
    (message,) = outgoing().map(STAMP_NS)
    (tmp_path / "map.yaml").write_text(read(message).data)
    np.testing.assert_array_equal(read_map(tmp_path / "map.yaml").points, LOG.landmark_map.points)
    assert outgoing(kinds=("pose",)).map(STAMP_NS) == []


def test_landmarks_are_upright_lines_in_the_map(frames: list[LocatedFrame]) -> None:
    (message,) = outgoing().landmarks(STAMP_NS)
    (marker,) = read(message).markers
    points = np.array([[point.x, point.y, point.z] for point in marker.points]).reshape(-1, 2, 3)
    np.testing.assert_allclose(points[:, 0, :2], LOG.landmark_map.points * [1, -1])
    np.testing.assert_array_equal(points[:, 0, :2], points[:, 1, :2])
    assert (points[:, 1, 2] > points[:, 0, 2]).all() and marker.header.frame_id == "map"


def test_matches_are_the_landmarks_that_edges_show(frames: list[LocatedFrame]) -> None:
    frame = frames[-1]
    (message,) = outgoing(kinds=("matches",)).image(frame, STAMP_NS)
    posts, sights = read(message).markers
    landmark = np.unique(frame.matches.landmark[frame.matches.landmark >= 0])
    found = np.array([[point.x, -point.y] for point in posts.points])[::2]
    np.testing.assert_allclose(found, LOG.landmark_map.points[landmark])
    assert len(sights.points) == 2 * len(landmark) and len(landmark) > 3
    x, z, _ = LOG.camera.pose_in_map(frame.located.estimate.pose)
    assert (sights.points[0].x, sights.points[0].y) == pytest.approx((x, -z))


def test_markers_go_when_nothing_matches(frames: list[LocatedFrame]) -> None:
    nothing = replace(frames[-1].matches, landmark=np.full_like(frames[-1].matches.landmark, -1))
    empty = replace(frames[-1], located=replace(frames[-1].located, matches=nothing))
    (message,) = outgoing(kinds=("matches",)).image(empty, STAMP_NS)
    assert [(marker.action, len(marker.points)) for marker in read(message).markers] == [(2, 0), (2, 0)]


def test_the_path_grows_by_steps_and_stays_short(frames: list[LocatedFrame]) -> None:
    make, located = outgoing(kinds=("path",)), frames[-1].located
    lengths = []
    for step in range(3 * MOST_POSES):
        mean = located.estimate.mean.copy()
        mean[0] = 0.06 * step
        moved = replace(located, estimate=replace(located.estimate, mean=mean))
        messages = make.image(
            replace(frames[-1], located=moved), STAMP_NS + step, wanted=lambda kind, step=step: step % 500 == 2
        )
        lengths += [len(read(message).poses) for message in messages]
    assert lengths and max(lengths) <= MOST_POSES
    make.image(replace(frames[-1], located=moved), STAMP_NS)
    assert make.image(replace(frames[-1], located=moved), STAMP_NS) == []


def test_edges_are_drawn_into_the_image(frames: list[LocatedFrame]) -> None:
    frame = frames[-1]
    (message,) = outgoing(kinds=("image",)).image(frame, STAMP_NS)
    drawn = cv2.imdecode(np.array(read(message).data), cv2.IMREAD_COLOR)
    assert drawn.shape == (LOG.camera.height, LOG.camera.width, 3)
    matched = frame.located.edges.ends_px[frame.matches.landmark >= 0]
    u, v = np.round(matched.mean(axis=1)).astype(int).T
    blue, green, red = drawn[v, u].astype(int).T
    assert (green > red).all() and (green > blue).mean() > 0.8
    assert outgoing(kinds=("image",)).image(replace(frame, image=None), STAMP_NS) == []


@pytest.mark.parametrize(("p_correct", "level"), [(0.99, 0), (0.7, 1), (0.2, 2)])
def test_diagnostics_say_how_far_to_trust_the_pose(frames: list[LocatedFrame], p_correct: float, level: int) -> None:
    frame = replace(frames[-1], located=replace(frames[-1].located, p_correct=p_correct))
    (message,) = outgoing(kinds=("diagnostics",)).image(frame, STAMP_NS, facts={"bad image": "3"})
    (status,) = read(message).status
    values = {pair.key: pair.value for pair in status.values}
    assert status.level == level and float(values["p_correct"]) == p_correct and values["bad image"] == "3"


TOPICS = {output.name: output for output in (*OUTPUTS.values(), outputs_named({"pose": "amcl_pose"})["pose"])}
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
