"""Simulate a log: a world in, a log folder out."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from localiser import documents, simulate, storage
from localiser.errors import InputError
from localiser.filter import Start
from localiser.simulate import SimulatedLog


def simulated(world: Path, seed: int) -> SimulatedLog:
    """Return the simulated log of a world file; its images are rendered when it is written. Raises InputError."""
    log = simulate.simulate_log(documents.load_model(world, simulate.World, simulate.world_of), seed)
    if not len(log.landmark_map):
        raise InputError(
            "expected a drive on which landmarks are seen long enough for the map, found none",
            path=world,
            field="drive.path",
        )
    return log


def write(log: SimulatedLog, folder: Path, progress: Callable[[], None]) -> None:
    """Render and write the log, calling `progress` after every image. Raises OutputError."""

    def images() -> Iterator[tuple[int, NDArray[np.uint8]]]:
        for t_ns, image in zip(log.drive.image_t_ns, log.images(), strict=True):
            yield int(t_ns), image
            progress()

    storage.write_log(
        folder,
        name=log.name,
        camera=log.camera,
        odometry=log.drive.odometry,
        images=images(),
        landmark_map=log.landmark_map,
        groundtruth=log.drive.truth,
        start=Start(int(log.drive.image_t_ns[0]), log.start, log.start_cov),
        jpeg_quality=log.jpeg_quality,
    )
