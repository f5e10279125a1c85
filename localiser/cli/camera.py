"""The commands about the camera: where it looks, and what its lens does."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import numpy as np
import typer

from localiser.cli.shared import ConfigFile, Overrides, Quiet, progress, show

if TYPE_CHECKING:
    from localiser.app.tilt import Tilt

camera_app = typer.Typer(
    no_args_is_help=True, help="Find out where the camera looks, and what its lens does.", rich_markup_mode="markdown"
)


@camera_app.command(
    epilog="""Examples:

`localiser camera tilt logs/corridor`

`localiser camera tilt logs/corridor --plot tilt.png --write`"""
)
def tilt(
    log: Annotated[Path, typer.Argument(metavar="LOG", help="Log folder with images.")],
    write: Annotated[
        bool, typer.Option("--write", help="Write tilt and roll into the log's camera file; the old one is kept.")
    ] = False,
    plot: Annotated[
        Path | None, typer.Option(metavar="FILE.png", help="Draw tilt and roll, image by image, to a new file.")
    ] = None,
    images: Annotated[
        int, typer.Option(min=1, metavar="N", help="Use at most so many images, evenly spread over the log.")
    ] = 500,
    config: ConfigFile = None,
    overrides: Overrides = None,
    log_format: Annotated[
        str | None, typer.Option("--format", metavar="FORMAT", help="Format of the log; by default found out.")
    ] = None,
    quiet: Quiet = False,
) -> None:
    """Find tilt and roll from the vertical edges in a LOG's images; the stated tilt may be several degrees off."""
    from localiser.app.tilt import find_tilt, usable_images, write_plot, write_tilt
    from localiser.config import load_config
    from localiser.storage import open_log

    settings = load_config(config, overrides or [])
    recorded = open_log(log, format=log_format, sensor=settings.sensor)
    used = usable_images(recorded, images)
    with progress("Looking", len(used), quiet) as advance:
        found = find_tilt(recorded, used, settings, advance)
    if not quiet:
        _show_tilt(found)
    if plot is not None:
        write_plot(found, plot)
        typer.echo(f"Drawn in {plot}")
    if write:
        path, kept = write_tilt(found, settings)
        typer.echo(f"Written to {path}; what it was is in {kept}")


def _show_tilt(tilt: Tilt) -> None:
    from rich.table import Table

    found = tilt.found
    table = Table("", "stated", "found", "1σ", "found - stated", box=None, pad_edge=False)
    for column in table.columns[1:]:
        column.justify = "right"
    rows = zip(("tilt (°)", "roll (°)"), *np.rad2deg([found.stated, found.mount, found.sigma]), strict=True)
    for name, stated, mean, sigma in rows:
        table.add_row(name, f"{stated:.3f}", f"{mean:.3f}", f"{sigma:.3f}", f"{mean - stated:+.3f}")
    show(table)
    share = found.vertical / found.lines if found.lines else 0.0
    typer.echo(
        f"{found.lines} lines in {len(tilt.seconds)} images, {share:.0%} of them vertical edges; "
        f"the images show {found.views} different views."
    )
    if problem := found.problem:
        typer.secho(problem, fg="yellow", err=True)
