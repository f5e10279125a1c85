"""Turn a recorded log into another format: a log folder, or a ROS bag of any kind."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

from localiser import storage
from localiser.errors import InputError
from localiser.filter import Sighting
from localiser.storage import ImageEvent, Log
from localiser.storage.bags import FILE_KINDS

FOLDER = "folder"
TARGETS = (FOLDER, *storage.KINDS)


def target_of(out: Path, log: Log, asked: str | None) -> str:
    """Return one of TARGETS: what was asked for, else what the name's ending says, else the other of folder and bag.

    Raises InputError when what was asked for and the ending contradict.
    """
    by_name = FILE_KINDS.get(out.suffix)
    if asked is not None and asked not in TARGETS:
        raise InputError(f"expected {', '.join(TARGETS)}, found {asked!r}", field="--to")
    if asked is not None and by_name is not None and asked != by_name:
        raise InputError(f"expected a path for {asked}, found one that ends in {out.suffix}", path=out, field="--to")
    is_folder = (log.path / "log.yaml").exists()
    return asked or by_name or ("mcap" if is_folder else FOLDER)


def convert(log: Log, out: Path, target: str, progress: Callable[[], None]) -> None:
    """Write the log to `out` as `target`, calling `progress` after every image; image files are copied as they are.

    Raises OutputError when there is something already, InputError when an image cannot be read.
    """
    if target == FOLDER:
        _to_folder(log, out, progress)
    else:
        storage.write_bag(out, log, target, progress)


def _to_folder(log: Log, out: Path, progress: Callable[[], None]) -> None:
    def images() -> Iterator[tuple[int, bytes]]:
        for frame in log.frames:
            if isinstance(frame, ImageEvent):
                yield frame.t_ns, frame.encoded()
                progress()

    storage.write_log(
        out,
        name=log.name,
        camera=log.camera,
        odometry=log.odometry,
        images=images() if log.has_images else None,
        sightings=None if log.has_images else [frame for frame in log.frames if isinstance(frame, Sighting)],
        landmark_map=log.landmark_map,
        groundtruth=log.groundtruth,
        start=log.start,
        motion=storage.motion_settings(log),
    )
