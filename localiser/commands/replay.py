"""`localiser replay`: localise a robot along a recorded log."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from localiser.commands.options import (
    BagCamera,
    ConfigFile,
    Overrides,
    Seed,
    Topics,
    is_quiet,
    open_with_settings,
    paced,
    progress,
    show,
    warn,
    with_options,
    working,
)

EPILOG = """Examples:

`localiser replay logs/corridor`

`localiser replay logs/corridor --observation slope --seed 1 --set mcl.particles=500`

`localiser replay logs/corridor --odometry vision`

`localiser replay logs/corridor --view web --speed 1`

`localiser replay logs/corridor --bag corridor.mcap`

`localiser replay drive.bag --map maps/house.yaml --topic odometry=/wheel/odom`"""


Kind = Literal["line", "slope"]
Source = Literal["wheel", "vision"]
View = Literal["native", "web", "none"]


def replay(
    log: Annotated[Path, typer.Argument(metavar="LOG", help="Log folder or ROS bag.")],
    map_files: Annotated[
        list[Path] | None,
        typer.Option(
            "--map",
            metavar="MAP",
            help="Landmark map, or a list of maps; by default the log's own. Repeat it for several floors: the robot "
            "is looked for on all of them.",
        ),
    ] = None,
    config: ConfigFile = None,
    overrides: Overrides = None,
    seed: Seed = None,
    start: Annotated[
        str | None,
        typer.Option(
            metavar="POSE",
            help="Where the robot starts: x,z,heading_deg, to 0.1 m and 3°; MAP:x,z,heading_deg on another map than "
            "the first. `global`: anywhere on the map. `truth`: the true pose plus such an error. By default what the "
            "log states, else global.",
        ),
    ] = None,
    observation: Annotated[Kind | None, typer.Option(help="What is compared with the map.")] = None,
    odometry: Annotated[Source | None, typer.Option(help="What says how the robot moved.")] = None,
    topics: Topics = None,
    camera: BagCamera = None,
    out: Annotated[
        Path, typer.Option("--out", "-o", metavar="DIR", help="Where results go: DIR/log/1, DIR/log/2, …")
    ] = Path("results"),
    rrd: Annotated[bool, typer.Option("--rrd/--no-rrd", help="Record the run for Rerun.")] = True,
    bag: Annotated[
        Path | None,
        typer.Option(
            metavar="OUT.mcap",
            help="Also write the log and what is located as a ROS 2 bag (or .db3), for RViz, Foxglove, PlotJuggler.",
        ),
    ] = None,
    view: Annotated[View, typer.Option(help="Watch the run in Rerun.")] = "none",
    speed: Annotated[
        float | None,
        typer.Option(min=0.01, metavar="X", help="X times as fast as the robot drove; by default as fast as possible."),
    ] = None,
) -> None:
    """Localise the robot along a recorded LOG; write its path, figures, a report and a recording."""
    from localiser.replay import FolderRun, Outputs, prepare

    settings = with_options(overrides, seed=seed, observation__kind=observation, increments__source=odometry)
    recorded, effective = open_with_settings(log, config, settings, topics, camera)
    with working("Getting ready; the first run compiles …"):
        ready = prepare(recorded, effective, start, map_files=map_files or ())
        ready.localiser.warm_up(images=recorded.has_images)
        run = FolderRun.open(ready, Outputs(out, rrd, view, bag=bag))
    if run.viewer is not None and run.viewer.address:
        typer.echo(f"Watch at {run.viewer.address}", err=True)
    if ready.start is None and not is_quiet():
        why = "The log states no start: the" if start is None else "The"
        typer.echo(f"{why} robot is looked for on the whole map.", err=True)
    with progress("Localising", len(recorded.frames)) as advance:
        times_ns = [frame.t_ns for frame in recorded.frames]
        figures = run.run(advance if speed is None else paced(advance, times_ns, speed))
    layouts = [] if bag is None else _layouts_beside(bag)
    if not is_quiet():
        _show_run(figures, run.folder.path, rrd)
        if layouts:
            typer.echo(f"Bag in {bag}; beside it {' and '.join(layouts)}, layouts for RViz and Foxglove.")
        for warning in figures["warnings"]:
            warn(warning)
    if run.viewer is not None and not run.viewer.is_running:
        warn("The viewer was closed or could not start (is there a display?); the run went on without it.")
    elif run.viewer is not None and run.viewer.address:
        typer.echo("The page is served until Ctrl-C.", err=True)
        run.viewer.wait()


def _layouts_beside(bag: Path) -> list[str]:
    """Write the layouts of RViz and Foxglove beside a bag, where there are none; return their names."""
    from localiser.ros import LAYOUTS
    from localiser.storage import write_text

    for layout in sorted(LAYOUTS.iterdir()):
        if not (target := bag.with_name(layout.name)).exists():
            write_text(target, layout.read_text(encoding="utf-8"))
    return sorted(layout.name for layout in LAYOUTS.iterdir())


def _show_run(figures: dict[str, Any], folder: Path, rrd: bool) -> None:
    from rich.text import Text

    from localiser.evaluate import learnt_constants, run_tables

    for part in run_tables({folder.name: figures}):
        show(part)
    show(Text(_how_sure(figures["confidence"])))
    if constants := learnt_constants(figures):
        show(Text(f"Learnt: {', '.join(constants)}."))
    recording = "run.rrd for `localiser view`, " if rrd else ""
    typer.echo(f"Results in {folder}: report.html to look at, {recording}metrics.json for machines.")


def _how_sure(confidence: Any) -> str:
    """Return in words when the robot was found, and how sure the run was of its poses."""
    reasons = [f"{reason} ({count} image{'s' * (count != 1)})" for reason, count in confidence["reasons"].items()]
    why = f"; else: {', '.join(reasons)}" if reasons else ""
    found = ""
    if confidence["found_s"] is None:
        found = "The robot was not found, so there are no figures of its path. "
    elif confidence["not_found"]:
        left_out = f"{100 * confidence['not_found']:.1f} % of images"
        found = (
            f"The robot was found after {confidence['found_s']:.1f} s; figures leave out what was before, {left_out}. "
        )
    return f"{found}Sure of the pose (p_correct > 0.9) in {100 * (confidence['sure'] or 0):.1f} % of images{why}."
