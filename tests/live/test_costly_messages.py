"""Messages of a neighbour that ask for much memory or time: a live run goes on at its rate, and tells of them."""

from __future__ import annotations

import json

import pytest
from bounded import bounded

PRELUDE = """
import json
import sys
import attack_bombs as bombs
from live_feed import BEGIN_NS, LOG, MAKE, Feed, arrival, camera, drive, image
feed = Feed()
size = LOG.camera.width, LOG.camera.height
"""
END = "print(json.dumps([len(feed.published), feed.said[-30:]]))"


def fed(code: str) -> tuple[int, str]:
    """Run code on a live run; returns how many images were located, and what was said last."""
    located, said = json.loads(bounded(f"{PRELUDE}{code}{END}"))
    return located, " ".join(said)


@pytest.mark.parametrize(
    ("role", "at_once", "before", "expected"),
    [
        ("transforms", 15_000, False, "/tf_static: left out a message: expected at most 262144 bytes"),
        ("transforms", 500, True, "/tf_static: left out a message: expected fewer than 1000 transforms"),
        ("moving_transforms", 15_000, True, "/tf: left out a message: expected at most 262144 bytes"),
        (
            "moving_transforms",
            500,
            False,
            "/tf: left out a message: expected fewer than 1000 transforms",
        ),
    ],
)
def test_many_frames(role: str, at_once: int, before: bool, expected: str) -> None:
    """before: the camera is known; those that are too many leave nothing behind."""
    code = f"""
hostile = [
    arrival({role!r}, 0, bombs.many_frames(MAKE, {at_once}, first, BEGIN_NS)) for first in range(0, 15_000, {at_once})
]
if {before}:
    Feed()([*camera(), *drive(2)])
    begin()
    feed([*hostile, *camera(), *drive(12)])
else:
    feed([*camera(), *drive(2)])
    begin()
    feed([*hostile, *drive(10, first=2)])
"""
    found, said = fed(code)
    assert found == 12 and expected in said
