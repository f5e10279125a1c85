"""The wheel in an environment of its own, used in an empty folder: as somebody has it who never saw a clone."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest
from installed import Installed

pytestmark = pytest.mark.slow  # quick: tests/commands/test_example.py and test_distributions.py hold the parts


@pytest.fixture(scope="module")
def localiser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Installed]:
    folder = tmp_path_factory.mktemp("installed")
    yield Installed(folder)
    shutil.rmtree(folder)  # 1.5 GB, and pytest keeps the folders of three sessions


def test_the_first_quarter_of_an_hour(localiser: Installed, tmp_path: Path) -> None:
    """Demo, live demo, example, and the first command that is documented for it."""
    where = [localiser.bin / "python", "-c", "import localiser; print(localiser.__file__)"]
    package = subprocess.run(
        where, cwd=tmp_path, env=localiser.environment(), capture_output=True, text=True, check=True
    )
    assert package.stdout.startswith(str(localiser.bin.parent))

    said = localiser("demo", cwd=tmp_path)
    assert "Next: `localiser view results/corridor/latest`" in said
    run = tmp_path / "results" / "corridor" / "1"
    assert json.loads((run / "metrics.json").read_text())["position_rmse_m"] < 0.02
    assert {"report.html", "report.png", "run.rrd"} <= {file.name for file in run.iterdir()}

    poses = localiser("live", "demo", "--json", "--seconds", "8", cwd=tmp_path).splitlines()
    assert json.loads(poses[-1])["p_correct"] > 0.9

    localiser("example", ".", cwd=tmp_path)
    tilt = localiser("camera", "tilt", "logs/corridor", cwd=tmp_path)
    assert re.search(r"20\.0", tilt)
