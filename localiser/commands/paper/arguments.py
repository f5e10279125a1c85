"""The command `paper`: the founding paper's figures beside our own."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from localiser.commands.options import Quiet, progress, show

EPILOG = """Examples:

`localiser paper`

`localiser paper --places 40 --seed 1 --out paper`"""


def paper(
    places: Annotated[
        int,
        typer.Option(min=1, max=10_000, metavar="N", help="Places in the rendered room; each gives 6 pairs of views."),
    ] = 10,
    seed: Annotated[int, typer.Option(min=0, metavar="N", help="Same seed, same tables.")] = 0,
    out: Annotated[
        Path | None, typer.Option(metavar="DIR", help="New folder for the tables (CSV, Markdown) and a figure.")
    ] = None,
    quiet: Quiet = False,
) -> None:
    """Reproduce the founding paper: its tables by our equations, its motions measured from rendered images."""
    from localiser.commands.paper.measured import steps
    from localiser.commands.paper.reproduce import reproduce
    from localiser.storage import require_new

    if out is not None:
        require_new(out)
    with progress("Rendering and measuring", steps(places), quiet) as advance:
        reproduction = reproduce(places, seed, advance)
    if not quiet:
        for sheet in reproduction.sheets:
            show(sheet.table())
    if out is not None:
        reproduction.write(out)
        if not quiet:
            typer.echo(f"Tables and figure in {out}: paper.md, paper.png, CSV.")
