"""The commands. Heavy modules are imported inside them, so that --help is quick."""

from __future__ import annotations

import errno
import io
import os
import sys
import traceback
from contextlib import suppress
from typing import Annotated

import typer

from localiser import __version__
from localiser.commands import batch, convert, demo, doctor, edges, evaluate, replay, simulate, view
from localiser.commands.camera import camera_app
from localiser.commands.config import config_app
from localiser.commands.live import live_app
from localiser.commands.map import map_app
from localiser.commands.odometry import odometry_app
from localiser.commands.pose import pose_app
from localiser.errors import InputError, LocaliserError

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
) -> None:
    """Take what holds for all commands."""


app.command(epilog=demo.EPILOG)(demo.demo)
app.command(epilog=replay.EPILOG)(replay.replay)
app.command(epilog=view.EPILOG)(view.view)
app.command(epilog=batch.EPILOG)(batch.batch)
app.command(epilog=evaluate.EPILOG)(evaluate.evaluate)
app.command(epilog=simulate.EPILOG)(simulate.simulate)
app.command(epilog=convert.EPILOG)(convert.convert)
app.command(epilog=doctor.EPILOG)(doctor.doctor)
app.command(epilog=edges.EPILOG)(edges.edges)


_NETWORK = ("live", "live demo", "doctor", "simulate", "pose")
_SETTINGS = {
    "--connect": ("live.connect=ENDPOINT", ("live demo", "doctor", "simulate", "pose")),
    "--dds": ("live.dds=DOMAIN", ("live demo", "doctor", "simulate", "pose")),
    "--domain": ("live.domain=N", ("live demo", "doctor", "simulate", "pose")),
    "--listen": ("live.listen=ENDPOINT", _NETWORK),
    "--namespace": ("live.namespace=NAME", _NETWORK),
    "--interface": ("live.interface=NAME", _NETWORK),
    "--zenoh-config": ("live.zenoh_config=FILE", _NETWORK),
    "--topic": ("live.topics.KIND=NAME", ("live", "doctor", "pose")),
    "--publish": ("live.publish.KIND=NAME", _NETWORK),
    "--service": ("live.services.KIND=NAME", _NETWORK),
    "--frame": ("live.map_frame=NAME or live.odom_frame=NAME", _NETWORK),
    "--use-sim-time": ("live.use_sim_time=true", _NETWORK),
    "--transform-tolerance": ("live.transform_tolerance_s=S", _NETWORK),
    "--seed": ("seed=N", ("live", "live demo")),
}
"""Options that are settings now, and of which commands they were."""


def _check_options(arguments: list[str]) -> None:
    """Raise InputError for an option that has become a setting, with its name."""
    command = "live demo" if arguments[:2] == ["live", "demo"] else arguments[0] if arguments else ""
    for option in (argument.partition("=")[0] for argument in arguments):
        setting, commands = _SETTINGS.get(option, ("", ()))
        if command in commands:
            raise InputError(f"is a setting now: --set {setting}", field=option)
        if option == "--ros-distro" and command in _NETWORK:
            raise InputError("is the environment's ROS_DISTRO now", field=option)


def main() -> None:
    """Run the command line; errors that the user can mend are told in one paragraph, without a traceback."""
    arguments = [argument for argument in sys.argv[1:] if argument != "--debug"]  # which may stand anywhere
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):  # a terminal of ASCII alone, and names of files that are no text
            stream.reconfigure(errors="replace")
    try:
        _run(arguments)
    except (LocaliserError, OSError) as error:
        if len(arguments) < len(sys.argv) - 1:
            traceback.print_exc()
        with suppress(OSError):
            typer.secho(f"Error: {_message_of(error)}", fg="red", err=True)
        raise SystemExit(getattr(error, "exit_code", LocaliserError.exit_code)) from None


def _run(arguments: list[str]) -> None:
    """Run a command; what it printed has reached its reader at the end, or raises OSError."""
    _check_options(arguments)
    try:
        app(arguments, prog_name="localiser")
    except SystemExit:
        _flush()
        raise
    _flush()


def _flush() -> None:
    try:
        sys.stdout.flush()
    except OSError as error:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # else Python tries again, and says so
        if error.errno != errno.EPIPE:  # whoever read it has seen enough
            raise


def _message_of(error: LocaliserError | OSError) -> str:
    """Return what is wrong; of the system's errors, with the path that it is about."""
    if isinstance(error, LocaliserError):
        return str(error)
    reason = error.strerror or str(error)
    return f"{error.filename}: {reason}" if error.filename else f"cannot be written or read: {reason}"
