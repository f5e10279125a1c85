"""Read world files, and simulate the log of the drive through a world."""

from __future__ import annotations

from functools import cache, partial
from pathlib import Path
from typing import TYPE_CHECKING

from localiser.documents import read_model
from localiser.errors import InputError
from localiser.filter import Start
from localiser.storage.images import encode_image, image_event
from localiser.storage.log import Log

if TYPE_CHECKING:
    from localiser.simulate import SimulatedLog, World


def read_world(path: Path | str) -> World:
    """Return the world that a file describes. Raises InputError."""
    from localiser.simulate import World, world_of

    return read_model(Path(path), World, world_of)


def simulate_log(world: World | Path | str, seed: int = 0) -> Log:
    """Return the log of the drive through a world: images, odometry with its errors, truth, map and start.

    world: or its file. An image is rendered when it is first asked for, and then kept as a JPEG file in memory. Same
    seed, same log. Raises InputError when the drive runs into something, or no landmark is seen long enough.
    """
    from localiser.simulate import simulated_log

    path = Path(world) if isinstance(world, Path | str) else Path()
    made = simulated_log(read_world(world) if isinstance(world, Path | str) else world, seed)
    if not len(made.landmark_map):
        raise InputError(
            "expected a drive on which landmarks are seen long enough for the map, found none",
            path=path,
            field="drive.path",
        )
    size = (made.camera.width, made.camera.height)
    frames = [
        image_event(
            int(t_ns),
            f"image {index}",
            cache(partial(_rendered, made, index)),
            size,
            path=path,
            mount=made.mounts[index],
        )
        for index, t_ns in enumerate(made.drive.image_t_ns)
    ]
    start = Start(frames[0].t_ns, made.start, made.start_cov)
    return Log(made.name, path, made.camera, made.drive.odometry, frames, made.landmark_map, start, made.drive.truth)


def _rendered(log: SimulatedLog, index: int) -> bytes:
    return encode_image(log.image(index), ".jpg", log.jpeg_quality)
