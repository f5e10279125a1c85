"""Compare a batch with the runs of an earlier one, or of another version, in pairs of the same log and seed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from localiser.batch.run import CSV
from localiser.errors import InputError
from localiser.evaluate import Comparison, compare_pairs
from localiser.storage import CHOICE, read_runs

Row = Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class Verdict:
    """What a comparison came to.

    newly_failed: rows of runs that fail here and did not there. pairs: how many were compared. alone, alone_there: how
    many runs have no counterpart.
    """

    comparisons: Sequence[Comparison]
    newly_failed: Sequence[Row]
    pairs: int
    alone: int
    alone_there: int

    @property
    def is_loss(self) -> bool:
        """Whether something is significantly worse, or fails that did not."""
        return bool(self.newly_failed) or any(one.is_worse for one in self.comparisons)


def read_table_of(path: Path) -> list[dict[str, Any]]:
    """Return the rows of a batch by its folder or its table. Raises InputError."""
    if path.is_dir() and not (path / CSV).is_file():
        raise InputError(f"expected the folder of a batch, with a {CSV}", path=path)
    return read_runs(path / CSV if path.is_dir() else path)


def compare_with(here: Sequence[Row], there: Sequence[Row], path: Path) -> Verdict:
    """Compare the rows of a batch with those read from `path`, which errors name.

    Pairs have the same measurements (`log_id`) and seed, and the same value of every setting (or configuration) that
    was varied on one side and has a value in common with the other. Raises InputError when runs there cannot be told
    apart, or none has a counterpart.
    """
    names = ["log_id", "seed", *_varied(here, there)]
    ours, theirs = (_by_key(rows, names, path) for rows in (here, there))
    common = [key for key in ours if key in theirs]
    pairs = [(ours[key], theirs[key]) for key in common]
    if not pairs:
        raise InputError("expected runs of the same logs (by content) with the same seeds, found none", path=path)
    return Verdict(
        compare_pairs([pair for pair in pairs if not any(row.get("error") for row in pair)]),
        [row for row, other in pairs if row.get("error") and not other.get("error")],
        len(pairs),
        len(ours) - len(pairs),
        len(theirs) - len(pairs),
    )


def _varied(here: Sequence[Row], there: Sequence[Row]) -> list[str]:
    """Return the columns of choices that have several values in either table, and one in common."""
    names = [name for name in here[0] if name == "config" or name.startswith(CHOICE)]
    values = {name: ({row.get(name) for row in here}, {row.get(name) for row in there}) for name in names}
    return [name for name, (ours, theirs) in values.items() if max(len(ours), len(theirs)) > 1 and ours & theirs]


def _by_key(rows: Sequence[Row], names: Sequence[str], path: Path) -> dict[tuple[Any, ...], Row]:
    found: dict[tuple[Any, ...], Row] = {}
    for row in rows:
        key = tuple(row.get(name) for name in names)
        if row.get("log_id") is None:
            continue  # of a log that could not be read
        if key in found:
            told = ", ".join(f"{name} {value}" for name, value in zip(names, key, strict=True))
            problem = f"expected one run for each log and seed on either side, found two with {told}"
            raise InputError(f"{problem}; compare fewer settings at once", path=path)
        found[key] = row
    return found
