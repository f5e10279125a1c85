"""`localiser batch`: replay many logs with many settings and seeds."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import Annotated

import typer

from localiser.commands.options import BagCamera, Topics, is_quiet, progress, show, topics_by_role, warn, working

EPILOG = """Examples:

`localiser batch logs/corridor --seeds 0-4 --set observation.kind=line,slope`

`localiser batch logs/* --seeds 0-2 -o results/new --against results/old`

`localiser batch logs/* --config a.yaml --config b.yaml --cluster tcp://10.0.0.1:8786`"""
LOSS_EXIT_CODE, FAILED_EXIT_CODE = 1, 2


def batch(
    logs: Annotated[list[Path], typer.Argument(metavar="LOG…", help="Log folders, ROS bags, or others; see replay.")],
    map_file: Annotated[
        Path | None, typer.Option("--map", metavar="MAP", help="Landmark map of all; by default each log's own.")
    ] = None,
    configs: Annotated[
        list[Path] | None, typer.Option("--config", metavar="FILE", help="Configuration. May be repeated: each is run.")
    ] = None,
    overrides: Annotated[
        list[str] | None,
        typer.Option(
            "--set", metavar="NAME=A,B", help="A setting, with one value or several: each is run. May be repeated."
        ),
    ] = None,
    seeds: Annotated[str | None, typer.Option(metavar="0-4", help="Seeds, such as 0-4 or 0,3,7-9.")] = None,
    start: Annotated[str | None, typer.Option(metavar="POSE", help="Where all runs start; see replay.")] = None,
    topics: Topics = None,
    camera: BagCamera = None,
    jobs: Annotated[
        int | None, typer.Option(min=1, metavar="N", help="Processes at a time; by default one a core.")
    ] = None,
    cluster: Annotated[
        str | None, typer.Option(metavar="ADDRESS", help="Run on a Dask cluster, whose workers see the same files.")
    ] = None,
    out: Annotated[Path, typer.Option("--out", "-o", metavar="FOLDER", help="Where results go.")] = Path(
        "results/batch"
    ),
    against: Annotated[
        Path | None,
        typer.Option(
            metavar="FOLDER|FILE",
            help="Compare with an earlier batch, in pairs of log and seed; exit code 1 on a significant loss.",
        ),
    ] = None,
) -> None:
    """Replay every LOG with every combination of settings and seeds; runs that are done already are not done again."""
    from localiser.batch import (
        Batch,
        Opening,
        Workers,
        choices_of,
        compare_with,
        comparison_table,
        failures,
        read_table_of,
        run_batch,
        summary_table,
    )

    choices = choices_of(configs or [], overrides or [], seeds)
    others = None if against is None else read_table_of(against)
    opening = Opening(start, map_file, topics_by_role(topics), camera)
    with ExitStack() as shown:
        reading = shown.enter_context(ExitStack())
        reading.enter_context(working("Reading the logs …"))

        def begun(done: int, left: int) -> Callable[[], None]:
            reading.close()
            if done and not is_quiet():
                typer.echo(f"Runs that are done already: {done}; left: {left}.", err=True)
            return shown.enter_context(progress("Replaying", left))

        rows = run_batch(Batch(logs, choices, out, opening), Workers(jobs, cluster), begun)
    failed = failures(rows)
    if not is_quiet():
        show(summary_table(rows))
        typer.echo(f"Results in {out}: runs.csv, and a folder for each run in runs/.")
    for text in failed:
        typer.secho(f"Failed: {text}", fg="red", err=True)
    if others is not None and against is not None:
        verdict = compare_with(rows, others, against)
        if not is_quiet():
            show(comparison_table(verdict))
        for alone, where in ((verdict.alone, "here"), (verdict.alone_there, "there")):
            warn(f"{alone} runs are only {where} and were not compared." if alone else None)
        if verdict.newly_failed:
            typer.secho(f"{len(verdict.newly_failed)} runs failed that did not fail there.", fg="red", err=True)
        if not is_quiet():
            typer.echo(f"{verdict.pairs} pairs: {'a significant loss' if verdict.is_loss else 'no significant loss'}.")
        if verdict.is_loss:
            raise typer.Exit(LOSS_EXIT_CODE)
    if failed:
        raise typer.Exit(FAILED_EXIT_CODE)
