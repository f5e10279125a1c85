"""The command `edges`: find vertical edges in images."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from localiser.commands.options import ConfigFile, Overrides, Quiet, progress, show
from localiser.errors import InputError

EPILOG = """Examples:

`localiser edges photo.png --camera camera.yaml`

`localiser edges *.jpg --camera camera.yaml --detector columns --detector lsd --out found`

`localiser edges logs/corridor --no-pictures --set edges.min_length_px=20`"""


def edges(
    images: Annotated[
        list[Path], typer.Argument(metavar="IMAGE…", help="Image files of one camera, or one log folder.")
    ],
    camera: Annotated[
        Path | None, typer.Option(metavar="FILE", help="What took the images; by default a log's own.")
    ] = None,
    detector: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME", help="columns, lsd or hough. Repeated, they are compared side by side."),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option("--out", "-o", metavar="DIR", help="New folder for the results; by default results/edges/1, 2, …"),
    ] = None,
    pictures: Annotated[bool, typer.Option("--pictures/--no-pictures", help="Draw what was found.")] = True,
    config: ConfigFile = None,
    overrides: Overrides = None,
    quiet: Quiet = False,
) -> None:
    """Find the vertical edges in images; write them as CSV and JSON, and a picture of each image."""
    from localiser.commands.edges.inputs import inputs_of
    from localiser.commands.edges.mount import mount_warnings
    from localiser.commands.edges.run import EdgeRun
    from localiser.commands.edges.tables import tables_of
    from localiser.config import read_config

    settings = read_config(config, overrides or [])
    names = detector or [settings.edges.detector]
    _require_detectors(names)
    taken_by, taken = inputs_of(images, camera)
    run = EdgeRun(taken_by, taken, settings, names, out, pictures)
    with progress("Finding edges", len(taken), quiet or len(taken) == 1) as advance:
        run.run(advance)
    if not quiet:
        for table in tables_of(run):
            show(table)
        pictures_too = ", a picture" if pictures else ""
        summary = "compares them" if len(names) > 1 else "sums up"
        typer.echo(f"Results in {run.folder}: edges.csv; of each image JSON{pictures_too}; detectors.csv {summary}.")
        for warning in mount_warnings(run):
            typer.secho(warning, fg="yellow", err=True)


def _require_detectors(names: list[str]) -> None:
    from localiser.edges import registered

    for name in names:
        try:
            registered(name)
        except ValueError as error:
            raise InputError(f"{error}, found {name!r}", field="--detector") from None
        if names.count(name) > 1:
            raise InputError(f"expected each detector once, found {name} {names.count(name)} times", field="--detector")
