"""Files and folders for results, in which nothing is overwritten."""

from __future__ import annotations

from pathlib import Path

from localiser.errors import OutputError
from localiser.storage.files import output_errors


def require_new(folder: Path) -> None:
    """Raise OutputError when the folder holds something already; to be asked before the work is done."""
    with output_errors(folder):
        if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
            raise OutputError(f"{folder}: expected a new or empty folder, found files in it")


def require_new_file(path: Path) -> None:
    """Raise OutputError when there is a file already; to be asked before the work is done."""
    with output_errors(path):
        if path.exists():
            raise OutputError(f"{path}: expected a new file, found one that is there already")
