"""Fixtures shared by all tests."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from folders import ROOT
from hypothesis import settings
from short_log import Localiser

from localiser.geometry import compiled

compiled.folder()  # chosen before any test changes the environment: machine code is shared by all tests

settings.register_profile("usual", deadline=None)  # how long an example takes depends on what else the machine does
settings.register_profile("thorough", max_examples=1000, deadline=None)  # ten times the default: see `examples`
settings.load_profile("usual")


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
