"""One run of a batch, as a task for a process here or on another computer."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from localiser.batch.contents import Opening
from localiser.config import Config
from localiser.errors import LocaliserError
from localiser.replay import FolderRun, Outputs, prepare
from localiser.storage import RunFolder, output_errors


@dataclass(frozen=True, slots=True)
class Task:
    """What is replayed into which folder. Paths are absolute: a worker may have another working directory."""

    number: int
    log: Path
    opening: Opening
    config: Config
    folder: Path
    report: bool = False


@dataclass(frozen=True, slots=True)
class Outcome:
    """The metrics of a task, or why there are none. number: of the task."""

    number: int
    metrics: dict[str, Any] | None = None
    error: str | None = None


def replayed(task: Task) -> Outcome:
    """Replay, and return the metrics or the reason why not: a task that fails leaves the others alone."""
    try:
        with _one_thread():
            return Outcome(task.number, _metrics(task))
    except LocaliserError as error:
        return Outcome(task.number, error=str(error))
    except Exception as error:
        return Outcome(task.number, error=f"{type(error).__name__}: {error}")


def _metrics(task: Task) -> dict[str, Any]:
    opening, folder = task.opening, task.folder
    log = opening.open(task.log, task.config)
    run = prepare(log, task.config, opening.start, map_file=opening.map_file)
    run.localiser.warm_up(images=log.has_images)
    with output_errors(folder):
        folder.mkdir(parents=True, exist_ok=True)
    outputs = Outputs(folder.parent, rrd=False, report=task.report)
    return FolderRun.open(run, outputs, RunFolder(folder)).run(lambda: None)


@contextmanager
def _one_thread() -> Iterator[None]:
    """Let libraries use one thread: as many runs as cores go on at once, and more would only wait for each other."""
    import cv2
    import numba

    before = cv2.getNumThreads(), numba.get_num_threads()
    cv2.setNumThreads(1)
    numba.set_num_threads(1)
    try:
        yield
    finally:
        cv2.setNumThreads(before[0])
        numba.set_num_threads(before[1])
