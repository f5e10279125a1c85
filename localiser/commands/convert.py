"""`localiser convert`: logs from one format to another."""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from localiser.commands.options import BagCamera, Topics, is_quiet, progress, topics_by_role
from localiser.errors import InputError

if TYPE_CHECKING:
    from localiser.storage import Log

EPILOG = """Examples:

`localiser convert drive.bag logs/drive`

`localiser convert drive_bag logs/drive --topic odometry=/wheel/odom --camera camera.yaml`

`localiser convert logs/corridor corridor.mcap`

`localiser convert logs/corridor corridor.db3`

`localiser convert drive.mp4 logs/drive --odometry odometry.csv --camera camera.yaml --every 0.2s`"""
FOLDER = "folder"


def convert(
    source: Annotated[Path, typer.Argument(metavar="LOG", help="ROS bag (ROS 1, ROS 2), log folder, video file.")],
    out: Annotated[
        Path, typer.Argument(metavar="OUT", help="New log folder; a new bag where it ends in .mcap, .db3 or .bag.")
    ],
    topics: Topics = None,
    camera: BagCamera = None,
    odometry: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Odometry of a video: CSV t,x,y,yaw or t_ns,x,z,heading, or TUM."),
    ] = None,
    start_ns: Annotated[
        int | None,
        typer.Option(
            metavar="N",
            help="When a video's first frame was taken, by the odometry's clock; by default with its first pose.",
        ),
    ] = None,
    every: Annotated[
        str | None, typer.Option(metavar="SECONDS", help="Keep an image each such time only, such as 0.2s.")
    ] = None,
) -> None:
    """Turn a recorded LOG into another format: ROS bag to log folder, log folder to ROS bag, bag to bag.

    Images are copied as they are, poses to a billionth of a metre. A video becomes a log with --camera and, where
    there is any, --odometry; without it a replay takes the motion from the images. The log gets the name of OUT.
    """
    from localiser.documents import plain_name
    from localiser.storage import is_video, open_log, read_video, thinned, write_bag
    from localiser.storage.bags import FILE_KINDS

    every_s = None if every is None else _seconds(every)
    if odometry is not None or is_video(source):
        if camera is None:
            raise InputError("missing: a video needs --camera FILE, what took it", path=source, field="--camera")
        if topics:
            raise InputError("is for ROS bags, found a video", path=source, field="--topic")
        log = read_video(source, odometry, camera, start_ns)
    elif start_ns is not None:
        raise InputError("is for a video", field="--start-ns")
    else:
        log = open_log(source, topics=topics_by_role(topics), camera=camera)
    target = FILE_KINDS.get(out.suffix, FOLDER)
    path = Path(os.path.realpath(out))
    log = replace(log, name=plain_name(path.name if target == FOLDER else path.stem))
    if every_s is not None:
        log = thinned(log, every_s)
    with progress("Converting", len(log.frames)) as advance:
        if target == FOLDER:
            to_folder(log, out, advance)
        else:
            write_bag(out, log, target, advance)
    if not is_quiet():
        typer.echo(f"{len(log.frames)} frames and {len(log.odometry)} odometry poses in {out} ({target})")


def _seconds(text: str) -> float:
    """Return the seconds of `0.2s` or `0.2`. Raises InputError."""
    found = re.fullmatch(r"(\d{1,6}(?:\.\d{1,9})?|\.\d{1,9})\s*s?", text.strip(), re.ASCII)
    if found is None or float(found[1]) == 0:
        raise InputError(f"expected seconds above 0, such as 0.2s, found {text!r}", field="--every")
    return float(found[1])


def to_folder(log: Log, out: Path, advance: Callable[[], None] = lambda: None) -> None:
    """Write a log folder; image files are copied as they are."""
    from localiser.filter import Sighting
    from localiser.storage import motion_settings, write_log

    def images() -> Iterator[tuple[int, bytes]]:
        for image in log.images:
            yield image.t_ns, image.encoded()
            advance()

    write_log(
        out,
        name=log.name,
        camera=log.camera,
        odometry=log.odometry,
        images=images() if log.has_images else None,
        mounts=[image.mount for image in log.images],
        sightings=None if log.has_images else [frame for frame in log.frames if isinstance(frame, Sighting)],
        landmark_map=log.landmark_map,
        landmark_ids=log.landmark_ids,
        groundtruth=log.groundtruth,
        start=log.start,
        motion=motion_settings(log),
    )
