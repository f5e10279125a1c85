"""`localiser map export`: a map as a table."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from localiser.commands.map.options import Force, MapFile, require_writable

if TYPE_CHECKING:
    from localiser.landmarks import LandmarkMap


def export(
    map_file: MapFile,
    csv: Annotated[Path | None, typer.Option(metavar="FILE", help="Write to this file, not to the screen.")] = None,
    force: Force = False,
) -> None:
    """Print a MAP as CSV, one landmark a row."""
    from localiser.storage import read_map, write_text

    text = table(read_map(map_file))
    if csv is None:
        typer.echo(text, nl=False)
        return
    require_writable(csv, overwrite=force)
    write_text(csv, text)


def table(landmark_map: LandmarkMap) -> str:
    """Return the map as CSV, one landmark a row, empty cells where something is not known."""
    import numpy as np

    from localiser.landmarks import Quality
    from localiser.storage import csv_of

    quality = landmark_map.quality or Quality.unknown(len(landmark_map))
    columns = {
        "x": landmark_map.points[:, 0],
        "z": landmark_map.points[:, 1],
        "cov_xx": landmark_map.cov[:, 0, 0],
        "cov_xz": landmark_map.cov[:, 0, 1],
        "cov_zz": landmark_map.cov[:, 1, 1],
        "bottom_m": landmark_map.bottom_m,
        "top_m": landmark_map.top_m,
        "polarity": np.where(landmark_map.polarity == 0, np.nan, landmark_map.polarity),
        "sightings": quality.sightings,
        "parallax_deg": np.rad2deg(quality.parallax_rad),
        "existence": quality.existence,
    }
    rows: list[list[object]] = [["id", *columns, "source"]]
    for index, (name, source) in enumerate(zip(landmark_map.ids, landmark_map.source, strict=True)):
        cells = ("" if np.isnan(column[index]) else f"{column[index]:.9g}" for column in columns.values())
        rows.append([name, *cells, source])
    return csv_of(rows)
