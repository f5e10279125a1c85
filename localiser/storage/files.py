"""Check paths: inside a folder, or where nothing is; and say what a file is that was given for another."""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path, PurePosixPath, PureWindowsPath

from localiser.documents import open_regular, output_errors
from localiser.errors import InputError, OutputError


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


# -- what a file or folder is that was given where another kind was expected ------------------------------------------


CAMERA, MAP, PLAN = "a camera file", "a landmark map", "a floor plan"
_TEXTS = (
    ("format: localiser-map/", MAP),
    ("format: localiser-site/", f"{MAP} list"),
    ("format: localiser-log/", "the log.yaml of a log, which is named by its folder"),
    ("format: localiser-world/", "a world, of which `localiser simulate` makes a log"),
    ("image_width:", CAMERA),
    ("resolution:", "a floor plan, of which `localiser map plan` makes a map"),
)
_BYTES = ((b"\x89PNG", "a PNG image"), (b"\xff\xd8", "a JPEG image"), (b"RRF2", "a recording for `localiser view`"))
_VIDEOS = (".mp4", ".mov", ".m4v", ".avi", ".mkv", ".webm")
_MOST_RUNS = 5


def is_video(path: Path) -> bool:
    """Whether a file is called as videos are."""
    return path.suffix.lower() in _VIDEOS


def kind_of(path: Path) -> str:
    """Return what a file or folder is, in words; "" where that is not known."""
    with suppress(OSError, InputError):
        if path.is_dir():
            return runs_in(path)
        if is_video(path):
            return "a video, of which `localiser convert VIDEO LOG --camera FILE` makes a log"
        with open_regular(path) as file:
            head = file.read(4096)
        for begin, kind in _BYTES:
            if head.startswith(begin):
                return kind
        lines = head.decode("utf-8", "replace").splitlines()
        return next((kind for start, kind in _TEXTS for line in lines if line.startswith(start)), "")
    return ""


def runs_in(folder: Path) -> str:
    """Return that a folder has results of replays, with the newest first; "" where it has none."""
    runs = [path.parent for depth in ("", "*/", "*/*/") for path in folder.glob(f"{depth}trajectory.csv")]
    runs = [run for run in runs if not run.is_symlink()]
    runs.sort(key=lambda run: run.stat().st_mtime_ns, reverse=True)
    more = f" and {len(runs) - _MOST_RUNS} more" if len(runs) > _MOST_RUNS else ""
    return f"results of replay, the newest first: {', '.join(map(str, runs[:_MOST_RUNS]))}{more}" if runs else ""


def refuse_other(path: Path, expected: str, hint: str = "") -> None:
    """Raise InputError where a file is known to be of another kind than expected. hint: what that looks like."""
    kind = kind_of(path)
    if kind and not kind.startswith(expected):
        raise InputError(f"expected {expected}{hint}, found {kind}", path=path)
