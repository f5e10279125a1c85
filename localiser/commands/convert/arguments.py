"""`localiser convert`: logs from one format to another."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from localiser.commands.options import BagCamera, Quiet, Topics, progress, topics_by_role
from localiser.errors import InputError

EPILOG = """Examples:

`localiser convert drive.bag logs/drive`

`localiser convert drive_bag logs/drive --topic odometry=/wheel/odom --camera camera.yaml`

`localiser convert logs/corridor corridor.mcap`

`localiser convert logs/corridor corridor_bag --to sqlite3`

`localiser convert drive.mp4 logs/drive --odometry odometry.csv --camera camera.yaml`"""


def convert(
    source: Annotated[Path, typer.Argument(metavar="LOG", help="ROS bag (ROS 1, ROS 2), log folder, video file.")],
    out: Annotated[Path, typer.Argument(metavar="OUT", help="New log folder, or new bag.")],
    to: Annotated[
        str | None,
        typer.Option(
            metavar="folder|mcap|sqlite3|ros1",
            help="What OUT becomes; by default what its ending says (.mcap, .db3, .bag), else a folder from a bag and "
            "MCAP from a folder.",
        ),
    ] = None,
    topics: Topics = None,
    camera: BagCamera = None,
    odometry: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Odometry of a video: CSV t_ns,x,z,heading.")
    ] = None,
    start_ns: Annotated[
        int | None,
        typer.Option(
            metavar="N",
            help="When a video's first frame was taken, by the odometry's clock; by default with its first pose.",
        ),
    ] = None,
    quiet: Quiet = False,
) -> None:
    """Turn a recorded LOG into another format: ROS bag to log folder, log folder to ROS bag, bag to bag.

    Images are copied as they are, poses to a billionth of a metre. A video becomes a log with --odometry and --camera.
    """
    from localiser.commands.convert import steps as conversion
    from localiser.storage import open_log, read_video

    if odometry is not None:
        if camera is None or topics:
            raise InputError("expected a video with --camera FILE and without --topic", field="--odometry")
        log = read_video(source, odometry, camera, start_ns)
    elif start_ns is not None:
        raise InputError("is for a video with --odometry FILE", field="--start-ns")
    else:
        log = open_log(source, topics=topics_by_role(topics), camera=camera)
    target = conversion.target_of(out, log, to)
    with progress("Converting", len(log.frames), quiet) as advance:
        conversion.convert(log, out, target, advance)
    if not quiet:
        typer.echo(f"{len(log.frames)} frames and {len(log.odometry)} odometry poses in {out} ({target})")
