"""The command `paper`: the founding paper's figures next to ours, in a clone of the project."""

from __future__ import annotations

import sys
from importlib import import_module
from pathlib import Path
from typing import Annotated, Any

import typer

from localiser.commands.options import Quiet, progress, show
from localiser.errors import LocaliserError

EPILOG = """Examples:

`localiser paper`

`localiser paper --places 40 --seed 1 --out paper`"""

CLONE = Path(__file__).resolve().parents[2]
"""The folder beside which the package stands: the repository, where it is a clone of it."""


def paper(
    places: Annotated[
        int,
        typer.Option(min=1, max=10_000, metavar="N", help="Places in the rendered room; each gives 6 pairs of views."),
    ] = 10,
    seed: Annotated[int, typer.Option(min=0, metavar="N", help="Same seed, same tables.")] = 0,
    out: Annotated[
        Path | None,
        typer.Option("--out", "-o", metavar="DIR", help="New folder for the tables (CSV, Markdown) and a figure."),
    ] = None,
    quiet: Quiet = False,
) -> None:
    """Reproduce the founding paper: its tables by our equations, its motions measured from rendered images."""
    from localiser.storage import require_new

    if out is not None:
        require_new(out)
    reproduction = _reproduction()
    with progress("Rendering and measuring", reproduction.steps(places), quiet) as advance:
        reproduced = reproduction.reproduce(places, seed, advance)
    if not quiet:
        for sheet in reproduced.sheets:
            show(sheet.table())
    if out is not None:
        reproduced.write(out)
        if not quiet:
            typer.echo(f"Tables and figure in {out}: paper.md, paper.png, CSV.")


def _reproduction() -> Any:
    """Return the module `paper/reproduce.py`, which stands beside the package. Raises LocaliserError."""
    if not (CLONE / "paper" / "reproduce.py").is_file():
        raise LocaliserError(
            "The paper's reproduction is the folder `paper` of the project's repository, which an installed package "
            "does not hold: clone the repository, `pip install -e .` there, and run `localiser paper` again."
        )
    if str(CLONE) not in sys.path:
        sys.path.append(str(CLONE))
    return import_module("paper.reproduce")
