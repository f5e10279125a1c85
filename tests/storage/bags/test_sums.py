"""Small bags that ask for much in sum: refused, in little time and memory, as whoever starts the program measures."""

from __future__ import annotations

import os
import resource
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from swelling_bags import SWELLING, clean, one_large_image

from localiser.storage import ImageEvent, open_log

MORE_S, MORE_MB = 2.0, 300.0  # than for a bag that is as it should be
READ = """
import sys
from pathlib import Path
from localiser.errors import InputError
from localiser.storage import open_log
try:
    for frame in open_log(Path(sys.argv[1])).frames:
        frame.load()
    print("read")
except InputError as error:
    print(error)
"""


def read_alone(path: Path) -> tuple[str, float, float]:
    """Read a bag in a process of its own; returns what it said, its processor time (s) and its most memory (MB).

    It is ended by the system at 60 s of processor time, and gets no more than 6 GB of memory.
    """

    def limited() -> None:
        resource.setrlimit(resource.RLIMIT_CPU, (60, 60))
        resource.setrlimit(resource.RLIMIT_AS, (6 * 2**30, 6 * 2**30))

    with subprocess.Popen(
        [sys.executable, "-c", READ, path],
        stdout=subprocess.PIPE,
        text=True,
        preexec_fn=limited,  # noqa: PLW1509 - there are no threads
    ) as process:
        assert process.stdout is not None
        said = process.stdout.read().strip()
        _, status, used = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
    assert process.returncode == 0, f"ended by {signal.Signals(-process.returncode).name}"
    return said, used.ru_utime + used.ru_stime, used.ru_maxrss / 1024


@pytest.fixture(scope="module")
def usual(tmp_path_factory: pytest.TempPathFactory) -> tuple[float, float]:
    """Return processor time (s) and memory (MB) for a small bag that is as it should be."""
    said, seconds, memory_mb = read_alone(clean(tmp_path_factory.mktemp("clean") / "bag"))
    assert said == "read"
    return seconds, memory_mb


@pytest.mark.skipif(sys.platform != "linux", reason="limits of Linux")
@pytest.mark.parametrize("harm", SWELLING)
def test_a_small_bag_takes_little(tmp_path: Path, usual: tuple[float, float], harm: str) -> None:
    said, seconds, memory_mb = read_alone(SWELLING[harm](tmp_path / "bag"))
    assert "expected" in said or "cannot be read as a value" in said, said
    assert seconds < usual[0] + MORE_S and memory_mb < usual[1] + MORE_MB


def test_one_large_image_is_read_however_small_it_is_compressed(tmp_path: Path) -> None:
    (frame,) = open_log(one_large_image(tmp_path / "bag")).frames
    assert isinstance(frame, ImageEvent) and frame.load().shape == (3000, 4000)
