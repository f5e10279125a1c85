"""`localiser live`: a robot that is running; and a demo with a stand-in for one."""

from __future__ import annotations

import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Annotated

import typer

from localiser.commands.options import ConfigFile, Overrides, with_options

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table

    from localiser.live import LiveOptions, LiveRun

live_app = typer.Typer(
    invoke_without_command=True,
    help="Localise a running robot: images and odometry come in over zenoh, poses go out.",
    epilog="""Examples:

`localiser live demo --view web`

`localiser live --map maps/house.yaml --start 1.5,-2,90 --record drive.db3`

`localiser live --map maps/house.yaml --connect tcp/192.168.1.5:7447 --set live.topics.image=/camera/image_raw --json`

`localiser live --map maps/house.yaml --image 0 --camera camera.yaml`""",
)

STATUS_EVERY_S = 0.25


Record = Annotated[
    Path | None,
    typer.Option(
        "--record", metavar="BAG.db3", help="Record what comes in, so that `localiser replay` repeats the run."
    ),
]
Json = Annotated[bool, typer.Option("--json", help="Write every pose as a line of JSON on standard output.")]
LiveView = Annotated[
    str,
    typer.Option(
        "--view", metavar="native|web|IP:PORT|none", help="Watch in Rerun; IP:PORT serves viewers on other machines."
    ),
]


@live_app.callback()
def live(
    context: typer.Context,
    map_files: Annotated[
        list[Path] | None,
        typer.Option("--map", metavar="MAP", help="Landmark map, or a list of maps. Repeat it for several floors."),
    ] = None,
    connect: Annotated[
        list[str] | None,
        typer.Option(metavar="ENDPOINT", help="A zenoh router; by default tcp/127.0.0.1:7447. Repeatable."),
    ] = None,
    dds: Annotated[
        int | None, typer.Option(metavar="DOMAIN", help="Take part in a domain of DDS, in place of zenoh.")
    ] = None,
    domain: Annotated[
        int | None, typer.Option(metavar="N", help="Domain of ROS 2 over zenoh; by default ROS_DOMAIN_ID, or 0.")
    ] = None,
    camera: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Camera file, in place of what the robot says of its camera.")
    ] = None,
    image: Annotated[
        str | None,
        typer.Option(metavar="SOURCE", help="A camera's number, a video file or a stream's address, read by OpenCV."),
    ] = None,
    start: Annotated[
        str | None,
        typer.Option(
            metavar="x,z,heading_deg", help="Where the robot is now, to 0.1 m and 3°; by default it is looked for."
        ),
    ] = None,
    record: Record = None,
    json: Json = False,
    view: LiveView = "none",
    checkpoint: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Save the state here every few seconds, and go on from what is there, unless --start says otherwise.",
        ),
    ] = None,
    config: ConfigFile = None,
    overrides: Overrides = None,
) -> None:
    """Localise a running robot; see docs/live.md.

    Names of topics, frames and services, and more of the network, are the settings `live.*` of `config show`.
    """
    if context.invoked_subcommand is not None:
        return
    from localiser.config import read_config
    from localiser.errors import InputError
    from localiser.live import LiveOptions
    from localiser.replay import stated_start
    from localiser.storage import read_maps

    if not map_files:
        raise InputError("expected a map", field="--map")
    options = LiveOptions(
        map_files,
        read_config(config, with_options(overrides, live__connect=connect, live__dds=dds, live__domain=domain)),
        camera,
        image,
        stated_start(start, 0, read_maps(map_files)) if start else None,
        record,
        sys.stdout.fileno() if json else None,
        view,
        checkpoint,
    )
    _run(options)


@live_app.command(epilog="Example: `localiser live demo --view web`")
def demo(
    log: Annotated[
        Path | None,
        typer.Argument(
            metavar="LOG|WORLD",
            help="What the stand-in drives: a log with a map, or a world file; by default the example drive.",
        ),
    ] = None,
    record: Record = None,
    json: Json = False,
    view: LiveView = "none",
    overrides: Overrides = None,
) -> None:
    """Show the live mode with no robot: a stand-in sends a log over zenoh or DDS, as if it were driving now."""
    from localiser.commands.demo import LOG, example_folder
    from localiser.commands.simulate import driven as driven_log
    from localiser.config import read_config
    from localiser.errors import InputError
    from localiser.live import LiveOptions
    from localiser.replay import stated_start
    from localiser.storage import write_map

    log = log or example_folder() / LOG
    driven = driven_log(log, 0)
    if driven.landmark_map is None:
        raise InputError("the log has no map", path=log, field="map")
    start, truth = driven.start, driven.groundtruth
    if start is None and truth is not None:
        start = stated_start(truth.at(driven.frames[0].t_ns))
    settings = read_config(None, overrides or [], driven.settings)
    reached = [f"live.{name}={getattr(settings.live, name)!r}" for name in ("dds", "interface", "namespace", "domain")]
    if settings.live.dds < 0:
        with socket.socket() as probe:
            probe.bind(("127.0.0.1", 0))
            endpoint = f"tcp/127.0.0.1:{probe.getsockname()[1]}"
        reached.append(f"live.listen={endpoint}")
        settings = read_config(None, [*(overrides or []), f"live.connect={endpoint}"], driven.settings)
    with TemporaryDirectory() as folder:
        map_file = Path(folder) / "map.yaml"
        write_map(driven.landmark_map, map_file)
        options = LiveOptions(
            [map_file],
            settings,
            start=start,
            record=record,
            json=sys.stdout.fileno() if json else None,
            view=view,
            stand_in=True,
        )
        with _stand_in(log, reached):
            _run(options)


@contextmanager
def _stand_in(log: Path, reached: list[str]) -> Iterator[None]:
    """Run the robot's stand-in as a process of its own."""
    from localiser.view import owned_python

    main = owned_python("from localiser.commands.main import main; main()")
    command = [*main, "simulate", str(log), "--serve", "--quiet"]
    command += [word for setting in reached for word in ("--set", setting)]
    robot = subprocess.Popen(command, stdout=subprocess.DEVNULL, start_new_session=True)
    try:
        yield
    finally:
        robot.terminate()
        robot.wait()


def _run(options: LiveOptions) -> None:
    """Run until Ctrl-C or SIGTERM, with a line that says how it goes; then say what it came to.

    Exit code 1 when neither images nor odometry have come.
    """
    from rich.console import Console
    from rich.text import Text

    from localiser.live import open_run, status_line
    from localiser.replay import asked_to_stop

    console, drawn = Console(stderr=True, markup=False), 0.0
    shared = options.json is not None and sys.stdout.isatty()  # lines of JSON go to the same terminal
    is_shown = console.is_terminal and not shared
    with asked_to_stop() as stop, open_run(options, partial(say, console)) as run:
        with console.status("", spinner="dots") if is_shown else nullcontext() as line:

            def ended() -> bool:
                nonlocal drawn
                if line is not None and time.monotonic() - drawn >= STATUS_EVERY_S:
                    drawn = time.monotonic()
                    line.update(Text(status_line(run.outputs.monitor), no_wrap=True, overflow="ellipsis"))
                return stop.is_set()

            run.run(ended)
        console.print(end_table(run))
        if run.outputs.monitor.heard_nothing:
            raise typer.Exit(1)


def say(console: Console, text: str, level: str) -> None:
    """Write a message, above the line that tells the status: so both must write by the same console."""
    from rich.text import Text

    from localiser.errors import one_paragraph

    console.print(Text(one_paragraph(text), style="yellow" if level == "WARNING" else ""), soft_wrap=True)


def end_table(run: LiveRun) -> Table:
    """Return what a run came to: its figures, what was wrong how often, and what was left out."""
    from localiser.evaluate import new_table

    monitor, timeline = run.outputs.monitor, run.tracker.timeline
    left_out = {**timeline.skipped, **{f"{role} dropped": count for role, count in run.inbox.dropped.items()}}
    if timeline.late_odometry:
        left_out["odometry"] = timeline.late_odometry
    rows = monitor.rows()
    for title, counts in (("warning", monitor.wrong), ("left out", left_out)):
        rows |= {f"{title}: {kind}": str(count) for kind, count in counts.items()}
    table = new_table("Live run", "figure", "value")
    for label, text in rows.items():
        table.add_row(label, text)
    return table
