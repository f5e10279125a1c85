"""The commands. Heavy modules are imported inside them, so that --help is quick."""

from __future__ import annotations

import sys
import traceback
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import typer

from localiser import __version__
from localiser.commands import simulate
from localiser.commands.camera.arguments import camera_app
from localiser.commands.convert import arguments as convert
from localiser.commands.doctor import arguments as doctor
from localiser.commands.edges import arguments as edges
from localiser.commands.live import live_app
from localiser.commands.map import map_app
from localiser.commands.options import (
    BagCamera,
    ConfigFile,
    Overrides,
    Quiet,
    Seed,
    Topics,
    opened,
    paced,
    progress,
    show,
    topics_by_role,
    working,
)
from localiser.commands.paper import arguments as paper
from localiser.commands.pose import pose_app
from localiser.errors import LocaliserError

app = typer.Typer(
    name="localiser",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode="markdown",
    help="Tells a robot with one camera, tilted down at the floor, where it is in a building.",
    epilog="""Examples:

`localiser replay logs/corridor`

`localiser evaluate results/corridor/latest`

`localiser simulate configs/worlds/office.yaml -o logs/office`

`localiser config show --set mcl.particles=500`""",
)
config_app = typer.Typer(no_args_is_help=True, help="Show what can be set.")
app.add_typer(config_app, name="config")
app.add_typer(camera_app, name="camera")
app.add_typer(map_app, name="map")
app.add_typer(live_app, name="live")
app.add_typer(pose_app, name="pose")


class Kind(StrEnum):
    """What is compared: the line held through the nadir point, or the slope alone."""

    line = "line"
    slope = "slope"


class Source(StrEnum):
    """What says how the robot moved: its wheels, its camera alone, or both."""

    wheel = "wheel"
    vision = "vision"
    both = "both"


class View(StrEnum):
    """Where a run is shown while it goes on."""

    native = "native"
    web = "web"
    none = "none"


def _print_version(asked: bool) -> None:
    if asked:
        typer.echo(f"localiser {__version__}")
        raise typer.Exit


@app.callback()
def _root(
    version: Annotated[
        bool, typer.Option("--version", is_eager=True, callback=_print_version, help="Print the version and exit.")
    ] = False,
    debug: Annotated[bool, typer.Option("--debug", help="Show where in the program an error arose.")] = False,
) -> None:
    """Take what holds for all commands."""


@app.command(
    epilog="""Examples:

`localiser replay logs/corridor`

`localiser replay logs/corridor --observation slope --seed 1 --set mcl.particles=500`

`localiser replay logs/corridor --odometry vision`

`localiser replay logs/corridor --view web --speed 1`

`localiser replay drive.bag --map maps/house.yaml --topic odometry=/wheel/odom`

`localiser replay logs/corridor --checkpoint run.checkpoint --resume run.checkpoint`

`localiser replay ../data/mrclam:1 --format mrclam --start truth --no-rrd`"""
)
def replay(
    log: Annotated[
        Path, typer.Argument(metavar="LOG", help="Log folder, ROS bag, or FOLDER:N of the UTIAS MRCLAM data set.")
    ],
    map_file: Annotated[
        Path | None, typer.Option("--map", metavar="MAP", help="Landmark map; by default the log's own.")
    ] = None,
    config: ConfigFile = None,
    overrides: Overrides = None,
    seed: Seed = None,
    start: Annotated[
        str | None,
        typer.Option(
            metavar="x,z,heading_deg|global|truth",
            help="Where the robot starts, to 0.1 m and 3°. `global`: anywhere on the map. `truth`: the true pose plus "
            "such an error. By default what the log states, else global.",
        ),
    ] = None,
    observation: Annotated[Kind | None, typer.Option(help="What is compared with the map.")] = None,
    odometry: Annotated[Source | None, typer.Option(help="What says how the robot moved.")] = None,
    log_format: Annotated[
        str | None, typer.Option("--format", metavar="FORMAT", help="folder, bag or mrclam; by default found out.")
    ] = None,
    topics: Topics = None,
    camera: BagCamera = None,
    out: Annotated[Path, typer.Option(metavar="DIR", help="Where results go: DIR/log/1, DIR/log/2, …")] = Path(
        "results"
    ),
    rrd: Annotated[bool, typer.Option("--rrd/--no-rrd", help="Record the run for Rerun.")] = True,
    view: Annotated[View, typer.Option(help="Watch the run in Rerun.")] = View.none,
    speed: Annotated[
        float | None,
        typer.Option(min=0.01, metavar="X", help="X times as fast as the robot drove; by default as fast as possible."),
    ] = None,
    checkpoint: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Save what it takes to resume the run, when it ends or is stopped."),
    ] = None,
    checkpoint_every: Annotated[
        int, typer.Option(min=0, metavar="N", help="Save it after every N images too; 0: only then.")
    ] = 0,
    resume: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Go on from a checkpoint, with the same log, map and settings."),
    ] = None,
    quiet: Quiet = False,
) -> None:
    """Localise the robot along a recorded LOG; write its path, figures, a report and a recording."""
    from localiser.replay import Checkpoints, Outputs, prepare

    settings = [*(overrides or [])]
    settings += [f"seed={seed}"] if seed is not None else []
    settings += [f"observation.kind={observation}"] if observation is not None else []
    settings += [f"increments.source={odometry}"] if odometry is not None else []
    recorded, effective = opened(log, config, settings, format=log_format, topics=topics_by_role(topics), camera=camera)
    checkpoints = Checkpoints(checkpoint, checkpoint_every) if checkpoint else None
    with working("Getting ready; the first run compiles …", quiet):
        outputs = Outputs(out, rrd, view.value, checkpoints)
        run = prepare(recorded, effective, outputs, start, map_file=map_file, resume=resume)
    if run.live is not None and run.live.address:
        typer.echo(f"Watch at {run.live.address}", err=True)
    if start is None and run.inputs.start is None and not quiet:
        typer.echo("The log states no start: the robot is looked for on the whole map.", err=True)
    with progress("Localising", len(recorded.frames), quiet) as advance:
        times_ns = [frame.t_ns for frame in recorded.frames]
        figures = run.run(advance if speed is None else paced(advance, times_ns, speed))
    if not quiet:
        _show_run(figures, run.folder.path, rrd)
        for warning in figures["warnings"]:
            typer.secho(warning, fg="yellow", err=True)
    if run.live is not None and not run.live.is_running:
        typer.secho(
            "The viewer was closed or could not start (is there a display?); the run went on without it.",
            fg="yellow",
            err=True,
        )
    elif run.live is not None and run.live.address:
        typer.echo("The page is served until Ctrl-C.", err=True)
        run.live.wait()


@app.command(
    epilog="""Examples:

`localiser evaluate results/corridor/latest`

`localiser evaluate mine.tum --truth groundtruth.tum`"""
)
def evaluate(
    runs: Annotated[
        list[Path], typer.Argument(metavar="RUN…", help="Folders that replay wrote, or trajectory files (TUM, CSV).")
    ],
    truth: Annotated[
        Path | None, typer.Option(metavar="FILE", help="True poses (TUM, or CSV t_ns,x,z,heading).")
    ] = None,
) -> None:
    """Compare runs with the truth in one table; of runs that differ by their seed alone, median and worst too."""
    from localiser.commands.judge import figures_of
    from localiser.evaluate import errors_table

    figures = {name: figures_of(run, truth) for name, run in zip(_names(runs), runs, strict=True)}
    show(errors_table(figures))
    for name, found in figures.items():
        if found.get("complete") is False:
            typer.secho(
                f"{name} ended early: its figures are those of {found['frames']} frames.", fg="yellow", err=True
            )


@config_app.command("show", epilog="Example: `localiser config show --config mine.yaml --set mcl.particles=500`")
def config_show(config: ConfigFile = None, overrides: Overrides = None) -> None:
    """Print the configuration in force as YAML, with the meaning, unit and range of every value."""
    from localiser.config import load_config, to_yaml

    typer.echo(to_yaml(load_config(config, overrides or [])), nl=False)


@config_app.command("schema", epilog="Example: `localiser config schema > config.schema.json`")
def config_schema() -> None:
    """Print the JSON schema of configuration files, for editors."""
    import json

    from localiser.config import schema

    typer.echo(json.dumps(schema(), indent=2, ensure_ascii=False))


app.command(epilog=simulate.EPILOG)(simulate.simulate)
app.command(epilog=convert.EPILOG)(convert.convert)
app.command(epilog=doctor.EPILOG)(doctor.doctor)
app.command(epilog=edges.EPILOG)(edges.edges)
app.command(epilog=paper.EPILOG)(paper.paper)


def main() -> None:
    """Run the command line; errors that the user can mend are told in one paragraph, without a traceback."""
    arguments = [argument for argument in sys.argv[1:] if argument != "--debug"]  # which may stand anywhere
    try:
        app(arguments, prog_name="localiser")
    except LocaliserError as error:
        if len(arguments) < len(sys.argv) - 1:
            traceback.print_exc()
        typer.secho(f"Error: {error}", fg="red", err=True)
        raise SystemExit(error.exit_code) from None


def _show_run(figures: dict[str, object], folder: Path, rrd: bool) -> None:
    from localiser.evaluate import errors_table

    show(errors_table({folder.name: figures}))
    typer.echo(_how_sure(figures["confidence"]))
    recording = "run.rrd for `rerun`, " if rrd else ""
    typer.echo(f"Results in {folder}: report.png to look at, {recording}metrics.json for machines.")


def _how_sure(confidence: Any) -> str:
    """Return in words how sure a run was of its poses."""
    reasons = [f"{reason} ({count} images)" for reason, count in confidence["reasons"].items()]
    why = f"; else: {', '.join(reasons)}" if reasons else ""
    found = "never" if confidence["found_s"] is None else f"after {confidence['found_s']:.1f} s"
    return (
        f"Sure of the pose (p_correct > 0.9) first {found}, in {100 * (confidence['sure'] or 0):.0f} % of images{why}."
    )


def _names(runs: list[Path]) -> list[str]:
    """Return short names of the runs, whole paths where short ones would be the same."""
    short = ["/".join(run.parts[-2:]) for run in runs]
    return short if len(set(short)) == len(runs) else [str(run) for run in runs]
