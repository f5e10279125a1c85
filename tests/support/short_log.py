"""The first frames of the log that ships, and the command line in this process, for end-to-end tests."""

import shutil
import sys
from collections.abc import Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from unittest.mock import patch

import pytest

from localiser.commands import main
from localiser.config import read_config
from localiser.edges import Edges, find_edges
from localiser.storage import ImageEvent, Log, open_log

CORRIDOR = Path(__file__).resolve().parents[2] / "logs" / "corridor"
FRAMES = 12
FEW_PARTICLES = ("--set", "mcl.particles=300", "--set", "mcl.start_particles=1000")


@cache
def corridor_with_edges() -> tuple[Log, dict[int, Edges]]:
    """Return the log that ships, and the edges of its images by their times; found once a process."""
    log = open_log(CORRIDOR)
    parameters = read_config(None, (), log.settings).edges
    frames = (frame for frame in log.frames if isinstance(frame, ImageEvent))
    return log, {frame.t_ns: find_edges(frame.load(), log.camera, parameters) for frame in frames}


def cut_log(source: Path, folder: Path, frames: int) -> Path:
    """Copy the first `frames` images of a log folder, and everything else of it, to `folder`, which is returned."""
    folder.mkdir()
    for file in source.iterdir():
        if file.is_file():
            shutil.copy(file, folder)
    rows = (source / "images.csv").read_text().splitlines()[: frames + 1]
    (folder / "images.csv").write_text("\n".join(rows) + "\n")
    for row in rows[1:]:
        name = row.split(",")[1]
        (folder / name).parent.mkdir(exist_ok=True)
        shutil.copy(source / name, folder / name)
    return folder


@dataclass(frozen=True, slots=True)
class Result:
    """How a command ended, and what it said."""

    exit_code: int
    out: str
    err: str


@dataclass(frozen=True, slots=True)
class Localiser:
    """The command line, called in this process as a shell would call it."""

    capsys: pytest.CaptureFixture[str]

    def __call__(self, *arguments: object) -> Result:
        code: Sequence[object] | object = 0
        self.capsys.readouterr()
        with patch.object(sys, "argv", ["localiser", *map(str, arguments)]):
            try:
                main()
            except SystemExit as end:
                code = end.code
        out, err = self.capsys.readouterr()
        return Result(code if isinstance(code, int) else int(code is not None), out, err)

    def replay(
        self, log: Path, out: Path, *arguments: object, rrd: bool = False, report: bool = False, few: bool = True
    ) -> Path:
        """Replay, which must succeed, and return the folder of the run.

        report: draw report.png, which takes as long as a dozen images. few: with a few particles, which is enough for
        all but the figures, unless a configuration is given.
        """
        settings = FEW_PARTICLES if few and "--config" not in arguments else ()
        recorded = "--rrd" if rrd else "--no-rrd"
        with nullcontext() if report else patch("localiser.replay.folder.write_report"):
            result = self("replay", log, "--out", out, "--quiet", recorded, *settings, *arguments)
        assert (result.exit_code, result.err) == (0, ""), result.err
        (name,) = {folder.name for folder in out.iterdir()}
        return (out / name / "latest").resolve()
