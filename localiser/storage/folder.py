"""Read and write log folders: `log.yaml` and the files in the same folder that it names."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

import numpy as np
from pydantic import BaseModel, Field

from localiser.camera import Camera, Mount, MountSigma
from localiser.documents import drafted, dump, is_name, load, validate, write_bytes, write_text
from localiser.errors import InputError
from localiser.filter import Sighting, Start
from localiser.geometry import Trajectory
from localiser.landmarks import LandmarkMap
from localiser.storage.cameras import FileModel, degrees, named, read_camera, write_camera
from localiser.storage.edge_tables import read_edges, write_edges
from localiser.storage.files import inside, require_new
from localiser.storage.images import (
    Image,
    ImageEvent,
    check_head,
    encode_image,
    image_event,
    suffix_of,
    warn_turned,
    whole_image,
)
from localiser.storage.log import NO_ODOMETRY, VISION_ALONE, Frame, Log, ReadOptions, require_overlap
from localiser.storage.maps import PoseFile, read_map, write_map
from localiser.storage.tables import Column, Table, integer, number_or_unknown, read_table, text
from localiser.storage.trajectories import read_poses, write_poses

Part = TypeVar("Part")
LOG_FILE = "log.yaml"
FORMAT = "localiser-log/1"
FileName = Annotated[str, Field(min_length=1, max_length=255)]


class StartFile(PoseFile):
    """Where the robot is said to be at the first event, and how certain that is."""

    sigma_m: Annotated[float, Field(ge=0, le=1000)]
    sigma_deg: Annotated[float, Field(ge=0, le=360)]


class LogFile(BaseModel):
    """`log.yaml`: the names of the other files, relative to the folder."""

    model_config = FileModel

    format: Literal["localiser-log/1"]
    name: Annotated[str, Field(min_length=1), is_name]
    camera: FileName
    odometry: FileName | None = None
    images: FileName | None = None
    edges: FileName | None = None
    groundtruth: FileName | None = None
    map: FileName | None = None
    start: StartFile | None = None
    motion: dict[str, Any] | None = None  # quality of this robot's odometry; checked as part of the configuration


class FolderReader:
    """Reads log folders."""

    format, looks_like, options = "folder", "a folder with a log.yaml", ()

    def recognises(self, path: Path) -> bool:
        """Whether `path` is a folder with a log.yaml, or that file itself."""
        return (path / LOG_FILE).exists() or path.name == LOG_FILE

    def read(self, path: Path, options: ReadOptions) -> Log:
        """Return the log. That all images are there and of the camera's size is checked now. Raises InputError."""
        folder = path.parent if path.name == LOG_FILE else path
        document = load(folder / LOG_FILE)
        file = validate(document, LogFile)

        def part(key: str, read: Callable[[Path], Part]) -> Part | None:
            name = getattr(file, key)
            return read(named(document, folder, key, name)) if name else None

        camera = read_camera(named(document, folder, "camera", file.camera))
        odometry = part("odometry", read_poses) or NO_ODOMETRY
        if bool(file.images) == bool(file.edges):
            key, found = ("edges", "both") if file.images else ("images", "neither")
            raise document.error((key,), f"expected images or edges, found {found}")
        images = part("images", lambda table: _images(table, folder, camera))
        edges = part("edges", lambda table: read_edges(table, camera))
        sightings, landmarks = edges or ([], {})
        frames: Sequence[Frame] = images or sightings
        first_ns = min([frames[0].t_ns, *odometry.t_ns[:1].tolist()])
        log = Log(
            name=file.name,
            path=folder,
            camera=camera,
            odometry=odometry,
            frames=frames,
            named=landmarks,
            start=start_from_file(file.start, first_ns) if file.start else None,
            groundtruth=part("groundtruth", read_poses),
            settings=(VISION_ALONE if odometry is NO_ODOMETRY else {})
            | {f"motion.{name}": value for name, value in (file.motion or {}).items()},
        )
        if landmark_map := part("map", read_map):
            log = replace(log.identified_on(landmark_map), landmark_map=landmark_map)
        return require_overlap(log)


def _images(path: Path, folder: Path, camera: Camera) -> list[ImageEvent]:
    table = read_table(path, (Column("t_ns", integer), Column("file", text), *MOUNT_COLUMNS), rows_at_least=1)
    table.require_time_order(strictly=True)
    size, mounts = (camera.width, camera.height), mounts_of_table(table, camera.mount)
    events: list[ImageEvent] = []
    for row, (t_ns, name) in enumerate(zip(table.columns["t_ns"], table.columns["file"], strict=True)):
        try:
            image = inside(folder, name)
        except ValueError as error:
            raise table.error(row, "file", f"{error}, found {name!r}") from None
        here = _named_by(path, table.lines[row])
        turned = here(check_head)(image, size)
        if turned and not events:  # as are those that follow
            warn_turned(turned, image)
        event = image_event(t_ns, name, partial(whole_image, image, size), size, path=image, mount=mounts[row])
        events.append(replace(event, load=here(event.load), encoded=here(event.encoded)))
    return events


@contextmanager
def _named_by(table: Path, line: int) -> Iterator[None]:
    """Say of an image that is not what it should be which line of the table names it."""
    try:
        yield
    except InputError as error:
        raise InputError(str(error), path=table, line=line, field="file") from error


def start_from_file(file: StartFile, t_ns: int) -> Start:
    """Return the start that a file states, at the time of the log's first event."""
    mean = np.array([file.x, file.z, math.radians(file.heading_deg)])
    sigma = np.array([file.sigma_m, file.sigma_m, math.radians(file.sigma_deg)])
    return Start(t_ns, mean, np.diag(sigma**2))


def start_data(start: Start) -> dict[str, float]:
    """Return a start as plain data, as a file has it: one sigma for the position and one for the heading."""
    x, z, heading = (float(value) for value in start.mean)
    sigma_m = float(np.sqrt((start.cov[0, 0] + start.cov[1, 1]) / 2))
    sigma_deg = degrees(float(np.sqrt(start.cov[2, 2])))
    return {"x": x, "z": z, "heading_deg": degrees(heading), "sigma_m": sigma_m, "sigma_deg": sigma_deg}


# -- writing ----------------------------------------------------------------------------------------------------------


def write_log(
    folder: Path,
    *,
    name: str,
    camera: Camera,
    odometry: Trajectory,
    images: Iterable[tuple[int, Image | bytes]] | None = None,
    mounts: Sequence[Mount | None] = (),
    sightings: Iterable[Sighting] | None = None,
    landmark_map: LandmarkMap | None = None,
    landmark_ids: Sequence[int | str] = (),
    groundtruth: Trajectory | None = None,
    start: Start | None = None,
    motion: Mapping[str, Any] | None = None,
) -> None:
    """Write a log folder, either whole or not at all; images or sightings, in the order of time, are taken one by one.

    images: (t_ns, (H, W) grey or (H, W, 3) BGR uint8); JPEG or PNG files are written as they are. mounts:
    of the camera at each image, None where it is as the camera says; left out where it always is. start: the covariance
    is written as one sigma for the position and one for the heading. motion: quality of this robot's odometry.
    landmark_ids: of the landmarks that edges belong to, where there is no map.
    Raises OutputError when the folder holds something already or cannot be written, ValueError unless there are images
    or sightings, not both.
    """
    if (images is None) == (sightings is None):
        raise ValueError("expected images or sightings")
    require_new(folder)
    data: dict[str, Any] = {"format": FORMAT, "name": name}

    def part(key: str, file: str, write: Callable[[Part, Path], None], value: Part | None) -> None:
        if value is not None:
            data[key] = file
            write(value, draft / file)

    with drafted(folder) as draft:
        draft.mkdir()
        part("camera", "camera.yaml", write_camera, camera)
        part("odometry", "odometry.csv", write_poses, odometry if len(odometry) else None)
        part("groundtruth", "groundtruth.csv", write_poses, groundtruth)
        part("map", "map.yaml", write_map, landmark_map)
        of_mounts = mount_cells(mounts, camera.mount)
        part(
            "images",
            "images.csv",
            lambda images, path: _write_images(images, of_mounts, path),
            images,
        )
        ids = landmark_ids if landmark_map is None else landmark_map.ids
        part("edges", "edges.csv", lambda frames, path: write_edges(frames, camera, path, ids), sightings)
        if start is not None:
            data["start"] = start_data(start)
        if motion:
            data["motion"] = dict(motion)
        write_text(draft / LOG_FILE, dump(data))


def _write_images(
    images: Iterable[tuple[int, Image | bytes]], of_mounts: Mapping[str, Sequence[str]], table: Path
) -> None:
    """Write the images and their table. of_mounts: the columns that say how the camera was mounted."""
    lines = [",".join(["t_ns", "file", *of_mounts])]
    for index, (t_ns, image) in enumerate(images):
        data = image if isinstance(image, bytes) else encode_image(image, ".jpg", 90)
        name = f"images/{index:06d}{suffix_of(data)}"
        write_bytes(table.parent / name, data)
        lines.append(",".join([str(t_ns), name, *(column[index] for column in of_mounts.values())]))
    write_text(table, "\n".join(lines) + "\n")


# -- the mount of each image, as columns of images.csv; an empty cell where it is as usual ----------------------------


SIGMA = "_sigma"
_FIELDS = {f"{name}_deg": f"{name}_rad" for name in ("tilt", "roll", "yaw")}
_FIELDS |= {name: name for name in ("height_m", "right_m", "back_m")}
"""Columns, and the fields of a mount that they state; the sigma of each has a column that ends in `SIGMA`."""


def _within(expected: str, is_right: Callable[[float], bool], cell: str) -> float:
    """Return the number in a cell, nan for an empty cell. Raises ValueError, with what was expected."""
    value = number_or_unknown(cell)
    if not (math.isnan(value) or is_right(value)):
        raise ValueError(expected)
    return value


_READERS = {
    "_deg": partial(_within, "an angle within ±180 degrees", lambda value: abs(value) <= 180),
    "_m": partial(_within, "a length within ±100 m", lambda value: abs(value) <= 100),
    f"_deg{SIGMA}": partial(_within, "a sigma from 0 to 45 degrees", lambda value: 0 <= value <= 45),
    f"_m{SIGMA}": partial(_within, "a sigma from 0 to 10 m", lambda value: 0 <= value <= 10),
    "tilt_deg": partial(_within, "an angle above -90 and below 90 degrees", lambda value: -90 < value < 90),
    "height_m": partial(_within, "a height above 0 and at most 100 m", lambda value: 0 < value <= 100),
}
"""What reads a column: by its whole name, else by how the name ends."""
_NAMES = [name + ending for name in _FIELDS for ending in ("", SIGMA)]
MOUNT_COLUMNS = tuple(
    Column(name, _READERS.get(name) or _READERS[name[name.index("_") :]], required=False) for name in _NAMES
)


def mounts_of_table(table: Table, usual: Mount) -> list[Mount | None]:
    """Return the mount of each row (R); None where all its cells are empty. usual: what an empty cell means."""
    mounts: list[Mount | None] = []
    for row in range(len(table)):
        cells = {name: column[row] for name in _NAMES if (column := table.columns.get(name))}
        known = {
            name: math.radians(value) if "_deg" in name else value
            for name, value in cells.items()
            if not math.isnan(value)
        }
        values = {field: known[name] for name, field in _FIELDS.items() if name in known}
        sigmas = {field: known[name + SIGMA] for name, field in _FIELDS.items() if name + SIGMA in known}
        sigma = MountSigma(**sigmas) if sigmas else None
        mounts.append(replace(usual, **values, sigma=sigma) if known else None)
    return mounts


def mount_cells(mounts: Sequence[Mount | None], usual: Mount) -> dict[str, list[str]]:
    """Return the columns that say how the camera was mounted at each image, without those that would say nothing.

    mounts: of the images; None: as usual.
    """
    columns: dict[str, list[float | None]] = {}
    for name, field in _FIELDS.items():
        values = [None if mount is None else getattr(mount, field) for mount in mounts]
        sigmas = [None if mount is None or mount.sigma is None else getattr(mount.sigma, field) for mount in mounts]
        if any(value is not None and value != getattr(usual, field) for value in values):
            columns[name] = values
        if any(sigma is not None for sigma in sigmas):
            columns[name + SIGMA] = sigmas

    def cell(name: str, value: float | None) -> str:
        return "" if value is None else repr(degrees(value) if "_deg" in name else float(value))

    return {name: [cell(name, value) for value in column] for name, column in columns.items()}
