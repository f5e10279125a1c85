"""The commands. Heavy modules are imported inside them, so that --help is quick."""

from __future__ import annotations

import errno
import io
import os
import sys
import traceback
import warnings
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from typing import Annotated, Any

import typer
from typer.core import TyperArgument, TyperOption

from localiser import __version__
from localiser.commands import batch, convert, demo, doctor, edges, evaluate, replay, simulate, view
from localiser.commands.camera import camera_app
from localiser.commands.live import live_app
from localiser.commands.map import map_app
from localiser.commands.odometry import odometry_app
from localiser.commands.options import ConfigFile, Overrides, be_quiet, is_quiet, warn
from localiser.commands.pose import pose_app
from localiser.errors import (
    InputError,
    InputNote,
    InputWarning,
    LocaliserError,
    is_lack_of_memory,
    one_paragraph,
    reason_of,
)

app = typer.Typer(
    name="localiser",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode="markdown",
    help="Tells a robot with one camera, tilted down at the floor, where it is in a building.",
    epilog="""Examples:

`localiser demo`

`localiser replay logs/corridor`

`localiser evaluate results/corridor/latest`

`localiser simulate configs/worlds/office.yaml -o logs/office`

`localiser config show --set mcl.particles=500`""",
)
_option_type = TyperOption.display_type_rich
TyperArgument.display_type_rich = lambda self, ctx: None  # type: ignore[method-assign]
TyperOption.display_type_rich = lambda self, ctx: None if self.is_flag else _option_type(self, ctx)  # type: ignore[method-assign]
"""In --help a flag takes no value to name the type of, and an argument's name says what it is."""

config_app = typer.Typer(no_args_is_help=True, help="Show what can be set.")
app.add_typer(config_app, name="config")
app.add_typer(camera_app, name="camera")
app.add_typer(map_app, name="map")
app.add_typer(live_app, name="live")
app.add_typer(pose_app, name="pose")
app.add_typer(odometry_app, name="odometry")


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
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="No progress bars, no tables.")] = False,
) -> None:
    """Take what holds for all commands, and may stand anywhere."""
    be_quiet(quiet)


app.command(epilog=demo.EPILOG)(demo.demo)
app.command(epilog=replay.EPILOG)(replay.replay)
app.command(epilog=view.EPILOG)(view.view)
app.command(epilog=batch.EPILOG)(batch.batch)
app.command(epilog=evaluate.EPILOG)(evaluate.evaluate)
app.command(epilog=simulate.EPILOG)(simulate.simulate)
app.command(epilog=convert.EPILOG)(convert.convert)
app.command(epilog=doctor.EPILOG)(doctor.doctor)
app.command(epilog=edges.EPILOG)(edges.edges)


@config_app.command("show", epilog="Example: `localiser config show --config mine.yaml --set mcl.particles=500`")
def config_show(config: ConfigFile = None, overrides: Overrides = None) -> None:
    """Print the configuration in force as YAML, with the meaning, unit and range of every value."""
    from localiser.config import read_config, to_yaml

    typer.echo(to_yaml(read_config(config, overrides or [])), nl=False)


_NETWORK = ("live", "live demo", "doctor", "simulate", "pose")
_MAPS = ("map build", "map show", "map plan", "map check", "map merge", "map update", "map align")
_GONE: tuple[tuple[str, str, tuple[str, ...]], ...] = (
    ("--connect", "is a setting now: --set live.connect=ENDPOINT", _NETWORK[1:]),
    ("--dds", "is a setting now: --set live.dds=DOMAIN", _NETWORK[1:]),
    ("--domain", "is a setting now: --set live.domain=N", _NETWORK[1:]),
    ("--listen", "is a setting now: --set live.listen=ENDPOINT", _NETWORK),
    ("--namespace", "is a setting now: --set live.namespace=NAME", _NETWORK),
    ("--interface", "is a setting now: --set live.interface=NAME", _NETWORK),
    ("--zenoh-config", "is a setting now: --set live.zenoh_config=FILE", _NETWORK),
    ("--topic", "is a setting now: --set live.topics.KIND=NAME", ("live", "pose")),
    ("--publish", "is a setting now: --set live.publish.KIND=NAME", _NETWORK),
    ("--service", "is a setting now: --set live.services.KIND=NAME", _NETWORK),
    ("--frame", "is a setting now: --set live.map_frame=NAME or live.odom_frame=NAME", _NETWORK),
    ("--use-sim-time", "is a setting now: --set live.use_sim_time=true", _NETWORK),
    ("--transform-tolerance", "is a setting now: --set live.transform_tolerance_s=S", _NETWORK),
    ("--seed", "is a setting now: --set seed=N", ("live", "live demo")),
    ("--ros-distro", "is the environment's ROS_DISTRO now", _NETWORK),
    ("--format", "is gone: the format is found out", ("replay", "batch", "camera tilt", "camera sync", "map build")),
    ("--to", "is gone: OUT says it by .mcap, .db3 or .bag, anything else is a log folder", ("convert",)),
    ("--png", "is gone: frames of a video become JPEG", ("convert",)),
    ("--seed", "is gone: `localiser demo --keep FOLDER`, then `localiser replay LOG --seed N`", ("demo",)),
    ("--speed", "is gone: `localiser demo --keep FOLDER`, then `localiser replay LOG --speed X`", ("demo",)),
    ("--force", "is gone: nothing that exists is overwritten; name another file, or remove it first", _MAPS),
    ("--view", "is gone: `localiser replay LOG --map MAP --view native` shows the map", ("map build",)),
    ("--rrd", "is gone: `localiser replay LOG --map MAP` records the drive on the map", ("map build",)),
    ("--log", "is --path LOG now", ("map show",)),
    ("--write", "is -o LOG now", ("camera tilt", "camera sync")),
    ("--rrd", "is gone: `localiser replay LOG --map MAP` records the map", ("map show", "map check")),
    ("--poses", "is gone: `localiser map show MAP --path LOG|FILE` draws a path", ("map show", "map check")),
    ("--plan", "is gone: `localiser map show MAP --plan PLAN` draws walls", ("map check",)),
    ("--scale", "is gone: a map and a plan have metres; scale one by its YAML first", ("map align",)),
    ("--by-filter", "is gone: a log's truth is used where it has one", ("odometry",)),
    ("--images", "is gone: at most 500 images are used, evenly spread", ("camera tilt",)),
    ("--name", "is gone: a camera is called as its file; edit `camera_name` in it", ("camera calibrate",)),
    ("--resume", "is gone: --checkpoint goes on from what is there, unless --start says otherwise", ("live",)),
    ("--seconds", "is gone: Ctrl-C or SIGTERM end a run, as `timeout 60 localiser live …` does", ("live", "live demo")),
    ("--wait", "is gone: a stand-in drives off as soon as someone listens", ("simulate",)),
    ("--odometry-hz", "is gone: a stand-in sends 100 poses a second", ("simulate",)),
    ("--config", "is gone: --set NAME=VALUE", ("simulate", "live demo")),
    ("--map", "is gone: `localiser map check MAP` tells how many landmarks are in view where", ("doctor",)),
    ("--image", "is gone: `localiser live --map MAP --image SOURCE --view web` shows what a camera sees", ("doctor",)),
    ("--picture", "is gone: `localiser edges LOG` draws the edges of images", ("doctor",)),
    ("--at", "is gone: `localiser map check MAP` tells how many landmarks are in view where", ("doctor",)),
    ("--report", "is gone: `localiser replay` with the settings of a run draws its report", ("batch",)),
    ("--names", "is gone: topics are named as rmw_zenoh does; by --set live.dds=DOMAIN they are DDS's", _NETWORK),
    ("--plot", "is gone: -o LOG writes a new log with what was found", ("camera tilt", "camera sync")),
    ("--config", "is gone: a map is checked by its landmarks, and a camera or a log", ("map check",)),
    ("--set", "is gone: a map is checked by its landmarks, and a camera or a log", ("map check",)),
)
"""Options that are settings now or gone, what to do instead, and of which commands they were."""
_GONE_COMMANDS = {
    "example": "`localiser demo --keep FOLDER`",
    "paper": "`python -m paper` in a clone of the project",
    "config schema": "`localiser config show`",
    "camera board": "`localiser camera calibrate --draw-board FILE.png`",
    "map draw": "`localiser map show MAP -o PNG`",
    "map deduplicate": "`localiser map merge MAP`",
    "odometry marks": "`localiser odometry fit LOG` of a log with true poses",
} | dict.fromkeys(
    ("map add", "map remove", "map move", "map export"), "any editor or reader of YAML: a map is a file of it"
)


def _check_options(arguments: list[str]) -> None:
    """Raise InputError for a command or option that is gone or has become a setting, with what to do instead."""
    for gone, instead in _GONE_COMMANDS.items():
        if arguments[: gone.count(" ") + 1] == gone.split():
            raise InputError(f"is gone: use {instead}", field=gone)
    has_two_words = arguments[:1] in (["camera"], ["map"]) or arguments[:2] == ["live", "demo"]
    command = " ".join(arguments[: 2 if has_two_words else 1])
    given = {argument.partition("=")[0] for argument in arguments}
    for option, instead, commands in _GONE:
        if option in given and command in commands:
            raise InputError(instead, field=option)


_OF_ALL = ("--debug", "--quiet", "-q")
"""Options of the program, which may stand anywhere."""


def main() -> None:
    """Run the command line; errors that the user can correct are printed as one paragraph, without a traceback."""
    of_all = [argument for argument in sys.argv[1:] if argument in _OF_ALL]
    arguments = [argument for argument in sys.argv[1:] if argument not in _OF_ALL]
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):  # a terminal of ASCII alone, and names of files that are no text
            stream.reconfigure(errors="replace")
    warnings.simplefilter("always", InputWarning)
    warnings.showwarning = partial(_show_warning, warnings.showwarning)
    try:
        _check_options(arguments)
        try:
            app([*of_all, *arguments], prog_name="localiser")
        finally:
            _flush()
    except Exception as error:
        if not (isinstance(error, (LocaliserError, OSError)) or is_lack_of_memory(error)):
            raise
        if "--debug" in of_all:
            traceback.print_exc()
        with suppress(OSError):
            typer.secho(f"Error: {_message_of(error)}", fg="red", err=True)
        raise SystemExit(getattr(error, "exit_code", LocaliserError.exit_code)) from None


def _show_warning(usual: Callable[..., None], message: Warning | str, *where: Any, **how: Any) -> None:
    """Print a warning about a file as one line; hand any other to what prints them usually."""
    if not isinstance(message, InputWarning):
        usual(message, *where, **how)
    elif not (isinstance(message, InputNote) and is_quiet()):
        warn(one_paragraph(str(message)))


def _flush() -> None:
    """Hand what was printed to its reader; one that has gone, such as `head`, is no error. Raises OSError."""
    try:
        sys.stdout.flush()
    except OSError as error:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # else Python tries again, and says so
        if error.errno != errno.EPIPE:
            raise


def _message_of(error: Exception) -> str:
    """Return what is wrong; of the system's errors, with the path that it is about."""
    if isinstance(error, LocaliserError):
        return str(error)
    if is_lack_of_memory(error):
        return one_paragraph(f"there is too little memory (`ulimit -v`, a container's limit?): {error}")
    reason = reason_of(error) if isinstance(error, OSError) else ""
    filename = getattr(error, "filename", None)
    return one_paragraph(f"{filename}: {reason}" if filename else f"cannot be written or read: {reason}")
