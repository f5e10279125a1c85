"""`localiser view`: look at a recorded run."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from localiser.errors import InputError, LocaliserError

EPILOG = """Examples:

`localiser view results/corridor/latest`

`localiser view results/corridor/1 --web`

`localiser view corridor.rrd`"""
RECORDING, MAGIC = "run.rrd", b"RRF2"


def view(
    run: Annotated[Path, typer.Argument(metavar="RUN", help="Folder of a run, of a log's runs (its latest), or .rrd.")],
    web: Annotated[bool, typer.Option("--web", help="Serve a page for the browser, until Ctrl-C.")] = False,
) -> None:
    """Open a recorded run in Rerun's viewer."""
    from localiser.view import RecordingViewer

    viewer = RecordingViewer(recording_of(run), "web" if web else "native")
    if viewer.address:
        typer.echo(f"Watch at {viewer.address}, until Ctrl-C.")
    if not viewer.wait():
        raise LocaliserError("the viewer could not start (is there a display?); --web shows the run in a browser")


def recording_of(run: Path) -> Path:
    """Return the recording of a run given as `localiser view` takes it. Raises InputError."""
    from localiser.storage import find_run

    recording = run if run.is_file() and run.suffix == ".rrd" else find_run(run) / RECORDING
    if not recording.is_file():
        raise InputError(f"expected a recording, {RECORDING}; `replay --no-rrd` writes none", path=recording.parent)
    with recording.open("rb") as file:
        if (begin := file.read(len(MAGIC))) != MAGIC:
            raise InputError(f"expected a recording, which begins with {MAGIC!r}, found {begin!r}", path=recording)
    return recording
