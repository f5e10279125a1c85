"""What a run was made from, by content: another place on the disk is the same run, another byte of an image is not."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from hashlib import sha256
from pathlib import Path
from typing import Any

from localiser import __version__
from localiser.config import Config
from localiser.errors import LocaliserError
from localiser.landmarks import LandmarkMap
from localiser.storage import ImageEvent, Log, fingerprint, open_log


@dataclass(frozen=True, slots=True)
class Opening:
    """How logs are opened and where their runs start, the same for all: see `storage.open_log` and `replay.prepare`."""

    start: str | None = None
    map_file: Path | None = None
    format: str | None = None
    topics: Mapping[str, str] = field(default_factory=dict)
    camera: Path | None = None

    def open(self, log: Path, config: Config | None = None) -> Log:
        """Return a log. Raises InputError."""
        sensor = (config or Config()).sensor
        return open_log(log, format=self.format, sensor=sensor, topics=self.topics, camera=self.camera)


@dataclass(frozen=True, slots=True)
class Contents:
    """What is in a log. log_id: of its measurements. rest_id: of its map, camera, truth and start.

    settings: that it asks for. error: why it cannot be read; then all else is empty.
    """

    name: str
    log_id: str = ""
    rest_id: str = ""
    settings: dict[str, Any] = field(default_factory=dict)
    frames: int = 0
    error: str | None = None


def contents_of(path: Path, opening: Opening) -> Contents:
    """Return what is in a log, every image included."""
    try:
        log = opening.open(path)
        frames = [_frame(frame) for frame in log.frames]
        landmark_map = None if log.landmark_map is None else log.landmark_map.without_remarks()
        return Contents(
            log.name,
            fingerprint((log.odometry, frames)),
            fingerprint((landmark_map, log.camera, log.groundtruth, log.start, log.restarts, log.resumed)),
            dict(log.settings),
            len(frames),
        )
    except LocaliserError as error:
        return Contents(path.name, error=str(error))
    except Exception as error:  # a fault of the program must not end the other runs
        return Contents(path.name, error=f"{type(error).__name__}: {error}")


def run_id(contents: Contents, config: Config, start: str | None, map_id: str) -> str:
    """Return the name of a run for all that decides its results.

    map_id: of the map in place of the log's own, "" where there is none.
    """
    settings = config.of_results()
    made_of = (__version__, contents.name, contents.log_id, contents.rest_id, start or "", map_id, settings)
    return fingerprint(made_of)


def map_id(landmark_map: LandmarkMap | None) -> str:
    """Return the name of a map's content, "" where there is none."""
    return "" if landmark_map is None else fingerprint(landmark_map.without_remarks())


def _frame(frame: Any) -> Any:
    if isinstance(frame, ImageEvent):
        return frame.t_ns, frame.by_wheels, sha256(frame.encoded()).hexdigest()
    return frame
