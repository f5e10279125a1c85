"""Check paths: inside a folder, or where nothing is. Keep a file before it is changed."""

from __future__ import annotations

import os
from pathlib import Path, PurePosixPath, PureWindowsPath

from localiser.documents import output_errors
from localiser.errors import OutputError


def inside(folder: Path, name: str) -> Path:
    """Return the path of a file that is named relative to `folder` and lies in it, symbolic links followed.

    Raises ValueError, with what was expected, for an absolute path, a path that leaves the folder, or no path at all.
    """
    if not name.strip() or "\0" in name:
        raise ValueError("expected the name of a file")
    if PurePosixPath(name).is_absolute() or PureWindowsPath(name).anchor or ".." in Path(name).parts:
        raise ValueError("expected a path inside the log's folder")
    root, path = os.path.realpath(folder), os.path.realpath(folder / name)
    if not Path(path).is_relative_to(root):
        raise ValueError(f"expected a path inside the log's folder, found a link to {path}")
    return folder / name


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
