"""The mount from ROS transforms, against projecting points through those transforms."""

from dataclasses import astuple, replace
from itertools import pairwise
from pathlib import Path

import attack_bombs as bombs
import numpy as np
import pytest
from bounded import bounded
from hypothesis import given, settings
from hypothesis import strategies as st
from small_bag import MAKE, OPTICAL, Recorder, recording
from small_log import CAMERA

from localiser.camera import Mount
from localiser.errors import InputError
from localiser.storage import open_log
from localiser.storage.bags import RosType
from localiser.storage.bags.transforms import (
    MOST_STEPS,
    FrameTree,
    base_from_optical,
    mount_of,
    quaternion_from_rotation,
    rotation_from_quaternion,
)

angle = st.floats(-80, 80)
length = st.floats(-2, 2)
mounts = st.builds(
    lambda tilt, roll, yaw, height, right, back: Mount(
        np.radians(tilt), height, np.radians(roll), np.radians(yaw), right, back
    ),
    angle,
    st.floats(-170, 170),
    st.floats(-170, 170),
    st.floats(0.05, 3),
    length,
    length,
)


def add(tree: FrameTree, parent: str, child: str, transform: np.ndarray) -> None:
    moved = dict(zip("xyz", transform[:3, 3], strict=True))
    turned = dict(zip("xyzw", quaternion_from_rotation(transform[:3, :3]), strict=True))
    content = {"child_frame_id": child, "transform": {"translation": moved, "rotation": turned}}
    tree.add_all([MAKE.make("geometry_msgs/msg/TransformStamped", header={"frame_id": parent}, **content)])


@settings(max_examples=100)
@given(mounts, st.integers(0, 2**32 - 1), st.integers(0, 3), st.booleans())
def test_mount_of_any_chain_projects_points_as_the_transforms_do(mount, seed, links, backwards):
    """Points before the camera, in the robot's ROS frame, land on the same pixels by both ways."""
    rng = np.random.default_rng(seed)
    camera = CAMERA.ideal.with_mount(**dict(zip(Mount.__slots__, astuple(mount), strict=True)))
    whole = base_from_optical(camera.mount, camera.level_from_camera)
    tree = chain(whole, rng, links, backwards)
    found = camera.with_mount(**dict(zip(Mount.__slots__, astuple(mount_of(tree, "base", "optical")), strict=True)))
    in_optical = rng.uniform([-1, -1, 1], [1, 1, 5], (20, 3))
    in_base = in_optical @ whole[:3, :3].T + whole[:3, 3]
    by_hand = in_optical[:, :2] / in_optical[:, 2:] * [camera.fx, camera.fy] + [camera.cx, camera.cy]
    # x ahead, y left, z up → a robot at the map's origin that faces −z.
    in_map = np.stack([-in_base[:, 1], in_base[:, 2], -in_base[:, 0]], axis=-1)
    np.testing.assert_allclose(found.project(np.zeros(3), in_map), by_hand, rtol=0, atol=1e-5)


def chain(whole: np.ndarray, rng: np.random.Generator, links: int, backwards: bool) -> FrameTree:
    """Return a tree in which `whole` is broken into a chain of random transforms, some of them the other way round."""
    tree = FrameTree()
    names = ["base", *(f"link{index}" for index in range(links)), "optical"]
    rest = whole
    for parent, child in pairwise(names[:-1]):
        step = np.eye(4)
        step[:3, :3] = rotation_from_quaternion(*unit(rng.standard_normal(4)))
        step[:3, 3] = rng.uniform(-1, 1, 3)
        rest = np.linalg.inv(step) @ rest
        if backwards:
            add(tree, child, parent, np.linalg.inv(step))
        else:
            add(tree, parent, child, step)
    add(tree, names[-2], "optical", rest)
    return tree


def unit(values: np.ndarray) -> tuple[float, float, float, float]:
    x, y, z, w = (float(value) for value in values / np.linalg.norm(values))
    return x, y, z, w


@settings(max_examples=200)
@given(mounts)
def test_a_mount_that_was_read_once_stays_the_same_bit_by_bit(mount: Mount) -> None:
    def through_transforms(mount: Mount) -> Mount:
        camera = replace(CAMERA, mount=mount)
        tree = FrameTree()
        add(tree, "base", "optical", base_from_optical(mount, camera.level_from_camera))
        return mount_of(tree, "base", "optical")

    once = through_transforms(mount)
    np.testing.assert_allclose(astuple(once)[:-1], astuple(mount)[:-1], rtol=0, atol=1e-9)  # all but the sigma
    assert astuple(through_transforms(once)) == astuple(once)


@settings(max_examples=200)
@given(st.tuples(*[st.floats(-1, 1)] * 4).filter(lambda values: np.linalg.norm(values) > 0.1))
def test_quaternions_and_rotations_are_inverse(values: tuple[float, ...]) -> None:
    quaternion = np.array(unit(np.array(values)))
    found = np.array(quaternion_from_rotation(rotation_from_quaternion(*quaternion)))
    assert min(np.abs(found - quaternion).max(), np.abs(found + quaternion).max()) < 1e-9


def test_height_is_above_the_footprint_where_there_is_one(tmp_path: Path) -> None:
    def record(recorder: Recorder) -> None:
        recorder.transform("base_footprint", "base_link", (0.5, 0.0, 0.2))
        recorder.transform("base_link", "/mast", (0.0, 0.05, 0.4))
        recorder.transform("mast", "/optical", (-0.1, 0.0, 0.1), OPTICAL)

    mount = read(tmp_path / "bag", record).camera.mount
    assert (mount.height_m, mount.right_m, mount.back_m) == pytest.approx((0.7, -0.05, 0.1))
    assert (mount.tilt_rad, mount.roll_rad, mount.yaw_rad) == (0.0, 0.0, 0.0)


@pytest.mark.parametrize("prefix", ["robot1/", "/robot1/", "site/robot1/", "robot1_"])
@pytest.mark.parametrize("own", [True, False], ids=["its own floor", "one floor for all"])
def test_the_floor_of_a_robot_whose_frames_have_a_prefix(tmp_path: Path, prefix: str, own: bool) -> None:
    def record(recorder: Recorder) -> None:
        recorder.transform("robot2/base_footprint", "robot2/base_link", (0.0, 0.0, 0.9))
        recorder.transform(
            f"{prefix}base_footprint" if own else "base_footprint", f"{prefix}base_link", (0.5, 0.0, 0.2)
        )
        recorder.transform(f"{prefix}base_link", "optical", (0.0, 0.0, 0.5), OPTICAL)

    assert read(tmp_path / "bag", record, base=f"{prefix}base_link").camera.mount.height_m == pytest.approx(0.7)


@pytest.mark.parametrize(
    ("transforms", "problem"),
    [
        ([], r"expected transforms from 'base_link' to 'optical', found no frame at all.*--camera FILE"),
        ([("base_link", "mast", (0, 0, 1))], "found base_link, mast"),
        ([("base_link", "optical", (0, 0, -1), OPTICAL)], "above the floor, found it -1.000 m high"),
        ([("base_link", "optical", (0, 0, 1), (0, 0, 0, 0.5))], "expected a quaternion of length 1, found length 0.5"),
        ([("base_link", "optical", (np.nan, 0, 1), OPTICAL)], "expected 'optical' within 100 m of 'base_link'"),
        ([("base_link", "optical", (0, 0, 1), (0, 1, 0, 0))], "does not look straight up or down"),
    ],
)
def test_mounts_that_cannot_be(tmp_path: Path, transforms: list[tuple[object, ...]], problem: str) -> None:
    def record(recorder: Recorder) -> None:
        for transform in transforms:
            recorder.transform(*transform)  # type: ignore[arg-type]

    with pytest.raises(InputError, match=problem):
        read(tmp_path / "bag", record)


def read(path: Path, record: object, base: str = "base_link") -> object:
    """Return the log of a bag whose transforms are what `record` writes."""
    with recording(path) as recorder:
        recorder.info()
        record(recorder)  # type: ignore[operator]
        recorder.steps(base=base)
    return open_log(path)


def test_a_camera_that_is_hardly_above_the_floor_is_refused() -> None:
    """Its height would be rounded to nothing."""
    mount = replace(CAMERA.mount, height_m=1e-12)
    tree = FrameTree()
    add(tree, "base", "optical", base_from_optical(mount, CAMERA.level_from_camera))
    with pytest.raises(ValueError, match="above the floor"):
        mount_of(tree, "base", "optical")


IMAGES = 300
READ = """
import sys
from pathlib import Path
from localiser.errors import InputError
from localiser.storage import open_log
import localiser.storage.bags.read, rosbags.rosbag2
from localiser.storage.bags import typestore
typestore(ros1=False)
begin()
try:
    frames = open_log(Path(sys.argv[1])).frames
    print(len(frames), frames[-1].mount and round(frames[-1].mount.height_m, 3))
except InputError as error:
    print(error)
"""


def write(path: Path, messages: list[bytes], *, moves: bool, topic: str = "/other/tf_static") -> Path:
    """Write a bag of a camera on a robot, after messages of other transforms."""
    with recording(path) as to:
        to.info()
        to.transform("base_link", "head" if moves else "optical", (0.0, 0.0, 0.7), (0.0, 0.0, 0.0, 1.0))
        send = to.writer.add_connection(topic, RosType.TRANSFORMS, typestore=to.store)
        for content in messages:
            to.writer.write(send, 0, content)
        fill(to, moves=moves)
    return path


def fill(to: Recorder, *, moves: bool) -> None:
    if not moves:
        to.mount()
    for step in range(IMAGES):
        t_ns = step * 10**7
        to.odometry(t_ns, 0.001 * step)
        to.image(t_ns)
        if moves:
            to.transform("head", "optical", (0.0, 0.0, 0.0), OPTICAL, "/tf", t_ns)


def row(count: int, at_once: int) -> list[bytes]:
    """Return messages of `at_once` transforms each, of frames in one row."""
    names = ["base_link", *(f"frame_{number}" for number in range(count))]
    links = list(pairwise(names))
    return [bombs.transforms(MAKE, links[first : first + at_once]) for first in range(0, count, at_once)]


@pytest.mark.parametrize(
    ("topic", "at_once", "told"),
    [("/other/tf_static", 15_000, "at most 1048576 bytes"), ("/other/tf", 1000, "fewer than 10000")],
)
def test_too_many_frames_are_told(tmp_path: Path, topic: str, at_once: int, told: str) -> None:
    said = bounded(READ, write(tmp_path / "bag", row(15_000, at_once), moves=False, topic=topic))
    assert told in said and topic in said


@pytest.mark.parametrize("moves", [False, True])
def test_many_frames_cost_little(tmp_path: Path, moves: bool) -> None:
    said = bounded(READ, write(tmp_path / "bag", row(9000, 1000), moves=moves))
    assert said == f"{IMAGES} {0.7 if moves else None}\n"


def test_names_without_end_are_told(tmp_path: Path) -> None:
    long = [bombs.transforms(MAKE, [("base_link", "x" * 257)])]
    assert "names of frames of at most 256 characters, found 257" in bounded(
        READ, write(tmp_path / "bag", long, moves=False)
    )


def joined(tree: FrameTree, links: list[tuple[str, str]]) -> None:
    content = bombs.transforms(MAKE, links)
    tree.add_all(MAKE.store.deserialize_cdr(content, RosType.TRANSFORMS).transforms)


def test_a_chain_is_no_longer_than_robots_have() -> None:
    names = [str(number) for number in range(MOST_STEPS + 2)]
    tree = FrameTree()
    joined(tree, list(pairwise(names)))
    assert tree.chain(names[0], names[-2]) == list(pairwise(names))[:-1]
    assert tree.chain(names[0], names[-1]) is None


def test_a_chain_is_found_anew_when_frames_are_added() -> None:
    tree = FrameTree()
    for names in (("a", "b"), ("c", "d")):
        joined(tree, [names])
        assert tree.chain("a", "d") is None
    joined(tree, [("b", "c")])
    assert tree.chain("a", "d") == [("a", "b"), ("b", "c"), ("c", "d")]
