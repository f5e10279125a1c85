"""`localiser map`: build maps, look at them, check and mend them."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from localiser.commands.map import check_arguments as map_check
from localiser.commands.map import edit_arguments as map_edit
from localiser.commands.map import update_arguments as map_update
from localiser.commands.options import (
    BagCamera,
    ConfigFile,
    Overrides,
    Quiet,
    Topics,
    opened,
    progress,
    show,
    topics_by_role,
)

if TYPE_CHECKING:
    from localiser.commands.map.build import MapBuilt
    from localiser.view import MapView

map_app = typer.Typer(
    no_args_is_help=True, rich_markup_mode="markdown", help="Build landmark maps, check and mend them."
)

MapOut = Annotated[Path, typer.Option("--out", "-o", metavar="MAP", help="The map file to write.")]


@map_app.command(
    epilog="""Examples:

`localiser map build logs/corridor --poses truth -o maps/mine.yaml`

`localiser map build logs/corridor --poses slam -o maps/mine.yaml --trajectory mine.tum --view web`

`localiser map build logs/corridor --poses mine.tum -o maps/mine.yaml --set mapping.parallax_min_deg=8`"""
)
def build(
    log: Annotated[
        Path, typer.Argument(metavar="LOG", help="Log folder, ROS bag, or FOLDER:N of the UTIAS MRCLAM data set.")
    ],
    out: Annotated[Path, typer.Option("--out", "-o", metavar="MAP", help="The map file to write.")],
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
    log_format: Annotated[
        str | None, typer.Option("--format", metavar="FORMAT", help="folder, bag or mrclam; by default found out.")
    ] = None,
    topics: Topics = None,
    camera: BagCamera = None,
    force: Annotated[bool, typer.Option("--force", help="Overwrite an existing map.")] = False,
    quiet: Quiet = False,
) -> None:
    """Build a map of the vertical edges that a LOG shows, with what is known of each."""
    from localiser.commands.map import build as map_build
    from localiser.commands.map import watch as map_watch
    from localiser.storage import save_tum

    for file in (out, trajectory, rrd):
        if file is not None:
            map_build.require_writable(file, overwrite=force)
    recorded, effective = opened(
        log, config, [*(overrides or [])], format=log_format, topics=topics_by_role(topics), camera=camera
    )
    with map_watch.watching(rrd, view, lambda address: typer.echo(f"Watch at {address}", err=True)) as watch:
        with progress("Finding edges", len(recorded.frames), quiet) as advance:
            built = map_build.build_map(recorded, poses, effective, advance, watch)
        map_build.save(built, out, overwrite=force)
    if trajectory is not None:
        save_tum(built.trajectory, trajectory)
    if not quiet:
        _show_built(built, out)
    if watch.viewer is not None:
        _stay(watch.viewer)


def _stay(viewer: MapView) -> None:
    """Keep a page served until the user has seen enough; say so where there was no viewer to be had."""
    if not viewer.is_running:
        text = "The viewer was closed or could not start (is there a display?); the map was built without it."
        typer.secho(text, fg="yellow", err=True)
    elif viewer.address:
        typer.echo("The page is served until Ctrl-C.", err=True)
        viewer.wait()


def _show_built(built: MapBuilt, out: Path) -> None:
    from localiser.commands.map.show import findings, summary_table

    show(summary_table(built.landmark_map))
    if built.slam is not None:
        for line in findings(built):
            typer.echo(line)
    typer.echo(f"{len(built.landmark_map)} landmarks in {out}; `localiser map show {out}` draws them.")


@map_app.command("show", epilog="Example: `localiser map show maps/corridor.yaml -o corridor.png --rrd corridor.rrd`")
def show_map(
    map_file: map_edit.MapFile,
    out: Annotated[
        Path | None, typer.Option("--out", "-o", metavar="PNG", help="The picture; by default MAP.png beside the map.")
    ] = None,
    rrd: Annotated[Path | None, typer.Option(metavar="FILE", help="Write the same for Rerun.")] = None,
    force: Annotated[bool, typer.Option("--force", help="Overwrite an existing picture.")] = False,
    quiet: Quiet = False,
) -> None:
    """Draw a MAP from above, with the certainty of every landmark, and print what is known of them."""
    from localiser.commands.map import show as map_show
    from localiser.commands.map.build import require_writable
    from localiser.storage import load_map

    landmark_map = load_map(map_file)
    picture = out or map_file.with_suffix(".png")
    for file in (picture, rrd):
        if file is not None:
            require_writable(file, overwrite=force)
    map_show.save_picture(landmark_map, picture)
    if rrd is not None:
        from localiser.view import record_map

        record_map(rrd, landmark_map)
    if not quiet:
        show(map_show.summary_table(landmark_map))
        typer.echo(f"Picture in {picture}")


@map_app.command("plan", epilog="Example: `localiser map plan building.yaml -o maps/building.yaml`")
def plan_map(
    plan: Annotated[Path, typer.Argument(metavar="PLAN", help="Floor plan: YAML of ROS map_server, PGM or PNG.")],
    out: MapOut,
    force: map_edit.Force = False,
    quiet: Quiet = False,
) -> None:
    """Turn the corners of walls, jambs and pillars of a floor PLAN into landmarks."""
    from localiser.commands.map.build import require_writable
    from localiser.commands.map.plan import map_of_plan
    from localiser.storage import save_map

    require_writable(out, overwrite=force)
    landmark_map, drawn = map_of_plan(plan)
    save_map(landmark_map, out)
    if not quiet:
        rows, columns = drawn.shape
        typer.echo(
            f"{len(landmark_map)} landmarks in {out}, from a plan of {columns * drawn.resolution_m:.1f} m × "
            f"{rows * drawn.resolution_m:.1f} m; `localiser map show {out}` draws them."
        )


@map_app.command("draw", epilog="Example: `localiser map draw configs/worlds/office.yaml -o office_plan.yaml`")
def draw(
    world: Annotated[Path, typer.Argument(metavar="WORLD", help="World file, such as configs/worlds/corridor.yaml.")],
    out: Annotated[Path, typer.Option("--out", "-o", metavar="PLAN", help="The plan: this YAML and a PGM beside it.")],
    resolution: Annotated[float, typer.Option(min=1e-3, max=1.0, metavar="M", help="Side of a cell.")] = 0.05,
    yaw_deg: Annotated[float, typer.Option(metavar="DEG", help="Turn of the grid, anticlockwise from ROS x.")] = 0.0,
    furniture: Annotated[bool, typer.Option("--furniture", help="Draw furniture, too.")] = False,
    force: map_edit.Force = False,
    quiet: Quiet = False,
) -> None:
    """Draw the floor plan of a simulated WORLD for ROS map_server: walls, open doorways and pillars."""
    import math

    from localiser.commands.map import draw as map_draw
    from localiser.commands.map.build import require_writable
    from localiser.storage import plan_picture, save_plan

    for file in (out, plan_picture(out)):
        require_writable(file, overwrite=force)
    plan = map_draw.draw_plan(map_draw.load_world(world), resolution, math.radians(yaw_deg), furniture=furniture)
    picture = save_plan(plan, out)
    if not quiet:
        typer.echo(f"{plan.shape[1]}×{plan.shape[0]} cells of {resolution:g} m in {out} and {picture}")


for _command, _example in (
    (map_check.check, "localiser map check maps/corridor.yaml --log logs/corridor -o coverage.png"),
    (map_edit.add, "localiser map add mine.yaml --at 1.2,-3.4 --bottom 0 --top 2.05 -o better.yaml"),
    (map_edit.remove, "localiser map remove mine.yaml 12 13 -o better.yaml"),
    (map_edit.move, "localiser map move mine.yaml 12 --to 1.2,-3.4 -o better.yaml"),
    (map_edit.export, "localiser map export mine.yaml --csv mine.csv"),
    (map_edit.align, "localiser map align plan.yaml mine.yaml -o mine_in_plan.yaml"),
    (map_edit.merge, "localiser map merge plan.yaml mine.yaml --align -o whole.yaml"),
    (map_update.update, "localiser map update mine.yaml logs/corridor -o newer.yaml"),
):
    map_app.command(epilog=f"Example: `{_example}`")(_command)
