"""`localiser demo`: a first run along the drive that ships, whose files can be kept."""

from __future__ import annotations

import shutil
from contextlib import ExitStack
from pathlib import Path
from typing import Annotated

import typer

from localiser.commands.options import is_quiet
from localiser.commands.replay import View, replay
from localiser.errors import LocaliserError, OutputError

EPILOG = """Examples:

`localiser demo --view web`

`localiser demo --keep try-it && cd try-it && localiser replay logs/corridor`"""

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
    keep: Annotated[
        Path | None,
        typer.Option(
            metavar="FOLDER",
            help="Keep the log, its map, worlds and configurations there, where all documented commands work.",
        ),
    ] = None,
) -> None:
    """Replay the example drive, a simulated robot in a corridor; needs no file of yours."""
    if keep is not None:
        copy_to(keep)
    replay(example_folder() / LOG, out=out, view=view)
    if not is_quiet():
        run = out / LOG.name / "latest"
        files = (
            "--keep FOLDER keeps the log, its map and more to try" if keep is None else f"files to try are in `{keep}`"
        )
        typer.echo(f"Next: `localiser view {run}` shows the run image by image; {files}.")


def copy_to(folder: Path) -> None:
    """Write the example's files to a folder, where they can be changed. Raises OutputError for what is there."""
    from localiser.documents import drafted

    source = example_folder()
    for part in PARTS:
        if (folder / part).exists():
            raise OutputError(f"{folder / part}: expected nothing there, found a file or a folder")
    with ExitStack() as drafts:  # all take their places at the end, or none does
        for part in PARTS:
            draft = drafts.enter_context(drafted(folder / part, is_new=True))
            if (source / part).is_dir():
                shutil.copytree(source / part, draft, copy_function=shutil.copyfile)
            else:
                shutil.copyfile(source / part, draft)
