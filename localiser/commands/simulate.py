"""`localiser simulate`: logs of worlds, and a stand-in for a robot."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from localiser.commands.convert import to_folder
from localiser.commands.options import Overrides, is_quiet, progress
from localiser.errors import InputError

if TYPE_CHECKING:
    from localiser.config import LiveParameters
    from localiser.storage import Log

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
        bool, typer.Option("--serve", help="Send the drive over zenoh in real time, to and fro, in place of a robot.")
    ] = False,
    overrides: Overrides = None,
) -> None:
    """Render a log from a WORLD: images, odometry with its errors, truth and map. Or be a robot, with --serve.

    The robot drives off as soon as someone listens to its images. The settings `live.*` say where it is reached; by
    default tcp/127.0.0.1:7447.
    """
    if serve:
        from localiser.config import read_config

        _serve(world, seed, read_config(None, overrides or []).live)
        return
    if out is None:
        raise InputError("expected --out LOG, or --serve", field="--out")
    from localiser.storage import simulate_log

    log = simulate_log(world, seed)
    with progress("Rendering", len(log.frames)) as advance:
        to_folder(log, out, advance)
    if not is_quiet():
        typer.echo(f"{len(log.frames)} images and {len(log.landmark_map or ())} landmarks in {out}")


def driven(world_or_log: Path, seed: int) -> Log:
    """Return the log of a path: a log that was recorded, or the drive through a world file, rendered now.

    The rendered images stay in memory. Raises InputError.
    """
    from localiser.storage import open_log, simulate_log

    if world_or_log.suffix not in (".yaml", ".yml") or world_or_log.name == "log.yaml":
        return open_log(world_or_log)
    log = simulate_log(world_or_log, seed)
    for image in log.images:
        image.encoded()
    return log


def _serve(world: Path, seed: int, live: LiveParameters) -> None:
    from contextlib import closing
    from dataclasses import replace

    from localiser.live import ENDPOINT, Passage, StandIn, network_of, open_transport, prefix_of
    from localiser.replay import asked_to_stop

    if not (live.connect or live.listen):
        live = replace(live, listen=(ENDPOINT,))

    with asked_to_stop() as stop:
        log = driven(world, seed)
        with closing(open_transport(live, "robot")) as transport:
            if not is_quiet():
                ways = f"{log.duration_s:.0f} s there and as long back"
                typer.echo(f"{log.name}: {ways}, at {network_of(live)}, until Ctrl-C", err=True)
            robot = StandIn(transport, Passage.of(log), prefix_of(live))
            robot.wait_for_listener(stop)
            robot.run(stop)
