"""What the commands share: options, the progress bar, printing."""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from localiser.errors import InputError

if TYPE_CHECKING:  # both take long to import, and --help needs neither
    from localiser.config import Config
    from localiser.storage import Log

ConfigFile = Annotated[
    Path | None, typer.Option("--config", metavar="FILE", help="Configuration; see `localiser config show`.")
]
Overrides = Annotated[
    list[str] | None,
    typer.Option("--set", metavar="NAME=VALUE", help="Set one value of `localiser config show`. May be repeated."),
]
Seed = Annotated[int | None, typer.Option("--seed", min=0, max=2**32 - 1, metavar="N", help="Same seed, same result.")]
Topics = Annotated[
    list[str] | None,
    typer.Option(
        "--topic",
        metavar="KIND=NAME",
        help="Topic of a ROS bag where several fit: image (image_raw, image_rect), camera_info, odometry, "
        "groundtruth. May be repeated.",
    ),
]
BagCamera = Annotated[
    Path | None,
    typer.Option("--camera", metavar="FILE", help="Camera file, in place of what a ROS bag says of its camera."),
]
LONGEST_WAIT_S = 60.0
NewLog = Annotated[
    Path | None, typer.Option("--out", "-o", metavar="LOG", help="Write the log with what was found to a new folder.")
]
_QUIET = [False]


def be_quiet(quiet: bool) -> None:
    """Take whether the program prints neither progress bars nor tables from here on."""
    _QUIET[0] = quiet


def is_quiet() -> bool:
    """Whether the program was called with --quiet."""
    return _QUIET[0]


def open_with_settings(
    log: Path,
    config: Path | None,
    overrides: list[str] | None,
    topics: list[str] | None = None,
    camera: Path | None = None,
) -> tuple[Log, Config]:
    """Return a log, and the configuration in force: what the log asks for is weaker than `config` and `overrides`.

    topics, camera: the options of ROS bags. Raises InputError.
    """
    from localiser.config import read_config
    from localiser.storage import open_log

    sensor = read_config(config, overrides or ()).sensor
    recorded = open_log(log, sensor=sensor, topics=topics_by_role(topics), camera=camera)
    return recorded, read_config(config, overrides or (), recorded.settings)


def with_options(overrides: list[str] | None, **options: object) -> list[str]:
    """Return the settings of `--set`, then those of options by the settings' names, `__` for a dot, where given."""
    given = {name.replace("__", "."): value for name, value in options.items() if value not in (None, [])}
    texts = {name: json.dumps(value) if isinstance(value, list) else value for name, value in given.items()}
    return [*(overrides or []), *(f"{name}={value}" for name, value in texts.items())]


def show(renderable: object) -> None:
    """Print a table or a text on standard output; of a table that is too wide, columns go on below."""
    from rich.console import Console
    from rich.table import Table

    from localiser.evaluate import fit_width

    # A pipe has no width: then a table is as wide as it wants.
    console = Console(width=None if sys.stdout.isatty() else 160, markup=False)
    for part in fit_width(renderable, console) if isinstance(renderable, Table) else (renderable,):
        console.print(part)


def warn(text: str | None) -> None:
    """Print a warning, where there is one."""
    if text:
        typer.secho(text, fg="yellow", err=True)


@contextmanager
def progress(title: str, total: int, *, shown: bool = True) -> Iterator[Callable[[], None]]:
    """Show a progress bar on standard error; yields what to call after every step."""
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=Console(stderr=True), disable=is_quiet() or not shown) as bar:
        task = bar.add_task(title, total=total)
        yield lambda: bar.advance(task)


def paced(advance: Callable[[], None], times_ns: Sequence[int], speed: float) -> Callable[[], None]:
    """Return `advance` held back so that images with these times pass `speed` times as fast as they were taken.

    A pause longer than `LONGEST_WAIT_S` takes no longer than that to watch.
    """
    import numpy as np

    waits_ns = np.minimum(np.diff(times_ns), LONGEST_WAIT_S * speed * 1e9)
    due_s = np.append(0, np.cumsum(waits_ns)) / 1e9 / speed
    begin: list[float] = []

    def step() -> None:
        advance()
        begin.append(time.monotonic())
        done = min(len(begin), len(times_ns) - 1)
        time.sleep(max(begin[0] + due_s[done] - time.monotonic(), 0.0))

    return step


@contextmanager
def working(what: str) -> Iterator[None]:
    """Show on standard error that something goes on which has no steps to count."""
    from rich.console import Console

    if is_quiet():
        yield
    else:
        with Console(stderr=True).status(what):
            yield


def topics_by_role(options: list[str] | None) -> dict[str, str]:
    """Return the topics that `--topic` named, by what they are for. Raises InputError."""
    named: dict[str, str] = {}
    for option in options or []:
        kind, _, name = option.partition("=")
        if not kind or not name:
            raise InputError(f"expected KIND=NAME, such as odometry=/odom, found {option!r}", field="--topic")
        named[kind] = name
    return named
