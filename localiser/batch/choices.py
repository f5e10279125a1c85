"""What a batch varies, and what a run is made from, by content: another place on the disk is the same run."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from hashlib import sha256
from itertools import product
from pathlib import Path
from typing import Any

from localiser import __version__
from localiser.config import Config, read_config
from localiser.documents import fingerprint
from localiser.errors import InputError, LocaliserError
from localiser.landmarks import LandmarkMap
from localiser.storage import ImageEvent, Log, open_log

MOST_SEEDS = 100_000
_COMMA = r""",(?![^\[]*])(?![^{]*})(?=(?:[^"]*"[^"]*")*[^"]*$)"""
"""A comma that is in no list, mapping or quoted text."""


@dataclass(frozen=True, slots=True)
class Choice:
    """One combination. settings: (name, value), in the order given. seed: None for that of the configuration."""

    config: Path | None = None
    settings: tuple[tuple[str, str], ...] = ()
    seed: int | None = None

    @property
    def overrides(self) -> list[str]:
        """The settings as `--set` takes them, the seed with them."""
        seed = [] if self.seed is None else [f"seed={self.seed}"]
        return [*(f"{name}={value}" for name, value in self.settings), *seed]

    def config_for(self, log_settings: object = None) -> Config:
        """Return the configuration in force for a log that asks for these settings. Raises InputError."""
        return read_config(self.config, self.overrides, log_settings if isinstance(log_settings, dict) else None)


def choices_of(configs: Sequence[Path], overrides: Sequence[str], seeds: str | None) -> list[Choice]:
    """Return every combination once: of configuration files, of values `name=a,b` for each setting, of seeds.

    Seeds vary fastest. Raises InputError when an option cannot be read or a configuration is not valid.
    """
    varied = [values_of(override) for override in overrides]
    names = [name for name, _ in varied]
    for name in names:
        if names.count(name) > 1:
            raise InputError(f"expected each name once, with its values as {name}=a,b", field=f"--set {name}")
    if seeds is not None and "seed" in names:
        raise InputError("expected seeds by --set or by --seeds, found both", field="--seeds")
    settings = list(product(*([(name, value) for value in values] for name, values in varied)))
    numbers: list[int | None] = list(seeds_of(seeds)) if seeds is not None else [None]
    files: list[Path | None] = list(dict.fromkeys(configs)) or [None]
    found = [Choice(file, setting, seed) for file, setting, seed in product(files, settings, numbers)]
    for choice in {(one.config, one.settings): one for one in found}.values():
        choice.config_for()
    return found


def seeds_of(text: str) -> list[int]:
    """Return the seeds that `0-4`, or `0,3,7-9`, stands for, each once. Raises InputError."""
    problem = InputError(f"expected seeds such as 0-4 or 0,3,7-9, found {text!r}", field="--seeds")
    seeds: dict[int, None] = {}
    for part in text.split(","):
        found = re.fullmatch(r"\s*(\d{1,10})\s*(?:-\s*(\d{1,10})\s*)?", part, re.ASCII)
        if found is None:
            raise problem
        first = int(found[1])
        last = int(found[2] or first)
        if last < first or last - first + len(seeds) >= MOST_SEEDS or last >= 2**32:
            raise problem
        seeds |= dict.fromkeys(range(first, last + 1))
    return list(seeds)


def values_of(override: str) -> tuple[str, list[str]]:
    """Return the name in `name=a,b`, and its values: commas inside of brackets or quotes separate nothing."""
    name, equals, text = (part.strip() for part in override.partition("="))
    values = [value.strip() for value in re.split(_COMMA, text)]
    if not equals or not name or not all(values):
        raise InputError("expected section.name=value, or several values with commas between", path=f"--set {override}")
    return name, list(dict.fromkeys(values))


# -- what a run is made from ------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Opening:
    """How logs are opened and where their runs start, the same for all: see `storage.open_log` and `replay.prepare`."""

    start: str | None = None
    map_file: Path | None = None
    topics: Mapping[str, str] = field(default_factory=dict)
    camera: Path | None = None

    def open(self, log: Path, config: Config | None = None) -> Log:
        """Return a log. Raises InputError."""
        sensor = (config or Config()).sensor
        return open_log(log, sensor=sensor, topics=self.topics, camera=self.camera)


@dataclass(frozen=True, slots=True)
class Contents:
    """What is in a log. log_id: of its measurements. rest_id: of its map, camera, truth and start.

    settings: that it asks for. error: why it cannot be read; then all else is empty.
    """

    name: str
    log_id: str = ""
    rest_id: str = ""
    settings: dict[str, Any] = field(default_factory=dict)
    frames: int = 0
    error: str | None = None


def contents_of(path: Path, opening: Opening) -> Contents:
    """Return what is in a log, every image included."""
    try:
        log = opening.open(path)
        frames = [_frame(frame) for frame in log.frames]
        landmark_map = None if log.landmark_map is None else log.landmark_map.without_remarks()
        return Contents(
            log.name,
            fingerprint((log.odometry, frames)),
            fingerprint((landmark_map, log.camera, log.groundtruth, log.start, log.restarts, log.resumed)),
            dict(log.settings),
            len(frames),
        )
    except LocaliserError as error:
        return Contents(path.name, error=str(error))
    except Exception as error:  # a fault of the program must not end the other runs
        return Contents(path.name, error=f"{type(error).__name__}: {error}")


def run_id(contents: Contents, config: Config, start: str | None, map_id: str) -> str:
    """Return the name of a run for all that decides its results.

    map_id: of the map in place of the log's own, "" where there is none.
    """
    settings = config.of_results()
    made_of = (__version__, contents.name, contents.log_id, contents.rest_id, start or "", map_id, settings)
    return fingerprint(made_of)


def map_id(landmark_map: LandmarkMap | None) -> str:
    """Return the name of a map's content, "" where there is none."""
    return "" if landmark_map is None else fingerprint(landmark_map.without_remarks())


def _frame(frame: Any) -> Any:
    if isinstance(frame, ImageEvent):
        return frame.t_ns, frame.by_wheels, sha256(frame.encoded()).hexdigest()
    return frame
