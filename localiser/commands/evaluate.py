"""`localiser evaluate`: what runs know of themselves, and their errors against the truth."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated

import typer

from localiser.commands.options import show, warn
from localiser.errors import InputError

EPILOG = """Examples:

`localiser evaluate results/corridor/latest`

`localiser evaluate mine.tum --truth groundtruth.tum`

`localiser evaluate results/corridor/* --csv > figures.csv`"""


def evaluate(
    runs: Annotated[
        list[Path], typer.Argument(metavar="RUN…", help="Folders that replay wrote, or trajectory files (TUM, CSV).")
    ],
    truth: Annotated[
        Path | None, typer.Option(metavar="FILE", help="True poses (TUM, or CSV t_ns,x,z,heading).")
    ] = None,
    align: Annotated[
        str | None, typer.Option(metavar="origin|se2", help="Move the truth onto a run: by the first pose, or by all.")
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print all figures as JSON, by run, and no table.")] = False,
    as_csv: Annotated[bool, typer.Option("--csv", help="Print all figures as CSV, a row a run, and no table.")] = False,
) -> None:
    """Show what runs know of themselves and, where the truth is known, their errors.

    The same run counts once. `localiser batch` has the median and the worst over seeds.
    """
    from localiser.evaluate import flat_figures, run_tables
    from localiser.replay import evaluate_run
    from localiser.storage import csv_text, json_text

    if as_json and as_csv:
        raise InputError("expected --json or --csv, found both", field="--csv")
    runs = list({os.path.realpath(run): run for run in reversed(runs)}.values())[::-1]  # `latest` is one of the others
    short = ["/".join(run.parts[-2:]) for run in runs]
    names = short if len(set(short)) == len(runs) else map(str, runs)
    figures = {name: evaluate_run(run, truth, align) for name, run in zip(names, runs, strict=True)}
    if as_json:
        typer.echo(json_text(figures), nl=False)
    elif as_csv:
        typer.echo(csv_text([{"run": name} | flat_figures(found) for name, found in figures.items()]), nl=False)
    else:
        for part in run_tables(figures):
            show(part)
    if align and not (as_json or as_csv):
        typer.echo(f"Aligned: the truth was moved and turned onto each run, by {align}.")
    for name, found in figures.items():
        if found.get("complete") is False:
            warn(f"{name} ended early: its figures are those of {found.get('frames')} frames.")
