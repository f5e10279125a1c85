"""`localiser example` and `localiser demo`: the drive that ships, as files and as a first run."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Annotated

import typer

from localiser.commands.options import Quiet, Seed
from localiser.commands.replay import View, replay
from localiser.errors import LocaliserError, OutputError

EXAMPLE_EPILOG = "Example: `localiser example try-it && cd try-it && localiser replay logs/corridor`"
DEMO_EPILOG = "Example: `localiser demo --view web`"

LOG = Path("logs/corridor")
PARTS = (Path("configs"), LOG, Path("maps/corridor.yaml"))
PACKAGE = Path(__file__).resolve().parents[1]


def example_folder() -> Path:
    """Return the folder with the example's `PARTS`: in an installed package its own, in a clone the clone.

    Raises LocaliserError when there is none.
    """
    for folder in (PACKAGE / "example", PACKAGE.parent):
        if all((folder / part).exists() for part in PARTS):
            return folder
    raise LocaliserError(f"the example drive is not part of this installation, expected in {PACKAGE / 'example'}")


def demo(
    out: Annotated[Path, typer.Option("--out", "-o", metavar="DIR", help="Where results go: DIR/corridor/1, …")] = Path(
        "results"
    ),
    view: Annotated[View, typer.Option(help="Watch the run in Rerun.")] = "none",
    speed: Annotated[
        float | None,
        typer.Option(min=0.01, metavar="X", help="X times as fast as the robot drove; by default as fast as possible."),
    ] = None,
    seed: Seed = None,
    quiet: Quiet = False,
) -> None:
    """Replay the example drive, a simulated robot in a corridor; needs no file of yours."""
    replay(example_folder() / LOG, out=out, view=view, speed=speed, seed=seed, quiet=quiet)
    if not quiet:
        run = out / LOG.name / "latest"
        typer.echo(
            f"Next: `localiser view {run}` shows the run image by image; "
            "`localiser example FOLDER` writes the log, its map and more to try."
        )


def example(
    folder: Annotated[Path, typer.Argument(metavar="FOLDER", help="Where the files go; nothing is overwritten.")],
    quiet: Quiet = False,
) -> None:
    """Write the example's log, map, worlds and configurations to FOLDER, where all documented commands work."""
    source = example_folder()
    for part in PARTS:
        if (folder / part).exists():
            raise OutputError(f"{folder / part}: expected nothing there, found a file or a folder")
    for part in PARTS:
        _copy(source / part, folder / part)
    if not quiet:
        typer.echo(
            f"In {folder}: {LOG}, a drive of 41 s with its map; {PARTS[2]}; configs with worlds to simulate. "
            f"Try there: localiser replay {LOG}"
        )


def _copy(source: Path, target: Path) -> None:
    """Copy a file or a folder; what is copied can be written to, whatever the installation's files are like."""
    from localiser.storage import output_errors

    with output_errors(target):
        target.parent.mkdir(parents=True, exist_ok=True)
        if source.is_dir():
            shutil.copytree(source, target, copy_function=shutil.copyfile)
        else:
            shutil.copyfile(source, target)
