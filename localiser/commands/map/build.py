"""`localiser map build`: a landmark map from a log."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from localiser.commands.map.options import NewMap, edges_with_progress, parse_poses, summary_table
from localiser.commands.options import (
    BagCamera,
    ConfigFile,
    Overrides,
    Topics,
    is_quiet,
    open_with_settings,
    show,
    warn,
)
from localiser.errors import InputError

if TYPE_CHECKING:
    from localiser.config import Config
    from localiser.mapping import MapBuilt
    from localiser.storage import Log

EXAMPLES = """Examples:

`localiser map build logs/corridor -o mine.yaml`

`localiser map build logs/corridor --poses slam -o mine.yaml --trajectory path.tum`

`localiser map build monday tuesday -o mine.yaml`

`localiser map build logs/corridor --poses mine.tum -o mine.yaml --set mapping.parallax_min_deg=8`"""


def build(
    logs: Annotated[
        list[Path], typer.Argument(metavar="LOG…", help="Log folder or ROS bag. Several make one map, by their truth.")
    ],
    out: NewMap,
    poses: Annotated[
        str | None,
        typer.Option(
            metavar="truth|FILE|odometry|slam",
            help="Where the robot was: the log's truth, a trajectory (TUM, or CSV t_ns,x,z,heading), or its odometry; "
            "`slam` finds it out along with the map. By default the truth, and `slam` without one.",
        ),
    ] = None,
    trajectory: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Write where the robot was at each image (TUM).")
    ] = None,
    config: ConfigFile = None,
    overrides: Overrides = None,
    topics: Topics = None,
    camera: BagCamera = None,
) -> None:
    """Build a map of the vertical edges that a LOG shows, or several, with what is known of each."""
    from localiser.mapping import build_map, default_poses
    from localiser.storage import jump_text, require_new_file, write_map, write_tum

    for path in (out, trajectory):
        if path is not None:
            require_new_file(path)
    if trajectory is not None and trajectory.resolve() == out.resolve():
        raise InputError("expected another file than that of the map, found the same", path=out, field="--trajectory")
    if len(logs) > 1 and trajectory is not None:
        raise InputError("expected one log with this option, found several", field="--trajectory")
    read = [open_with_settings(log, config, overrides, topics, camera) for log in logs]
    recorded, settings = [log for log, _ in read], read[0][1]
    named = poses or default_poses(recorded)
    if poses is None and named == "slam" and not is_quiet():
        typer.echo(f"{logs[0]} has no truth: where the robot was is found from the log alone, along with the map.")
    track, source = parse_poses(named)
    built = build_map(recorded, track, settings, edges_of=lambda log: edges_with_progress(log, settings), source=source)
    for log in recorded:
        if log.has_images and len(logs) == 1:
            warn(_mount_warning(log, settings, built))
        warn(jump_text(log) if named != "truth" else None)
    write_map(built.landmark_map, out)
    if trajectory is not None:
        write_tum(built.trajectory, trajectory)
    if not is_quiet():
        show(summary_table(built.landmark_map))
        if built.slam is not None:
            typer.echo(built.slam.text())
        typer.echo(f"{len(built.landmark_map)} landmarks in {out}; `localiser map show {out}` draws them.")


def _mount_warning(log: Log, config: Config, built: MapBuilt) -> str | None:
    """Return the warning that the edges contradict the stated tilt and roll, with which the map was made."""
    from localiser.calibration import check_mount

    poses = built.trajectory.sampled([frame.t_ns for frame in log.frames]).poses
    return check_mount(built.edges[0].__getitem__, poses, log.camera, config.edges.mount_sigma_rad).warning(log.path)
