"""Transforms of more frames than any robot has: told as an error, or read within the limits of memory and time."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import attack_bombs as bombs
import pytest
from bounded import bounded
from small_bag import OPTICAL, Recorder, recording

from localiser.storage.bags import Messages, RosType
from localiser.storage.bags.frames import MOST_STEPS, FrameTree

MAKE = Messages()
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
        to.transform("base_link", "optical", (0.1, 0.0, 0.7), OPTICAL)
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
