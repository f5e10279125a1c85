"""`localiser simulate`: logs of worlds, and a stand-in for a robot."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from localiser.commands.options import Quiet, progress
from localiser.errors import InputError

if TYPE_CHECKING:
    from localiser.simulate import SimulatedLog
    from localiser.storage import Image, ImageEvent, Log

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
    if out is None:
        raise InputError("expected --out LOG, or --serve", field="--out")
    log = simulated(world, seed)
    with progress("Rendering", len(log), quiet) as advance:
        write(log, out, advance)
    if not quiet:
        typer.echo(f"{len(log)} images and {len(log.landmark_map)} landmarks in {out}")


def simulated(world: Path, seed: int) -> SimulatedLog:
    """Return the simulated log of a world file; its images are rendered when they are asked for. Raises InputError."""
    from localiser.documents import read_model
    from localiser.simulate import World, simulate_log, world_of

    log = simulate_log(read_model(world, World, world_of), seed)
    if not len(log.landmark_map):
        raise InputError(
            "expected a drive on which landmarks are seen long enough for the map, found none",
            path=world,
            field="drive.path",
        )
    return log


def write(log: SimulatedLog, folder: Path, progress: Callable[[], None]) -> None:
    """Render and write the log, calling `progress` after every image. Raises OutputError."""
    from localiser.filter import Start
    from localiser.storage import write_log

    def images() -> Iterator[tuple[int, Image]]:
        for t_ns, image in zip(log.drive.image_t_ns, log.images(), strict=True):
            yield int(t_ns), image
            progress()

    write_log(
        folder,
        name=log.name,
        camera=log.camera,
        odometry=log.drive.odometry,
        images=images(),
        landmark_map=log.landmark_map,
        groundtruth=log.drive.truth,
        start=Start(int(log.drive.image_t_ns[0]), log.start, log.start_cov),
        jpeg_quality=log.jpeg_quality,
    )


def driven(world_or_log: Path, seed: int) -> Log:
    """Return the log of a path: a log that was recorded, or the drive through a world file, rendered now.

    The rendered images stay in memory. Raises InputError.
    """
    from localiser.filter import Start
    from localiser.storage import Log, open_log

    if world_or_log.suffix not in (".yaml", ".yml") or world_or_log.name == "log.yaml":
        return open_log(world_or_log)
    log = simulated(world_or_log, seed)
    frames = [_rendered(log, index) for index in range(len(log))]
    start = Start(frames[0].t_ns, log.start, log.start_cov)
    drive = log.drive
    return Log(log.name, world_or_log, log.camera, drive.odometry, frames, log.landmark_map, start, drive.truth)


def _rendered(log: SimulatedLog, index: int) -> ImageEvent:
    from localiser.storage import ImageEvent, decoded, encode_image

    name, size = f"image {index}", (log.camera.width, log.camera.height)
    data = encode_image(log.image(index), ".jpg", log.jpeg_quality)
    t_ns = int(log.drive.image_t_ns[index])
    return ImageEvent(t_ns, name, lambda: decoded(data, size, path=Path(name)), lambda: data)


def _serve(world: Path, seed: int, listen: str, odometry_hz: float | None, *, wait: bool, quiet: bool) -> None:
    from localiser.live import Passage, StandIn
    from localiser.live.sources import Network
    from localiser.replay import asked_to_stop

    with asked_to_stop() as stop:
        log = driven(world, seed)
        with Network((), [listen]) as network:
            if not quiet:
                typer.echo(
                    f"{log.name}: {log.duration_s:.0f} s there and as long back, at {listen}, until Ctrl-C", err=True
                )
            robot = StandIn(network, Passage.of(log, odometry_hz))
            if wait:
                robot.wait_for_listener(stop)
            robot.run(stop)
