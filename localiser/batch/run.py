"""Run a batch: every combination of log and choice once, in processes of this computer or on a Dask cluster."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, TypeVar

from localiser import __version__
from localiser.batch.choices import Choice, Contents, Opening, contents_of, map_id, run_id
from localiser.batch.compare import CSV
from localiser.config import Config
from localiser.errors import InputError, LocaliserError, RunEndedEarlyError
from localiser.evaluate import flat_figures
from localiser.replay import FolderRun, Outputs, prepare
from localiser.storage import (
    CHOICE,
    RunFolder,
    csv_text,
    json_text,
    output_errors,
    read_figures,
    read_map,
    safe_name,
    write_text,
)

# -- one run ----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Task:
    """What is replayed into which folder. Paths are absolute: a worker may have another working directory."""

    number: int
    log: Path
    opening: Opening
    config: Config
    folder: Path


@dataclass(frozen=True, slots=True)
class Outcome:
    """The metrics of a task, or why there are none. number: of the task. stopped: whether by a signal."""

    number: int
    metrics: dict[str, Any] | None = None
    error: str | None = None
    stopped: bool = False


def replay_task(task: Task) -> Outcome:
    """Replay, and return the metrics or the reason why not: a task that fails leaves the others alone."""
    import cv2
    import numba

    try:
        # As many runs as cores go on at once: more threads would only wait for each other.
        cv2.setNumThreads(1)
        numba.set_num_threads(1)
        opening, folder = task.opening, task.folder
        log = opening.open(task.log, task.config)
        run = prepare(log, task.config, opening.start, map_files=[opening.map_file] if opening.map_file else ())
        run.localiser.warm_up(images=log.has_images)
        with output_errors(folder):
            folder.mkdir(parents=True, exist_ok=True)
        outputs = Outputs(folder.parent, rrd=False, report=False)
        return Outcome(task.number, FolderRun.open(run, outputs, RunFolder(folder)).run(lambda: None))
    except LocaliserError as error:
        return Outcome(task.number, error=str(error), stopped=error.exit_code > 128)
    except Exception as error:
        return Outcome(task.number, error=f"{type(error).__name__}: {error}")


# -- where runs are done ----------------------------------------------------------------------------------------------

Result = TypeVar("Result")


_KILLED = "a worker of the batch was killed, perhaps because memory ran out"


class WorkersError(LocaliserError):
    """Workers that cannot be reached, or that ended."""


@dataclass(frozen=True, slots=True)
class Workers:
    """jobs: processes; None for one a core. cluster: the address of a Dask scheduler, in place of processes."""

    jobs: int | None = None
    cluster: str | None = None

    def ready(self) -> AbstractContextManager[None]:
        """Have the workers at hand. Raises InputError, or WorkersError also when one of them is killed."""
        return _processes(self.jobs) if self.cluster is None else _dask(self.cluster)


def each(
    function: Callable[..., Result], tasks: Iterable[tuple[object, ...]], *, in_order: bool = False
) -> Iterator[Result]:
    """Yield what the function returns for each task, in order or as they are done, while workers are ready."""
    from joblib import Parallel, delayed

    # One task at a time: they take seconds, and the last ones should not queue behind each other.
    parallel = Parallel(batch_size=1, return_as="generator" if in_order else "generator_unordered")
    yield from parallel(delayed(function)(*task) for task in tasks)


@contextmanager
def _processes(jobs: int | None) -> Iterator[None]:
    from joblib import parallel_config
    from joblib.externals.loky.process_executor import BrokenProcessPool

    with parallel_config(backend="loky", n_jobs=jobs or -1, inner_max_num_threads=1):
        try:
            yield
        except BrokenProcessPool:
            raise WorkersError(f"{_KILLED} (fewer --jobs need less); the same command goes on from there") from None


@contextmanager
def _dask(address: str) -> Iterator[None]:
    try:
        from distributed import Client, KilledWorker
    except ImportError:
        raise InputError(
            "a Dask cluster needs the package distributed; pip install '.[dask]' in a clone", field="--cluster"
        ) from None
    from joblib import parallel_config

    try:
        client = Client(address, timeout=10)
    except (OSError, TimeoutError, ValueError) as error:
        raise WorkersError(f"--cluster: no Dask scheduler can be reached at {address}: {error}") from None
    with client, parallel_config(backend="dask"):
        try:
            yield
        except KilledWorker:
            raise WorkersError(f"{_KILLED}; the same command goes on from there") from None


# -- the batch --------------------------------------------------------------------------------------------------------

Row = dict[str, Any]
ROW = "row.json"
SIGINT_EXIT_CODE = 130


@dataclass(frozen=True, slots=True)
class Batch:
    """What is run: every choice for every log. folder: of all results."""

    logs: Sequence[Path]
    choices: Sequence[Choice]
    folder: Path
    opening: Opening = field(default_factory=Opening)


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
    in `runs.csv` of the folder too; those of an interrupted batch as far as it got. A run that fails is a row with its
    reason, and is tried again by the next batch.

    Raises RunEndedEarlyError, OutputError.
    """
    with output_errors(batch.folder):
        batch.folder.mkdir(parents=True, exist_ok=True)
    own_map = map_id(read_map(batch.opening.map_file)) if batch.opening.map_file else ""
    logs = list(dict.fromkeys(batch.logs))
    with workers.ready():
        files = {name: getattr(batch.opening, name) for name in ("map_file", "camera")}
        opening = replace(batch.opening, **{name: path and path.absolute() for name, path in files.items()})
        read = each(contents_of, [(log.absolute(), opening) for log in logs], in_order=True)
        contents = dict(zip(logs, read, strict=True))
        runs = [_run_of(batch, log, contents[log], own_map, choice) for log in logs for choice in batch.choices]
        distinct: dict[str, _Run] = {}
        for run in runs:  # else it would count twice
            if run.error is None and (first := distinct.setdefault(run.folder, run)) is not run:
                one, other = (f"{same.log} ({_choices_text(same.about)})" for same in (first, run))
                problem = f"expected every run once, found the same content and settings twice: {one} and {other}"
                raise InputError(problem)
        rows = _rows_done(batch.folder, runs)
        # Long logs first, so that no worker is left alone with one at the end.
        waiting = sorted((k for k in range(len(runs)) if k not in rows), key=lambda k: -runs[k].contents.frames)
        tasks = [
            Task(number, run.log.absolute(), opening, run.config, (batch.folder / run.folder).absolute())
            for number in waiting
            if (run := runs[number]).config is not None
        ]
        advance = begun(sum(row["error"] is None for row in rows.values()), len(tasks))
        try:
            for outcome in each(replay_task, [(task,) for task in tasks]):
                if outcome.stopped:
                    raise KeyboardInterrupt
                run = runs[outcome.number]
                if outcome.metrics is None:
                    rows[outcome.number] = run.about | {"error": outcome.error}
                else:
                    kept = batch.folder / run.folder / ROW
                    write_text(kept, json_text(flat_figures(outcome.metrics)))
                    rows[outcome.number] = run.about | read_figures(kept)
                advance()
        except KeyboardInterrupt:
            rows |= _rows_done(batch.folder, runs)  # one may have been written just before
            told = f"stopped after {len(rows)} of {len(runs)} runs; the same command goes on from there"
            raise RunEndedEarlyError(f"{told}. Results in {batch.folder}", SIGINT_EXIT_CODE) from None
        finally:
            if ordered := [rows[number] for number in sorted(rows)]:
                write_text(batch.folder / CSV, csv_text(ordered))
    return ordered


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


def _choices_text(about: Row) -> str:
    chosen = [f"{name.removeprefix(CHOICE)}={value}" for name, value in about.items() if name.startswith(CHOICE)]
    config = [] if about["config"] is None else [str(about["config"])]
    return ", ".join([*config, *chosen, f"seed {about['seed']}"])


def _rows_done(folder: Path, runs: Sequence[_Run]) -> dict[int, Row]:
    """Return the rows of the runs that need no replay, by their numbers."""
    rows = {}
    for number, run in enumerate(runs):
        path = folder / run.folder / ROW
        if run.error is not None:  # it cannot be begun
            rows[number] = run.about
        elif path.is_file():
            rows[number] = run.about | read_figures(path)
    return rows
