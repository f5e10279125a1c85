"""Say what a file or folder is that was given where another kind was expected."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path

from localiser.documents import open_regular
from localiser.errors import InputError

CAMERA, MAP, PLAN = "a camera file", "a landmark map", "a floor plan"
_TEXTS = (
    ("format: localiser-map/", MAP),
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
    if not runs:
        return ""
    runs.sort(key=lambda run: run.stat().st_mtime_ns, reverse=True)
    more = f" and {len(runs) - _MOST_RUNS} more" if len(runs) > _MOST_RUNS else ""
    return f"results of replay, the newest first: {', '.join(map(str, runs[:_MOST_RUNS]))}{more}"


def refuse_other(path: Path, expected: str, hint: str = "") -> None:
    """Raise InputError where a file is known to be of another kind than expected. hint: what that looks like."""
    kind = kind_of(path)
    if kind and not kind.startswith(expected):
        raise InputError(f"expected {expected}{hint}, found {kind}", path=path)
