"""What a batch varies: configuration files, settings with several values, seeds. Every combination is one choice."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path

from localiser.config import Config, read_config
from localiser.errors import InputError

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
