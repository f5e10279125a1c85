"""`localiser doctor`: check that all parts fit together before the robot drives."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from localiser.commands.options import ConfigFile, Overrides, show
from localiser.errors import InputError

if TYPE_CHECKING:
    from localiser.commands.doctor_checks import Finding

EPILOG = """Examples:

`localiser doctor`

`localiser doctor --set live.connect=tcp/127.0.0.1:7447 --map maps/house.yaml --at 1.5,-2`

`localiser doctor --image 0 --picture camera.png`"""

LONGEST_S = 86400.0
_FARTHEST_M = 1e6
_COLOURS = {"ok": "green", "warning": "yellow", "missing": "red"}


def doctor(
    image: Annotated[
        str | None,
        typer.Option(metavar="SOURCE", help="A camera's number, a video file or a stream's address, read by OpenCV."),
    ] = None,
    map_file: Annotated[Path | None, typer.Option("--map", metavar="MAP", help="Landmark map.")] = None,
    at: Annotated[str | None, typer.Option(metavar="x,z", help="Where the robot is on the map.")] = None,
    camera: Annotated[Path | None, typer.Option(metavar="FILE", help="Camera file.")] = None,
    picture: Annotated[
        Path | None, typer.Option(metavar="FILE.png", help="Write what the camera sees, with the edges found in it.")
    ] = None,
    seconds: Annotated[float, typer.Option(min=0.5, max=LONGEST_S, metavar="S", help="How long to listen.")] = 5.0,
    config: ConfigFile = None,
    overrides: Overrides = None,
) -> None:
    """Tell what is installed, what a robot sends, and whether camera, clocks, mount and map fit together.

    Listens to a robot when a setting says where it is: `--set live.connect=tcp/127.0.0.1:7447`, or live.listen,
    live.zenoh_config, live.dds. Exit code 1 when something is missing.
    """
    from localiser.commands import doctor_checks as examination
    from localiser.config import read_config
    from localiser.live import input_topics, open_transport, prefix_of
    from localiser.storage import read_camera, read_map, require_new_file

    if picture is not None:
        require_new_file(picture)
    settings = read_config(config, overrides or [])
    findings = [*examination.versions()]
    known, seen = read_camera(camera) if camera else None, None
    if image is not None:
        finding, seen = examination.camera_check(image, seconds)
        findings.append(finding)
    live = settings.live
    if live.connect or live.listen or live.zenoh_config or live.dds >= 0:
        from contextlib import closing

        heard = examination.Heard(input_topics(live.topics, prefix_of(live)))
        with closing(open_transport(live, "localiser_doctor")) as transport:
            heard.listen(transport, seconds)
        findings += [*examination.topic_checks(heard), *examination.clock_checks(heard)]
        known, problem = examination.camera_of(heard, known)
        if known is None:
            findings.append(examination.Finding("camera", "missing", problem))
        else:
            mount = known.mount
            text = f"{known.width}×{known.height} pixels, {mount.height_m:.2f} m high"
            findings.append(examination.Finding("camera", "ok", text))
            findings += examination.mount_check(heard, known, settings)
            seen = examination.newest_image(heard, known) if seen is None else seen
    if map_file is not None:
        landmark_map = read_map(map_file)
        findings.append(examination.Finding("map", "ok", f"{len(landmark_map)} landmarks"))
        if at is not None and known is not None:
            x, z = _point(at)
            findings.append(examination.map_check(landmark_map, known, (x, z)))
    if picture is not None and seen is not None:
        examination.save_picture(picture, seen, known, settings)
        findings.append(examination.Finding("picture", "ok", str(picture)))
    _show(findings)
    if any(finding.state == "missing" for finding in findings):
        raise typer.Exit(1)


def _point(text: str) -> tuple[float, float]:
    """Return the point that `x,z` in metres stands for. Raises InputError."""
    try:
        x, z = (float(part) for part in text.split(","))
    except ValueError:
        x = z = float("nan")
    if not (abs(x) <= _FARTHEST_M and abs(z) <= _FARTHEST_M):
        raise InputError(f"expected x,z in metres, found {text!r}", field="--at")
    return x, z


def _show(findings: list[Finding]) -> None:
    from rich.table import Table

    table = Table(box=None, show_header=False)
    for finding in findings:
        colour = _COLOURS[finding.state]
        table.add_row(f"[{colour}]{finding.state}[/]", finding.what, finding.text)
    show(table)
