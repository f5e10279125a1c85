"""Find the format of a log, and read it."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from localiser.edges import BearingSensor
from localiser.errors import InputError
from localiser.storage.bags import BagReader
from localiser.storage.folder import FolderReader
from localiser.storage.kinds import kind_of
from localiser.storage.log import Log, LogReader, ReadOptions

FORMATS: list[LogReader] = [FolderReader(), BagReader()]
"""The formats of logs, the first that recognises a path comes first. Append a `LogReader` to read another format."""


def open_log(
    path: Path | str,
    *,
    format: str | None = None,
    sensor: BearingSensor | None = None,
    topics: Mapping[str, str] | None = None,
    camera: Path | None = None,
) -> Log:
    """Return the log at `path`, in the format given or else in the first of `FORMATS` that recognises it.

    sensor: stands in for the camera where a log has bearings only. topics: names of a bag's topics by what they are
    for. camera: a camera file in place of what a bag says of its camera. Raises InputError.
    """
    path = Path(path)
    if format is not None and format not in (names := [reader.format for reader in FORMATS]):
        raise InputError(f"expected {_listed(names)}, found {format!r}", field="format")
    fitting = (one for one in FORMATS if (one.recognises(path) if format is None else one.format == format))
    reader = next(fitting, None)
    if reader is None and not path.exists():
        raise InputError("no such log", path=path)
    if reader is None:
        found = f", found {kind}" if (kind := kind_of(path)) else ""
        raise InputError(f"expected a log: {_listed([one.looks_like for one in FORMATS])}{found}", path=path)
    for name, given in (("topics", topics), ("camera", camera)):
        if given and name not in reader.options:
            option = f"--{name.removesuffix('s')}"
            raise InputError(f"{option} is for ROS bags, found a log of the format {reader.format!r}", path=path)
    return reader.read(path, ReadOptions(sensor or BearingSensor(), topics or {}, camera))


def _listed(names: list[str]) -> str:
    return f"{', '.join(names[:-1])} or {names[-1]}"
