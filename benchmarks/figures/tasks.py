"""Pieces of work, each measuring some figures with one seed, shared out among processes."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path

from figures.program import begin_process, prepare_environment

Values = dict[str, float | str]


@dataclass(frozen=True, slots=True)
class Task:
    """One measurement.

    case: what is measured, such as `house slope`. work: returns the values by the names of the measures, in any
    process. needs: data without which the task is left out.
    """

    group: str
    case: str
    seed: int
    work: Callable[[], Values]
    needs: Path | None = None

    @property
    def name(self) -> str:
        """What tells it from all others."""
        return f"{self.group}/{self.case}/{self.seed}"

    @property
    def missing(self) -> str | None:
        """Why it cannot be done here; None where it can."""
        return None if self.needs is None or self.needs.exists() else f"no data in {self.needs.name} (LOCALISER_DATA)"


def measured(
    tasks: Sequence[Task], jobs: int, partial: Path | None = None, *, afresh: bool = False
) -> Iterator[tuple[Task, Values | Exception]]:
    """Yield each task and its values as they come, or the error that ended it.

    partial: file in which values are kept, and found again. afresh: whether each task has a process of its own.
    """
    known = _read(partial) if partial else {}
    yield from ((task, known[task.name]) for task in tasks if task.name in known)
    left = [task for task in tasks if task.name not in known]
    if not left:
        return
    prepare_environment()
    with ProcessPoolExecutor(
        jobs, mp_context=get_context("spawn"), initializer=begin_process, max_tasks_per_child=1 if afresh else None
    ) as pool:
        waiting = {pool.submit(task.work): task for task in left}
        try:
            for done in as_completed(waiting):
                task, error = waiting[done], done.exception()
                if isinstance(error, BrokenProcessPool) or (error and not isinstance(error, Exception)):
                    raise error
                if partial and not error:
                    keep(partial, task, done.result())
                yield task, error or done.result()
        except BaseException:
            pool.shutdown(cancel_futures=True)
            raise


def _read(path: Path) -> dict[str, Values]:
    if not path.exists():
        return {}
    lines = (line for line in path.read_text(encoding="utf-8").splitlines() if line.endswith("]"))
    return dict(json.loads(line) for line in lines)


def keep(path: Path, task: Task, values: Values) -> None:
    """Append the values of a task to the file of partial results."""
    path.parent.mkdir(parents=True, exist_ok=True)
    begun = path.read_bytes() if path.exists() else b""
    with path.open("a", encoding="utf-8") as file:
        if begun and not begun.endswith(b"\n"):
            file.write("\n")  # the line before was cut off
        file.write(json.dumps([task.name, values]) + "\n")
