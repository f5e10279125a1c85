"""`localiser edges`: find vertical edges in images."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from localiser.commands.options import ConfigFile, Overrides, is_quiet, progress, show
from localiser.errors import InputError

if TYPE_CHECKING:
    from localiser.commands.edge_search import EdgeSearch

EPILOG = """Examples:

`localiser edges photo.png --camera camera.yaml`

`localiser edges *.jpg --camera camera.yaml --detector lsd --out found`

`localiser edges logs/corridor --no-pictures --set edges.min_length_px=20`"""

_MOST_ROWS = 60
_DEG = 180 / math.pi
_COLUMNS = (
    ("edge", "edge", 1, "d"),
    ("bearing °", "bearing_rad", _DEG, "+.2f"),
    ("sigma °", "bearing_sigma_rad", _DEG, ".3f"),
    ("lean °", "lean_rad", _DEG, "+.2f"),
    ("sigma °", "lean_sigma_rad", _DEG, ".2f"),
    ("slope °", "slope_deg", 1, ".2f"),
    ("length px", "length_px", 1, ".0f"),
    ("polarity", "polarity", 1, "d"),
    ("foot m", "foot_range_m", 1, ".2f"),
    ("± m", "foot_range_sigma_m", 1, ".2f"),
)
"""Title, key of the row, factor, and format of a number."""


def edges(
    images: Annotated[
        list[Path], typer.Argument(metavar="IMAGE…", help="Image files of one camera, or one log folder.")
    ],
    camera: Annotated[
        Path | None, typer.Option(metavar="FILE", help="What took the images; by default a log's own.")
    ] = None,
    detector: Annotated[str | None, typer.Option(metavar="NAME", help="columns, lsd or hough.")] = None,
    out: Annotated[
        Path | None,
        typer.Option("--out", "-o", metavar="DIR", help="New folder for the results; by default results/edges/1, 2, …"),
    ] = None,
    pictures: Annotated[bool, typer.Option("--pictures/--no-pictures", help="Draw what was found.")] = True,
    config: ConfigFile = None,
    overrides: Overrides = None,
) -> None:
    """Find the vertical edges in images; write them as CSV, and a picture of each image."""
    from dataclasses import replace

    from localiser.commands.edge_search import EdgeSearch, inputs_of
    from localiser.config import read_config
    from localiser.edges import registered

    settings = read_config(config, overrides or [])
    if detector is not None:
        settings = settings.model_copy(update={"edges": replace(settings.edges, detector=detector)})
    try:
        registered(settings.edges.detector)
    except ValueError as error:
        raise InputError(f"{error}, found {settings.edges.detector!r}", field="--detector") from None
    taken_by, taken = inputs_of(images, camera)
    search = EdgeSearch(taken_by, taken, settings, out, pictures)
    with progress("Finding edges", len(taken), shown=len(taken) > 1) as advance:
        search.run(advance)
    if is_quiet():
        return
    _show(search)
    typer.echo(f"Results in {search.folder}: edges.csv{'; a picture of each image' if pictures else ''}.")
    if warning := search.mount_warning():
        typer.secho(warning, fg="yellow", err=True)


def _show(search: EdgeSearch) -> None:
    """Print the edges of a single image, or what was found in several."""
    import numpy as np

    if len(search.images) > 1:
        typer.echo(
            f"{sum(search.counts)} vertical edges in {len(search.images)} images, {np.median(search.counts):g} in an "
            f"image (median), found in {np.median(search.ms):.1f} ms"
        )
        return
    from localiser.commands.edge_search import rows_of
    from localiser.evaluate import new_table

    rows, image = rows_of(search.last), search.images[0].image
    if not rows:
        typer.echo(f"No vertical edges in {image}; segments rejected: {len(search.last.rejected_px)}")
        return
    table = new_table(f"{len(rows)} vertical edges in {image}", *(title for title, *_ in _COLUMNS), texts=0)
    for row in rows[:_MOST_ROWS]:
        table.add_row(*(_text(row[key], factor, spec) for _, key, factor, spec in _COLUMNS))
    if len(rows) > _MOST_ROWS:
        table.add_row(f"{len(rows) - _MOST_ROWS} more in edges.csv")
    mount, found = search.camera.at(search.images[0].mount).mount, search.mount
    stated = zip(("tilt", "roll"), np.rad2deg([mount.tilt_rad, mount.roll_rad]), strict=True)
    parts = (
        f"{name} {found[f'{name}_deg']:.2f} ± {found[f'{name}_sigma_deg']:.2f}° (stated {value:.2f}°)"
        for name, value in stated
    )
    table.caption = "By these edges: " + ", ".join(parts)
    show(table)


def _text(value: Any, factor: float, spec: str) -> str:
    if isinstance(value, str):
        return value
    return format(value * factor, spec) if math.isfinite(value) else "–"
