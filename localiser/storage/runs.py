"""Make the folder of a run, and write its small files: each run has a new number, `latest` is the newest."""

from __future__ import annotations

import json
import math
import re
import shutil
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np

from localiser.documents import draft_beside, field_name, output_errors, read_text, shown
from localiser.errors import InputError, OutputError, one_paragraph
from localiser.storage.files import kind_of
from localiser.storage.tables import Column, csv_of, read_table

LATEST = "latest"


@dataclass(frozen=True, slots=True)
class RunFolder:
    """`results/<log>/<n>/`, which exists and can be written."""

    path: Path

    @classmethod
    def create(cls, results: Path, log_name: str) -> RunFolder:
        """Make the next numbered folder for this log and let `latest` point to it. Raises OutputError."""
        logs = results / safe_name(log_name)
        with output_errors(logs):
            logs.mkdir(parents=True, exist_ok=True)
            for number in count(max(_numbers(logs), default=0) + 1):
                try:
                    (logs / str(number)).mkdir()
                except FileExistsError:
                    continue  # another run took it just now
                _point_latest(logs, str(number))
                return cls(logs / str(number))
        raise AssertionError("numbers do not end")

    def discard(self) -> None:
        """Remove the folder of a run that came to nothing; `latest` is the newest of the others again."""
        logs = self.path.parent
        shutil.rmtree(self.path, ignore_errors=True)
        with suppress(OSError, OutputError):  # whatever keeps it is not worth another error
            if others := _numbers(logs):
                _point_latest(logs, str(max(others)))
            else:
                (logs / LATEST).unlink(missing_ok=True)
                logs.rmdir()


def _numbers(logs: Path) -> list[int]:
    return [int(entry.name) for entry in logs.iterdir() if entry.name.isascii() and entry.name.isdigit()]


def safe_name(log_name: str) -> str:
    """Return a log's name as the name of one folder on any system."""
    return re.sub(r"[^A-Za-z0-9_.-]+", "_", log_name).strip("._") or "log"


def find_run(path: Path) -> Path:
    """Return the folder of a run, given as it is or as the folder of a log's runs (its latest). Raises InputError."""
    for folder in (path, path / LATEST):
        if (folder / "trajectory.csv").is_file():
            return folder
    found = f", found {runs}" if (runs := kind_of(path)) else ""
    raise InputError(f"expected the folder of a run, with a trajectory.csv{found}", path=path)


def _point_latest(logs: Path, number: str) -> None:
    """Make `latest` a symbolic link to the run; there is none where links cannot be made."""
    draft = draft_beside(logs / LATEST)
    with suppress(OSError, NotImplementedError):
        draft.symlink_to(number, target_is_directory=True)
        draft.replace(logs / LATEST)
        return
    draft.unlink(missing_ok=True)


# -- JSON -------------------------------------------------------------------------------------------------------------


def json_text(data: Mapping[str, Any]) -> str:
    """Return data as JSON: keys sorted, so that equal data are equal bytes; nan and infinity are null."""
    return json.dumps(_plain(data), indent=2, sort_keys=True, allow_nan=False, ensure_ascii=False) + "\n"


def read_json(path: Path) -> dict[str, Any]:
    """Return the JSON object in a file. Raises InputError."""
    try:
        data = json.loads(read_text(path))
    except json.JSONDecodeError as error:
        raise InputError(f"not valid JSON: {error.msg}", path=path, line=error.lineno, column=error.colno) from None
    except (ValueError, RecursionError) as error:
        raise InputError(f"not valid JSON: {error}", path=path) from None
    if not isinstance(data, dict):
        raise InputError("expected keys and values, found something else", path=path)
    return data


def _plain(value: Any) -> Any:
    """Return a value that JSON has: numpy's become Python's."""
    if isinstance(value, Mapping):
        return {str(key): _plain(part) for key, part in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(part) for part in value]
    if isinstance(value, (np.ndarray, np.generic)):
        return _plain(value.tolist())
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


# -- tables of many runs, a row a run ---------------------------------------------------------------------------------


Row = Mapping[str, Any]

CHOICE = "set."
"""How the names begin of columns that say what was chosen for a run."""

TEXTS = (
    "run", "log", "log_path", "log_id", "config", "error", "folder", "warnings", "confidence.reasons",
    "observation", "association", "odometry", "start", "map", "inputs", "version",
)  # fmt: skip
INTEGERS = ("seed", "frames", "particles")
_LARGEST = 2**62
_REQUIRED = ("log", "log_id", "seed")


def csv_text(rows: Sequence[Row]) -> str:
    """Return the table of rows as CSV; its columns are in the order in which rows have them; unknown: empty."""

    def cell(value: Any) -> str:
        if value is None or (isinstance(value, float) and not math.isfinite(value)):
            return ""
        return str(int(value)) if isinstance(value, bool) else str(value)

    names = list(dict.fromkeys(name for row in rows for name in row))
    return csv_of([names, *([cell(row.get(name)) for name in names] for row in rows)])


def read_figures(path: Path) -> dict[str, Any]:
    """Return the figures of one run that a JSON file holds, as tables have them: by name. Raises InputError."""
    figures = read_json(path)
    for name, value in figures.items():
        kind, fits = _type_of(name), isinstance(value, str)
        if kind is not str:
            fits = isinstance(value, (int, float)) and abs(value) < _LARGEST and (kind is float or value == int(value))
        if not fits and value is not None:
            expected = {str: "a text", int: "a whole number", float: "a number"}[kind]
            raise InputError(f"expected {expected}, found {shown(value)}", path=path, field=field_name((name,)))
    return figures


def read_runs(path: Path) -> list[dict[str, Any]]:
    """Return the rows of a table, None where something is not known. Raises InputError."""
    table = read_table(path, [Column(name, str) for name in _REQUIRED], more_columns=True)

    def value(index: int, name: str) -> Any:
        cell, kind = table.columns[name][index], _type_of(name)
        if not cell or kind is str:
            return one_paragraph(cell) or None
        try:
            found = kind(cell)
        except ValueError:
            found = math.nan
        if not abs(found) < _LARGEST:
            raise table.error(index, name, f"expected a number or an empty cell, found {cell!r}")
        return found

    if not len(table):
        raise InputError("expected at least one run, found none", path=path)
    return [{name: value(index, name) for name in table.columns} for index in range(len(table))]


def _type_of(name: str) -> type:
    """Return what a column holds, by its name alone, so that tables of other runs can be put together."""
    if name in TEXTS or name.startswith(CHOICE):
        return str
    return int if name in INTEGERS else float
