"""Find out what kind of log a path is, and read it."""

from __future__ import annotations

from pathlib import Path

from localiser.edges.bearings import BearingSensor
from localiser.errors import InputError
from localiser.storage.folder import FolderReader
from localiser.storage.log import Log, LogReader
from localiser.storage.mrclam import MrclamReader

FORMATS = ("folder", "mrclam")


def open_log(path: Path | str, *, format: str | None = None, sensor: BearingSensor | None = None) -> Log:
    """Return the log at `path`, in the format given or else in the first that recognises it.

    sensor: what stands in for the camera where a log has bearings only. Raises InputError.
    """
    path = Path(path)
    readers: list[LogReader] = [FolderReader(), MrclamReader(sensor or BearingSensor())]
    if format is not None:
        readers = [reader for reader in readers if reader.format == format]
        if not readers:
            raise InputError(f"expected {' or '.join(FORMATS)}, found {format!r}", field="--format")
        return readers[0].read(path)
    for reader in readers:
        if reader.recognises(path):
            return reader.read(path)
    if not path.exists():
        raise InputError("no such log", path=path)
    raise InputError("expected a log: a folder with a log.yaml, or FOLDER:N of the UTIAS data set", path=path)
