"""Make the folder of a run, and write its small files: each run has a new number, `latest` is the newest."""

from __future__ import annotations

import json
import math
import re
import shutil
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np

from localiser.documents import draft_beside, output_errors, read_text, write_text
from localiser.errors import InputError, OutputError
from localiser.storage.kinds import kind_of

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

    def write_json(self, name: str, data: Mapping[str, Any]) -> None:
        """Write a JSON file; see `json_text`. Raises OutputError."""
        write_text(self.path / name, json_text(data))

    def write_text(self, name: str, content: str) -> None:
        """Write a text file. Raises OutputError."""
        write_text(self.path / name, content)


def _numbers(logs: Path) -> list[int]:
    return [int(entry.name) for entry in logs.iterdir() if entry.name.isascii() and entry.name.isdigit()]


def safe_name(log_name: str) -> str:
    """Return a log's name as the name of one folder on any system."""
    return re.sub(r"[^A-Za-z0-9_.-]+", "_", log_name).strip("._") or "log"


def find_run(path: Path) -> Path:
    """Return the folder of a run given as its folder, as `latest`, or as the folder of a log's runs (its latest).

    Raises InputError.
    """
    for folder in (_linked(path), _linked(path / LATEST)):
        if (folder / "trajectory.csv").is_file():
            return folder
    found = f", found {runs}" if (runs := kind_of(path)) else ""
    raise InputError(f"expected the folder of a run, with a trajectory.csv{found}", path=path)


def _linked(path: Path) -> Path:
    """Return the folder that a `latest` stands for which could not be made a link."""
    if path.name == LATEST and path.is_file():
        return path.parent / safe_name(read_text(path, 100))
    return path


def _point_latest(logs: Path, number: str) -> None:
    """Make `latest` a symbolic link to the run, or a text file with its number where links cannot be made."""
    draft = draft_beside(logs / LATEST)
    try:
        draft.symlink_to(number, target_is_directory=True)
        draft.replace(logs / LATEST)
    except (OSError, NotImplementedError):
        draft.unlink(missing_ok=True)
        write_text(logs / LATEST, f"{number}\n")


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
