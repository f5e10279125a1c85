"""`localiser doctor`: check that all parts fit together before the robot drives, or a log before it is replayed."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from localiser.commands.options import ConfigFile, Overrides, Topics, open_with_settings, show
from localiser.errors import one_paragraph

EPILOG = """Examples:

`localiser doctor`

`localiser doctor drive.bag`

`localiser doctor --set live.connect=tcp/127.0.0.1:7447`"""

LONGEST_S = 86400.0
_COLOURS = {"ok": "green", "optional": "dim", "warning": "yellow", "missing": "red"}


def doctor(
    log: Annotated[
        Path | None, typer.Argument(metavar="LOG", help="Log folder or ROS bag: what it has, and what a replay lacks.")
    ] = None,
    camera: Annotated[Path | None, typer.Option(metavar="FILE", help="Camera file.")] = None,
    topics: Topics = None,
    seconds: Annotated[float, typer.Option(min=0.5, max=LONGEST_S, metavar="S", help="How long to listen.")] = 5.0,
    config: ConfigFile = None,
    overrides: Overrides = None,
) -> None:
    """Tell what is installed, what a log has or a robot sends, and whether camera, clocks and mount fit together.

    Listens to a robot when a setting says where it is: `--set live.connect=tcp/127.0.0.1:7447`, or live.listen,
    live.zenoh_config, live.dds. Exit code 1 when something is missing.
    """
    from rich.table import Table
    from rich.text import Text

    from localiser.commands import doctor_checks as examination
    from localiser.config import read_config
    from localiser.errors import InputError
    from localiser.storage import read_camera

    settings = read_config(config, overrides or [])
    findings = [] if log is not None else [*examination.versions()]
    known = read_camera(camera) if camera else None
    if log is not None:
        findings += examination.topics_of(log)
        try:
            recorded, settings = open_with_settings(log, config, overrides, topics, camera)
            for finding in examination.log_checks(recorded, settings):
                findings.append(finding)
        except InputError as error:
            findings.append(examination.Check("replay", "missing", str(error)))
    live = settings.live
    if live.connect or live.listen or live.zenoh_config or live.dds >= 0:
        heard = examination.listen_to_robot(live, seconds)
        findings += [*examination.topic_checks(heard), *examination.clock_checks(heard)]
        known, problem = examination.camera_of(heard, known)
        if known is None:
            findings.append(examination.Check("camera", "missing", problem))
        else:
            findings += [examination.camera_finding(known), *examination.heard_checks(heard, known, settings)]
    table = Table(box=None, show_header=False)
    for finding in findings:
        state = Text(finding.state, style=_COLOURS[finding.state])
        table.add_row(state, Text(finding.what), Text(one_paragraph(finding.text)))
    show(table)
    if any(finding.state == "missing" for finding in findings):
        raise typer.Exit(1)
