"""Find out what kind of log a path is, and read it."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from localiser.edges import BearingSensor
from localiser.errors import InputError
from localiser.storage.bags import BagReader
from localiser.storage.folder import FolderReader
from localiser.storage.log import Log, LogReader
from localiser.storage.mrclam import MrclamReader

FORMATS = ("folder", "bag", "mrclam")


def open_log(
    path: Path | str,
    *,
    format: str | None = None,
    sensor: BearingSensor | None = None,
    topics: Mapping[str, str] | None = None,
    camera: Path | None = None,
) -> Log:
    """Return the log at `path`, in the format given or else in the first that recognises it.

    sensor: what stands in for the camera where a log has bearings only. topics: names of a bag's topics by what they
    are for. camera: a camera file in place of what a bag says of its camera. Raises InputError.
    """
    path = Path(path)
    bags = BagReader(topics or {}, camera)
    readers: list[LogReader] = [FolderReader(), bags, MrclamReader(sensor or BearingSensor())]
    if format is not None:
        readers = [reader for reader in readers if reader.format == format]
        if not readers:
            raise InputError(f"expected {', '.join(FORMATS[:-1])} or {FORMATS[-1]}, found {format!r}", field="--format")
        return _read(readers[0], path, bags)
    for reader in readers:
        if reader.recognises(path):
            return _read(reader, path, bags)
    if not path.exists():
        raise InputError("no such log", path=path)
    raise InputError(
        "expected a log: a folder with a log.yaml, a ROS bag, or FOLDER:N of the UTIAS data set", path=path
    )


def _read(reader: LogReader, path: Path, bags: BagReader) -> Log:
    """Return the log; refuse options that would change nothing."""
    if reader is not bags and (bags.topics or bags.camera):
        option = "--topic" if bags.topics else "--camera"
        raise InputError(f"{option} is for ROS bags, found a log of the format {reader.format!r}", path=path)
    return reader.read(path)
