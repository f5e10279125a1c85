"""The web view of a live run, in a real browser: that the page gets particles and images, and shows them."""

from __future__ import annotations

import re
import sys
import time
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import lz4.block
import numpy as np
import pyarrow as pa
import pytest
from browser import CHROMIUM, page
from live_processes import SETTINGS, program
from short_log import CORRIDOR

from localiser.storage import ImageEvent, open_log
from localiser.view import palette, paths

pytest.importorskip("zenoh", reason="eclipse-zenoh is not installed")
pytestmark = [
    pytest.mark.debian,
    pytest.mark.slow,  # quick: test_view.py holds that a live view gets what a recording does
    pytest.mark.skipif(CHROMIUM is None, reason="needs Debian's package chromium: apt-get install chromium"),
    pytest.mark.skipif(sys.platform != "linux", reason="processes as Linux has them"),
]

PATIENCE_S = 180.0  # a browser that draws by software, on a machine that is busy
FRAMES = 5
PARTICLES = 500


def test_the_page_gets_particles_and_images_and_shows_them(tmp_path: Path) -> None:
    with program("live", "demo", CORRIDOR, "--view", "web", *SETTINGS) as live:
        live.wait_to_say("Watch at")
        (address,) = re.findall(r"Watch at (\S+)", "".join(live.said))
        with page(address, tmp_path) as browser:
            end = time.monotonic() + PATIENCE_S
            while time.monotonic() < end and bytes(browser.fetched).count(paths.PARTICLES.encode()) < FRAMES:
                browser.watch(1.0)
            while time.monotonic() < end and not is_shown(screen := browser.screenshot()):
                browser.watch(1.0)
            assert is_shown(screen), "a page without the robot, its landmarks and its image"
            rows = logged(bytes(browser.fetched))
        assert live.end() == 0

    taken = {frame.encoded() for frame in open_log(CORRIDOR).frames if isinstance(frame, ImageEvent)}
    images = [bytes(row[0]) for row in rows[f"/{paths.IMAGE}"]["EncodedImage:blob"]]
    assert len(images) >= FRAMES and set(images) <= taken, "byte for byte those of the log"
    clouds = [np.array(row) for row in rows[f"/{paths.PARTICLES}"]["Points3D:positions"]]
    assert len(clouds) >= FRAMES and {cloud.shape for cloud in clouds[1:]} == {(PARTICLES, 3)}
    assert all(np.isfinite(cloud).all() for cloud in clouds)


def is_shown(screen: np.ndarray) -> bool:
    """Whether there are pixels of the estimate, of landmarks that are matched, and as many colours as a photo has."""
    trail, landmarks = (
        (np.abs(screen.astype(int) - colour[2::-1]).max(axis=-1) < 12).sum()
        for colour in (palette.ESTIMATE, palette.MATCHED)
    )
    half = screen[:, screen.shape[1] // 2 :].reshape(-1, 3)
    return bool(trail > 20 and landmarks > 100 and len(np.unique(half // 8, axis=0)) > 300)


# -- what a viewer of Rerun receives: messages of gRPC, each with a compressed batch of Arrow in it -------------------

_BATCH = re.compile(rb"\x10\x02\x18([\x80-\xff]*[\x00-\x7f])\x20\x01\x2a([\x80-\xff]*[\x00-\x7f])")
"""ArrowMsg of Rerun: compression = LZ4, uncompressed size, encoding = Arrow, then the batch's length."""


def logged(stream: bytes) -> dict[str, dict[str, list[Any]]]:
    """Return the rows of every column of every entity in a stream: {entity: {column: rows}}."""
    rows: dict[str, dict[str, list[Any]]] = defaultdict(lambda: defaultdict(list))
    for batch in _batches(stream):
        entity = (batch.schema.metadata or {}).get(b"rerun:entity_path", b"").decode()
        for name, column in zip(batch.schema.names, batch.columns, strict=True):
            rows[entity][name] += [row for row in column.to_pylist() if row is not None]
    return rows


def _batches(stream: bytes) -> Iterator[pa.RecordBatch]:
    for found in _BATCH.finditer(stream):
        size, length = _varint(found[1]), _varint(found[2])
        packed = stream[found.end() : found.end() + length]
        if len(packed) == length:  # else it is still on its way
            try:
                batch = lz4.block.decompress(packed, uncompressed_size=size)
            except lz4.block.LZ4BlockError:  # bytes of the program that only look like a message
                continue
            yield from pa.ipc.open_stream(batch)


def _varint(content: bytes) -> int:
    return sum((byte & 0x7F) << 7 * place for place, byte in enumerate(content))
