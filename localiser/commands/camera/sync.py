"""Find the offset between the clocks of a log's images and wheels, and write the images' times by the wheels' clock."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from localiser.calibration import ClockOffset, clock_offset
from localiser.config import Config
from localiser.edges import Edges, find_edges
from localiser.errors import InputError
from localiser.storage import ImageEvent, Log, images_table, move_images, require_odometry

WRITTEN_SIGMA_S = 0.05
"""An offset that is less certain than this is not written."""


def images_of(log: Log) -> list[ImageEvent]:
    """Return the images of a log that has odometry. Raises InputError."""
    require_odometry(log, "comparing the clocks")
    if not log.has_images:
        raise InputError("expected a log with images, found edges that were measured already", path=log.path)
    return log.images


def find_offset(log: Log, images: list[ImageEvent], config: Config, progress: Callable[[], None]) -> ClockOffset:
    """Return by how much images of a log are stamped later than its wheels. Raises InputError for a bad image."""

    def edges_of(index: int) -> Edges:
        image = images[index]
        return find_edges(image.load(), log.camera, config.edges, twist=log.twist_at(image.t_ns))

    times = np.array([image.t_ns for image in images])
    return clock_offset(times, edges_of, log.odometry, log.camera, progress=progress)


def write_offset(log: Log, found: ClockOffset) -> tuple[Path, Path]:
    """Move the times of a log's images to the clock of its wheels; return their table, and where the old one is kept.

    Raises InputError when the offset is not certain enough, or the log is no folder; OutputError.
    """
    path = images_table(log.path)
    if found.sigma_s > WRITTEN_SIGMA_S:
        raise InputError(
            f"not written: the images tell the offset to {found.sigma_s:.3f} s only, expected {WRITTEN_SIGMA_S:g} s or "
            "better; record a drive with some turns",
            path=path,
        )
    return path, move_images(path, -round(found.offset_s * 1e9))
