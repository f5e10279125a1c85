"""The whole batch: read the logs, leave out what is done, run the rest, write the tables."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from localiser import __version__
from localiser.batch.choices import Choice
from localiser.batch.contents import Contents, Opening, contents_of, map_id, run_id
from localiser.batch.one_run import Outcome, Task, replayed
from localiser.batch.summary import summary_markdown
from localiser.batch.workers import Workers, each
from localiser.config import Config
from localiser.errors import InputError, RunEndedEarlyError
from localiser.evaluate import flat_figures, is_time
from localiser.storage import (
    CHOICE,
    json_text,
    output_errors,
    read_figures,
    read_map,
    safe_name,
    write_runs_csv,
    write_text,
)

Row = dict[str, Any]
CSV, SUMMARY, ROW = "runs.csv", "table.md", "row.json"
SIGINT_EXIT_CODE = 130
FIRST_FIGURES = (
    "frames", "position_rmse_m", "position_median_m", "position_max_m", "position_end_m", "heading_rmse_deg",
    "odometry_position_rmse_m", "nees_mean", "edges_per_frame", "confidence.sure", "confidence.sure_and_wrong",
    "confidence.found_s", "warnings",
)  # fmt: skip
"""The columns that people read first; the others follow by their names, times last."""


@dataclass(frozen=True, slots=True)
class Batch:
    """What is run: every choice for every log. folder: of all results. report: whether reports are drawn."""

    logs: Sequence[Path]
    choices: Sequence[Choice]
    folder: Path
    opening: Opening = field(default_factory=Opening)
    report: bool = False


@dataclass(frozen=True, slots=True)
class _Run:
    """One combination. about: the first cells of its row. config: None where the log, or it, cannot be read."""

    contents: Contents
    about: Row
    log: Path
    config: Config | None
    error: str | None = None

    @property
    def folder(self) -> str:
        return str(self.about["folder"])


def run_batch(
    batch: Batch, workers: Workers, begun: Callable[[int, int], Callable[[], None]] = lambda done, left: lambda: None
) -> list[Row]:
    """Run every combination that is not done yet, and return a row for each, in the order of logs and choices.

    begun: called with the numbers of runs that are done and left; returns what is called after each run. The rows are
    in `runs.csv` of the folder too, and what they came to in `table.md`; those of an interrupted
    batch as far as it got. A run that fails is a row with its reason, and is tried again by the next batch.

    Raises RunEndedEarlyError, OutputError.
    """
    with output_errors(batch.folder):
        batch.folder.mkdir(parents=True, exist_ok=True)
    own_map = map_id(read_map(batch.opening.map_file)) if batch.opening.map_file else ""
    logs = list(dict.fromkeys(batch.logs))
    with workers.ready():
        contents = _contents(batch, logs)
        runs = [_run_of(batch, log, contents[log], own_map, choice) for log in logs for choice in batch.choices]
        _require_distinct(runs)
        rows = _rows_done(batch.folder, runs)
        tasks = _tasks(batch, runs, rows)
        advance = begun(sum(row["error"] is None for row in rows.values()), len(tasks))
        try:
            for outcome in each(replayed, [(task,) for task in tasks]):
                rows[outcome.number] = _finished(batch.folder, runs[outcome.number], outcome)
                advance()
        except KeyboardInterrupt:
            rows |= _rows_done(batch.folder, runs)  # one may have been written just before
            told = f"stopped after {len(rows)} of {len(runs)} runs; the same command goes on from there"
            raise RunEndedEarlyError(f"{told}. Results in {batch.folder}", SIGINT_EXIT_CODE) from None
        finally:
            _write_tables(batch.folder, rows)
    return [rows[number] for number in sorted(rows)]


def _contents(batch: Batch, logs: Sequence[Path]) -> dict[Path, Contents]:
    opening = _absolute_opening(batch.opening)
    found = each(_contents_at, [(number, log.absolute(), opening) for number, log in enumerate(logs)])
    return {logs[number]: contents for number, contents in found}


def _contents_at(number: int, log: Path, opening: Opening) -> tuple[int, Contents]:
    return number, contents_of(log, opening)


def _run_of(batch: Batch, log: Path, contents: Contents, own_map: str, choice: Choice) -> _Run:
    config, error, identity = None, contents.error, ""
    if error is None:
        try:
            config = choice.config_for(contents.settings)
            identity = run_id(contents, config, batch.opening.start, own_map)
        except InputError as problem:
            error = str(problem)
    about: Row = {
        "log": contents.name,
        "log_path": str(log),
        "log_id": contents.log_id or None,
        "config": None if choice.config is None else str(choice.config),
        **{f"{CHOICE}{name}": value for name, value in choice.settings},
        "seed": choice.seed if config is None else config.seed,
        "version": __version__,
        "folder": f"runs/{safe_name(contents.name)}/{identity}" if identity else None,
        "error": error,
    }
    return _Run(contents, about, log, config, error)


def _require_distinct(runs: Sequence[_Run]) -> None:
    """Raise InputError when two combinations are the same run, which would count twice."""
    seen: dict[str, _Run] = {}
    for run in runs:
        if run.error is None and (first := seen.setdefault(run.folder, run)) is not run:
            one, other = (f"{same.log} ({_told(same.about)})" for same in (first, run))
            raise InputError(f"expected every run once, found the same content and settings twice: {one} and {other}")


def _told(about: Row) -> str:
    chosen = [f"{name.removeprefix(CHOICE)}={value}" for name, value in about.items() if name.startswith(CHOICE)]
    config = [] if about["config"] is None else [str(about["config"])]
    return ", ".join([*config, *chosen, f"seed {about['seed']}"])


def _rows_done(folder: Path, runs: Sequence[_Run]) -> dict[int, Row]:
    """Return the rows of the runs that need no replay, by their numbers."""
    return {number: row for number, run in enumerate(runs) if (row := _done(folder, run)) is not None}


def _done(folder: Path, run: _Run) -> Row | None:
    """Return the row of a run that needs no replay: because it is done, or because it cannot be begun."""
    if run.error is not None:
        return run.about
    path = folder / run.folder / ROW
    return _row(run, read_figures(path)) if path.is_file() else None


def _tasks(batch: Batch, runs: Sequence[_Run], done: dict[int, Row]) -> list[Task]:
    """Return what is to be run, long logs first, so that no worker is left alone with one at the end."""
    opening = _absolute_opening(batch.opening)
    waiting = [number for number in range(len(runs)) if number not in done]
    waiting.sort(key=lambda number: -runs[number].contents.frames)
    return [
        Task(number, run.log.absolute(), opening, run.config, (batch.folder / run.folder).absolute(), batch.report)
        for number in waiting
        if (run := runs[number]).config is not None
    ]


def _finished(folder: Path, run: _Run, outcome: Outcome) -> Row:
    """Keep the figures of a run that is complete, and return its row."""
    if outcome.metrics is None:
        return run.about | {"error": outcome.error}
    write_text(folder / run.folder / ROW, json_text(flat_figures(outcome.metrics)))
    return _row(run, read_figures(folder / run.folder / ROW))


def _row(run: _Run, figures: Row) -> Row:
    """Return the row of a run that is complete, with its columns in the order of the tables."""
    first = [name for name in FIRST_FIGURES if name in figures]
    others = sorted(figures.keys() - set(first) - run.about.keys(), key=lambda name: (is_time(name), name))
    return run.about | {name: figures[name] for name in [*first, *others]}


def _write_tables(folder: Path, rows: dict[int, Row]) -> None:
    ordered = [rows[number] for number in sorted(rows)]
    if ordered:
        write_runs_csv(folder / CSV, ordered)
        write_text(folder / SUMMARY, summary_markdown(ordered))


def _absolute_opening(opening: Opening) -> Opening:
    files = {name: path.absolute() for name in ("map_file", "camera") if (path := getattr(opening, name)) is not None}
    return replace(opening, **files)
