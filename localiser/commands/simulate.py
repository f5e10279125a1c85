"""`localiser simulate`: logs of worlds, and a stand-in for a robot."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from localiser.commands.options import Quiet, progress
from localiser.errors import InputError

EPILOG = """Examples:

`localiser simulate configs/worlds/office.yaml -o logs/office`

`localiser simulate logs/corridor --serve`"""


def simulate(
    world: Annotated[
        Path,
        typer.Argument(metavar="WORLD", help="World file, such as configs/worlds/corridor.yaml; to serve, also a log."),
    ],
    out: Annotated[Path | None, typer.Option("--out", "-o", metavar="LOG", help="New folder for the log.")] = None,
    seed: Annotated[int, typer.Option(min=0, metavar="N", help="Same seed, same log.")] = 0,
    serve: Annotated[
        bool,
        typer.Option("--serve", help="Send the drive over zenoh in real time, to and fro, in place of a robot."),
    ] = False,
    listen: Annotated[
        str, typer.Option(metavar="ENDPOINT", help="Where to be reached; by default from this machine alone.")
    ] = "tcp/127.0.0.1:7447",
    odometry_hz: Annotated[
        float | None,
        typer.Option(min=1, max=1000, help="Rate of the odometry that is sent; by default as the log has it."),
    ] = None,
    wait: Annotated[bool, typer.Option("--wait", help="Do not drive off before someone listens.")] = False,
    quiet: Quiet = False,
) -> None:
    """Render a log from a WORLD: images, odometry with its errors, truth and map. Or be a robot, with --serve."""
    if serve:
        _serve(world, seed, listen, odometry_hz, wait=wait, quiet=quiet)
        return
    from localiser.replay import simulated as simulation

    if out is None:
        raise InputError("expected --out LOG, or --serve", field="--out")
    log = simulation.simulated(world, seed)
    with progress("Rendering", len(log), quiet) as advance:
        simulation.write(log, out, advance)
    if not quiet:
        typer.echo(f"{len(log)} images and {len(log.landmark_map)} landmarks in {out}")


def _serve(world: Path, seed: int, listen: str, odometry_hz: float | None, *, wait: bool, quiet: bool) -> None:
    from localiser.live import Passage, StandIn, drive
    from localiser.live.sources import Network
    from localiser.replay import asked_to_stop

    with asked_to_stop() as stop:
        log = drive(world, seed)
        with Network((), [listen]) as network:
            if not quiet:
                typer.echo(
                    f"{log.name}: {log.duration_s:.0f} s there and as long back, at {listen}, until Ctrl-C", err=True
                )
            robot = StandIn(network, Passage.of(log, odometry_hz))
            if wait:
                robot.wait_for_listener(stop)
            robot.run(stop)
