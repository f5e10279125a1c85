"""`localiser map check`: how good a map is."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from localiser.commands.map.edit_arguments import Force, MapFile
from localiser.commands.options import ConfigFile, Overrides, Quiet, opened, progress, show


def check(
    map_file: MapFile,
    log: Annotated[
        Path | None, typer.Option(metavar="LOG", help="See how its edges fit; its camera looks round.")
    ] = None,
    poses: Annotated[
        str, typer.Option(metavar="truth|FILE|odometry", help="Where the robot was, as for `map build`.")
    ] = "truth",
    camera_file: Annotated[
        Path | None, typer.Option("--camera", metavar="FILE", help="The camera that looks round, without a log.")
    ] = None,
    out: Annotated[
        Path | None, typer.Option("--out", "-o", metavar="PNG", help="The picture; by default MAP_coverage.png.")
    ] = None,
    rrd: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Write the same for Rerun: what looks like what, what helps.")
    ] = None,
    config: ConfigFile = None,
    overrides: Overrides = None,
    force: Force = False,
    quiet: Quiet = False,
) -> None:
    """Tell what looks wrong with a MAP, how it fits a log, where too little is in view, or looks like elsewhere."""
    from localiser.commands.map import build as map_build
    from localiser.commands.map import check as map_check
    from localiser.commands.map import lookalikes as map_alike
    from localiser.storage import load_camera, load_map

    picture = out or map_file.with_name(f"{map_file.stem}_coverage.png")
    landmark_map = load_map(map_file)
    recorded, effective = opened(log, config, [*(overrides or [])]) if log else (None, None)
    camera = recorded.camera if recorded else load_camera(camera_file) if camera_file else None
    for file in (picture, rrd):
        if camera is not None and file is not None:
            map_build.require_writable(file, overwrite=force)
    fit = None
    if recorded is not None and effective is not None:
        with progress("Finding edges", len(recorded.frames), quiet) as advance:
            fit = map_check.fit_to_log(landmark_map, recorded, poses, effective, advance)
    show(map_check.suspects(landmark_map, fit))
    if fit is not None:
        typer.echo(map_check.fit_text(fit))
    if camera is None:
        typer.echo("What is in view from where depends on the camera: --log LOG or --camera FILE shows it.")
        return
    path = map_build.known_poses(recorded, poses).poses if recorded else None
    found, look = map_check.coverage(landmark_map, camera), map_alike.lookalikes(landmark_map, camera, path)
    map_check.save_picture(landmark_map, found, look, picture)
    if rrd is not None:
        from localiser.view import record_lookalikes

        record_lookalikes(rrd, camera, landmark_map, look.places, look.share, look.examples(), look.spots_at)
    typer.echo(map_check.coverage_text(found))
    typer.echo(map_alike.lookalikes_text(look))
    typer.echo(f"Picture in {picture}")
