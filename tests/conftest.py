"""Fixtures shared by all tests."""

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # workers take all processors: more threads would wait

import subprocess
import sys
from contextlib import suppress
from functools import cache
from pathlib import Path

import pytest
import typer.main
from folders import ROOT
from hypothesis import settings
from short_log import Localiser

from localiser.geometry import compiled

compiled.folder()  # chosen before any test changes the environment: machine code is shared by all tests

# Tests start many processes: without bytecode each of them, and pytest itself, reads all sources anew.
sys.dont_write_bytecode = False
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)

# The program reads its commands once a process; tests call it many times in one, and reading them takes 0.05 s.
typer.main.get_command = cache(typer.main.get_command)

WORKER_END_S = 1
"""What workers are given to end after Ctrl-C; the default is 10 s."""


def pytest_xdist_auto_num_workers() -> int:
    """Return how many processes run tests: one more than processors, because tests that wait leave one idle."""
    usable = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return usable + 1


# The same examples in every run; `LOCALISER_EXAMPLES=1000 pytest …` takes that many new ones. Without deadlines: how
# long an example takes depends on what else the machine does.
asked = int(os.environ.get("LOCALISER_EXAMPLES", "0"))
settings.register_profile("localiser", max_examples=asked or 100, derandomize=not asked, deadline=None)
settings.load_profile("localiser")


def pytest_sessionstart(session: pytest.Session) -> None:
    """Compile loops once, before there are workers, who would all compile the same."""
    options = session.config.option
    if (
        getattr(options, "numprocesses", None)
        and not options.collectonly
        and not hasattr(session.config, "workerinput")
    ):
        for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):  # a worker has one core: more threads only wait
            os.environ.setdefault(name, "1")
        path = os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])
        command = [sys.executable, ROOT / "tests" / "support" / "warm_up.py"]
        subprocess.run(command, env={**os.environ, "PYTHONPATH": path}, check=True)


def pytest_keyboard_interrupt() -> None:
    """Do not wait for workers that are inside of a long computation: Ctrl-C ends everything at once."""
    with suppress(ImportError):
        from xdist.workermanage import NodeManager

        NodeManager.EXIT_TIMEOUT = WORKER_END_S


@pytest.fixture(scope="session")
def data_dir() -> Path:
    """Return the folder of development data, or skip: it is not part of the project (licences)."""
    folder = Path(os.environ.get("LOCALISER_DATA", ROOT.parent / "shared" / "data"))
    if not folder.is_dir():
        pytest.skip(f"development data not found in {folder}; set LOCALISER_DATA")
    return folder


@pytest.fixture
def localiser(capsys: pytest.CaptureFixture[str]) -> Localiser:
    """Return the program, run inside this process."""
    return Localiser(capsys)
