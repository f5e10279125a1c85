"""Find the format of a log, and read it; or simulate the log of the drive through a world."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

from localiser.documents import Document, load, validate
from localiser.edges import BearingSensor
from localiser.errors import InputError, warn
from localiser.filter import Start
from localiser.storage.bags import BagReader
from localiser.storage.cameras import camera_data, camera_from_document
from localiser.storage.files import kind_of
from localiser.storage.folder import FolderReader
from localiser.storage.images import encode_image, image_event
from localiser.storage.log import Log, LogReader, ReadOptions

if TYPE_CHECKING:
    from localiser.simulate import World


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
    log = reader.read(path, ReadOptions(sensor or BearingSensor(), topics or {}, camera))
    truth = log.groundtruth
    if truth is not None and not any(truth.covers(frame.t_ns) for frame in log.frames):
        images, poses = (f"from {times[0]} to {times[-1]} ns" for times in ([f.t_ns for f in log.frames], truth.t_ns))
        warn(f"the true poses, {poses}, cover none of the images, {images}: errors are not known", path=path)
    return log


def _listed(names: list[str]) -> str:
    return f"{', '.join(names[:-1])} or {names[-1]}"


# -- worlds -----------------------------------------------------------------------------------------------------------


def read_world(path: Path | str) -> World:
    """Return the world that a file describes. Raises InputError."""
    from localiser.simulate import World, world_of

    return validate(load(Path(path)), World, world_of)


def simulate_log(world: World | Path | str, seed: int = 0) -> Log:
    """Return the log of the drive through a world: images, odometry with its errors, truth, map and start.

    world: or its file. An image is rendered when it is first asked for, and then kept as a JPEG file in memory. Same
    seed, same log. Raises InputError when the drive runs into something, or no landmark is seen long enough.
    """
    from localiser.simulate import simulated_log

    path = Path(world) if isinstance(world, Path | str) else Path()
    world = read_world(world) if isinstance(world, Path | str) else world
    try:  # a log can be read whose camera can
        camera_from_document(Document(camera_data(world.camera.camera()), {}))
    except InputError as error:
        raise InputError(error.problem, path=path, field=f"camera: {error.field}") from None
    made = simulated_log(world, seed)
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
            cache(lambda index=index: encode_image(made.image(index), ".jpg", made.jpeg_quality)),
            size,
            path=path,
            mount=made.mounts[index],
        )
        for index, t_ns in enumerate(made.drive.image_t_ns)
    ]
    start = Start(frames[0].t_ns, made.start, made.start_cov)
    return Log(made.name, path, made.camera, made.drive.odometry, frames, made.landmark_map, start, made.drive.truth)
