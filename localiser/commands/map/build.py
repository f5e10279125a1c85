"""`localiser map build`: a landmark map from a log."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from localiser.commands.map.options import NewMap, require_writable
from localiser.commands.options import (
    BagCamera,
    ConfigFile,
    Overrides,
    Topics,
    is_quiet,
    open_with_settings,
    progress,
    show,
    topics_by_role,
)
from localiser.errors import InputError

if TYPE_CHECKING:
    from localiser.config import Config
    from localiser.edges import Edges
    from localiser.geometry import Trajectory
    from localiser.mapping import MapBuilt
    from localiser.storage import Log
    from localiser.view import MapView

EXAMPLES = """Examples:

`localiser map build logs/corridor --poses truth -o maps/mine.yaml`

`localiser map build logs/corridor --poses slam -o maps/mine.yaml --trajectory mine.tum --view web`

`localiser map build monday tuesday --poses truth -o maps/mine.yaml`

`localiser map build logs/corridor --poses mine.tum -o maps/mine.yaml --set mapping.parallax_min_deg=8`"""


def build(
    logs: Annotated[
        list[Path],
        typer.Argument(
            metavar="LOG…",
            help="Log folder or ROS bag. Several make one map, by their truth.",
        ),
    ],
    out: NewMap,
    poses: Annotated[
        str,
        typer.Option(
            metavar="truth|FILE|odometry|slam",
            help="Where the robot was: the log's truth, a trajectory (TUM, or CSV t_ns,x,z,heading), or its odometry; "
            "`slam` finds it out along with the map.",
        ),
    ] = "truth",
    trajectory: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Write where the robot was at each image (TUM).")
    ] = None,
    rrd: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Record for Rerun how the map grew: images, landmarks, path.")
    ] = None,
    view: Annotated[
        str, typer.Option(metavar="native|web|IP:PORT|none", help="Watch the map grow in Rerun, as edges are found.")
    ] = "none",
    config: ConfigFile = None,
    overrides: Overrides = None,
    topics: Topics = None,
    camera: BagCamera = None,
    force: Annotated[bool, typer.Option("--force", help="Overwrite an existing map.")] = False,
) -> None:
    """Build a map of the vertical edges that a LOG shows, or several, with what is known of each."""
    from dataclasses import replace

    from localiser.commands.map.watch import MapWatch
    from localiser.mapping import build_map, cache_folder, edges_of_log
    from localiser.storage import jump_text, write_map, write_tum

    require_writable(out, trajectory, rrd, overwrite=force)
    if len(logs) > 1:
        for name, value in {"--trajectory": trajectory, "--rrd": rrd, "--view": view != "none"}.items():
            if value:
                raise InputError("expected one log with this option, found several", field=name)
    read = [
        open_with_settings(log, config, [*(overrides or [])], topics=topics_by_role(topics), camera=camera)
        for log in logs
    ]
    recorded, settings = [log for log, _ in read], read[0][1]
    track, source = poses_named(poses)
    with MapWatch(recorded[0], settings.mapping, rrd, view) as watch:
        with progress("Finding edges", sum(len(log.frames) for log in recorded)) as advance:
            try:
                built = build_map(
                    recorded,
                    track,
                    settings,
                    progress=advance,
                    watch=watch if len(logs) == 1 else None,
                    cache=cache_folder(),
                    source=source,
                )
            except InputError:
                with suppress(InputError):  # the images themselves may be at fault
                    for log in recorded:
                        if log.has_images:
                            _warn(_clock_warning(log, edges_of_log(log, settings.edges, cache=cache_folder())))
                raise
        if len(logs) == 1 and recorded[0].has_images:
            _warn(_mount_warning(recorded[0], settings, built))
        for log, edges in zip(recorded, built.edges, strict=True):
            if log.has_images:
                _warn(_clock_warning(log, edges))
            _warn(jump_text(log) if poses != "truth" else None)
        frames = built.sightings.frames if len(logs) > 1 else len(built.trajectory)
        header: dict[str, object] = {"built_from_frames": frames}
        write_map(replace(built.landmark_map, header=header), out)
    if trajectory is not None:
        write_tum(built.trajectory, trajectory)
    if not is_quiet():
        _show_built(built, out)
    if watch.viewer is not None:
        _stay(watch.viewer)


def _warn(text: str | None) -> None:
    if text:
        typer.secho(text, fg="yellow", err=True)


def _mount_warning(log: Log, config: Config, built: MapBuilt) -> str | None:
    """Return the warning that the edges contradict the stated tilt and roll, with which the map was made."""
    from localiser.calibration import check_mount

    poses = built.trajectory.sampled([frame.t_ns for frame in log.frames]).poses
    return check_mount(built.edges[0], poses, log.camera, config.edges.mount_sigma_rad).warning(log.path)


def _clock_warning(log: Log, edges: Sequence[Edges]) -> str | None:
    """Return the warning that images and wheels were stamped by clocks that differ, which also explains a failure."""
    from localiser.calibration import clock_offset

    times = [frame.t_ns for frame in log.frames]
    return clock_offset(times, edges.__getitem__, log.odometry, log.camera).warning(log.path)


def poses_named(poses: str) -> tuple[str | Trajectory, str]:
    """Return what `--poses` names, a word or the trajectory of a file, and what to call it. Raises InputError."""
    from localiser.storage import read_poses, read_tum

    path = Path(poses)
    if poses in ("truth", "odometry", "slam") or not path.exists():
        return poses, poses
    return read_poses(path) if path.suffix == ".csv" else read_tum(path), path.name


def _stay(viewer: MapView) -> None:
    """Keep a page served until the user has seen enough; say so where there was no viewer to be had."""
    if not viewer.is_running:
        text = "The viewer was closed or could not start (is there a display?); the map was built without it."
        typer.secho(text, fg="yellow", err=True)
    elif viewer.address:
        typer.echo("The page is served until Ctrl-C.", err=True)
        viewer.wait()


def _show_built(built: MapBuilt, out: Path) -> None:
    from localiser.commands.map.show import summary_table

    show(summary_table(built.landmark_map))
    if built.slam is not None:
        typer.echo(built.slam.text())
    typer.echo(f"{len(built.landmark_map)} landmarks in {out}; `localiser map show {out}` draws them.")
