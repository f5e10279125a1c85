"""A few kills of each kind of work; 200 of each are a benchmark."""

from __future__ import annotations

import random
import sys
from pathlib import Path

import attack_samples
import power_cuts
import pytest

pytestmark = [
    pytest.mark.slow,  # the same promises, one by one: test_output.py, test_record.py, test_run.py of batch
    pytest.mark.skipif(sys.platform != "linux", reason="processes that are forked and killed"),
]
NAMES = ("recording", "saved state", "map", "convert to a folder", "convert to a bag", "batch")


@pytest.fixture(scope="module")
def works(tmp_path_factory: pytest.TempPathFactory) -> power_cuts.Works:
    return power_cuts.Works(attack_samples.make(tmp_path_factory.mktemp("power") / "samples"))


@pytest.mark.parametrize("name", NAMES)
def test_what_is_killed_leaves_whole_files(works: power_cuts.Works, tmp_path: Path, name: str) -> None:
    assert set(NAMES) == set(works.by_name)
    assert power_cuts.attacked(name, works.by_name[name], tmp_path, 4, random.Random(1)) == []
