"""Where tasks run: in processes of this computer, or on a Dask cluster, by the same calls of joblib."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from typing import TypeVar

from localiser.errors import InputError, LocaliserError

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


def each(function: Callable[..., Result], tasks: Iterable[tuple[object, ...]]) -> Iterator[Result]:
    """Yield what the function returns for each task, as they are done. To be called while workers are ready."""
    from joblib import Parallel, delayed

    # One task at a time: they take seconds, and the last ones should not queue behind each other.
    parallel = Parallel(batch_size=1, return_as="generator_unordered")
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
