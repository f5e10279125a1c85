"""`localiser evaluate`: compare runs with the truth."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from localiser.commands.options import show

EPILOG = """Examples:

`localiser evaluate results/corridor/latest`

`localiser evaluate mine.tum --truth groundtruth.tum`"""


def evaluate(
    runs: Annotated[
        list[Path], typer.Argument(metavar="RUN…", help="Folders that replay wrote, or trajectory files (TUM, CSV).")
    ],
    truth: Annotated[
        Path | None, typer.Option(metavar="FILE", help="True poses (TUM, or CSV t_ns,x,z,heading).")
    ] = None,
) -> None:
    """Compare runs with the truth in one table; of runs that differ by their seed alone, median and worst too."""
    from localiser.evaluate import errors_table
    from localiser.replay import evaluate_run

    figures = {name: evaluate_run(run, truth) for name, run in zip(_names(runs), runs, strict=True)}
    show(errors_table(figures))
    for name, found in figures.items():
        if found.get("complete") is False:
            typer.secho(
                f"{name} ended early: its figures are those of {found['frames']} frames.", fg="yellow", err=True
            )


def _names(runs: list[Path]) -> list[str]:
    """Return short names of the runs, whole paths where short ones would be the same."""
    short = ["/".join(run.parts[-2:]) for run in runs]
    return short if len(set(short)) == len(runs) else [str(run) for run in runs]
