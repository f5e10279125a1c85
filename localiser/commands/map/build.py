"""`localiser map build`: a landmark map from a log."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from localiser.commands.map.options import NewMap, require_writable
from localiser.commands.options import (
    BagCamera,
    ConfigFile,
    LogFormat,
    Overrides,
    Quiet,
    Topics,
    opened,
    progress,
    show,
    topics_by_role,
)
from localiser.errors import InputError

if TYPE_CHECKING:
    from localiser.config import Config
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
            help="Log folder, ROS bag, or FOLDER:N of the UTIAS MRCLAM data set. Several make one map, by their truth.",
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
    log_format: LogFormat = None,
    topics: Topics = None,
    camera: BagCamera = None,
    force: Annotated[bool, typer.Option("--force", help="Overwrite an existing map.")] = False,
    quiet: Quiet = False,
) -> None:
    """Build a map of the vertical edges that a LOG shows, or several, with what is known of each."""
    from dataclasses import replace
    from functools import partial

    from localiser.commands.map.watch import MapWatch
    from localiser.mapping import build_map, cache_folder
    from localiser.storage import jump_text, write_map, write_tum

    require_writable(out, trajectory, rrd, overwrite=force)
    if len(logs) > 1:
        _require_truth_only(poses, {"--trajectory": trajectory, "--rrd": rrd, "--view": view != "none"})
        opening = partial(opened, format=log_format, topics=topics_by_role(topics), camera=camera)
        _build_together([opening(log, config, [*(overrides or [])]) for log in logs], out, quiet)
        return
    recorded, settings = opened(
        logs[0], config, [*(overrides or [])], format=log_format, topics=topics_by_role(topics), camera=camera
    )
    track, source = poses_named(poses)
    with MapWatch(recorded, settings.mapping, rrd, view) as watch:
        with progress("Finding edges", len(recorded.frames), quiet) as advance:
            try:
                built = build_map(
                    recorded, track, settings, progress=advance, watch=watch, cache=cache_folder(), source=source
                )
            except InputError:
                with suppress(InputError):  # the images themselves may be at fault
                    _warn(_clock_warning(recorded, settings))
                raise
        _warn(_mount_warning(recorded, settings, built))
        _warn(_clock_warning(recorded, settings))
        if poses != "truth":
            _warn(jump_text(recorded) or None)
        header: dict[str, object] = {"built_from_frames": len(built.trajectory)}
        write_map(replace(built.landmark_map, header=header), out)
    if trajectory is not None:
        write_tum(built.trajectory, trajectory)
    if not quiet:
        _show_built(built, out)
    if watch.viewer is not None:
        _stay(watch.viewer)


def _warn(text: str | None) -> None:
    if text is not None:
        typer.secho(text, fg="yellow", err=True)


def _mount_warning(log: Log, config: Config, built: MapBuilt) -> str | None:
    """Return the warning that the edges contradict the stated tilt and roll, with which the map was made."""
    from localiser.calibration import check_mount
    from localiser.mapping import cache_folder, edges_of_log

    if not log.has_images:
        return None
    edges = edges_of_log(log, config.edges, cache=cache_folder())  # kept by the build
    poses = built.trajectory.sampled([frame.t_ns for frame in log.frames]).poses
    return check_mount(edges, poses, log.camera, config.edges.mount_sigma_rad).warning(log.path)


def _clock_warning(log: Log, config: Config) -> str | None:
    """Return the warning that images and wheels were stamped by clocks that differ, which also explains a failure."""
    from localiser.calibration import clock_offset
    from localiser.mapping import cache_folder, edges_of_log

    if not log.has_images:
        return None
    edges = edges_of_log(log, config.edges, cache=cache_folder())  # kept by the build
    times = [frame.t_ns for frame in log.frames]
    return clock_offset(times, edges.__getitem__, log.odometry, log.camera).warning(log.path)


def poses_named(poses: str) -> tuple[str | Trajectory, str]:
    """Return what `--poses` names, a word or the trajectory of a file, and what to call it. Raises InputError."""
    from localiser.storage import read_poses, read_tum

    path = Path(poses)
    if poses in ("truth", "odometry", "slam") or not path.exists():
        return poses, poses
    return read_poses(path) if path.suffix == ".csv" else read_tum(path), path.name


def _require_truth_only(poses: str, options: dict[str, object]) -> None:
    """Raise InputError for what several logs cannot be built with."""
    from localiser.errors import InputError

    if poses != "truth":
        raise InputError(
            f"expected truth for several logs, which must share one frame, found {poses!r}", field="--poses"
        )
    for name, value in options.items():
        if value:
            raise InputError("expected one log with this option, found several", field=name)


def _build_together(opened_logs: list[tuple[Log, Config]], out: Path, quiet: bool) -> None:
    """Build one map of several logs, by their true poses and the settings of the first."""
    from dataclasses import replace

    from localiser.mapping import build_map_together, cache_folder
    from localiser.storage import write_map

    logs = [log for log, _ in opened_logs]
    with progress("Finding edges", sum(len(log.frames) for log in logs), quiet) as advance:
        built = build_map_together(logs, opened_logs[0][1], progress=advance, cache=cache_folder())
    header: dict[str, object] = {"built_from_frames": built.sightings.frames}
    write_map(replace(built.landmark_map, header=header), out)
    if not quiet:
        _show_built(built, out)


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
