"""What several `localiser map` commands share: arguments, poses, edges, the table of a map, where a picture goes."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from localiser.commands.options import progress, warn
from localiser.errors import InputError

if TYPE_CHECKING:
    from rich.table import Table

    from localiser.config import Config
    from localiser.edges import Edges
    from localiser.geometry import Trajectory
    from localiser.landmarks import LandmarkMap
    from localiser.storage import Log

MapFile = Annotated[Path, typer.Argument(metavar="MAP", help="Landmark map (YAML).")]
NewMap = Annotated[Path, typer.Option("--out", "-o", metavar="MAP", help="The map file to write, a new one.")]
Picture = Annotated[
    Path | None, typer.Option("--out", "-o", metavar="PNG", help="The picture, a new file; by default beside MAP.")
]
Within = Annotated[float, typer.Option(min=1e-3, max=10.0, metavar="M", help="How near landmarks that are one lie.")]


def read_one_map(path: Path) -> LandmarkMap:
    """Return the landmark map of a file, also of a list of this one alone. Raises InputError for a list of several."""
    from localiser.storage import read_map

    maps = read_map(path).maps
    if len(maps) > 1:
        raise InputError(f"expected one map, found a list of {len(maps)}: name the one that is meant", path=path)
    return maps[0]


def parse_poses(poses: str) -> tuple[str | Trajectory, str]:
    """Return what `--poses` names, a word or the trajectory of a file, and what to call it. Raises InputError."""
    from localiser.storage import read_poses

    path = Path(poses)
    if poses in ("truth", "odometry", "slam") or not path.exists():
        return poses, poses
    return read_poses(path), path.name


def edges_with_progress(log: Log, config: Config) -> list[Edges]:
    """Return the edges of every image of a log; warn where images and wheels were stamped by clocks that differ."""
    from localiser.calibration import clock_offset
    from localiser.geometry import private_folder
    from localiser.mapping import edges_of_log

    with progress("Finding edges", len(log.frames)) as advance:
        found = edges_of_log(log, config.edges, advance, private_folder("edges"))
    if log.has_images:
        times = [frame.t_ns for frame in log.frames]
        warn(clock_offset(times, found.__getitem__, log.odometry, log.camera).warning(log.path))
    return found


def picture_path(stated: Path | None, map_file: Path, what: str) -> Path:
    """Return where a picture of a map goes. Raises OutputError for a file that was named and is there already.

    By default it lies beside the map, in place of an older one.
    """
    from localiser.storage import require_new_file

    if stated is not None:
        require_new_file(stated)
        return stated
    return map_file.with_name(f"{map_file.stem}_{what}.png")


def summary_table(landmark_map: LandmarkMap) -> Table:
    """Return what is known of the landmarks: median and the best and worst tenth of each figure."""
    import numpy as np

    from localiser.evaluate import new_table
    from localiser.landmarks import Quality

    quality = landmark_map.quality or Quality.unknown(len(landmark_map))
    sigma = np.sqrt(np.trace(landmark_map.cov, axis1=1, axis2=2) / 2)
    rows = (
        ("sigma, m", sigma, "{:.4f}"),
        ("images that show it", quality.sightings, "{:.0f}"),
        ("parallax, °", np.rad2deg(quality.parallax_rad), "{:.1f}"),
        ("probability of existence", quality.existence, "{:.3f}"),
        ("bottom, m", landmark_map.bottom_m, "{:.2f}"),
        ("top, m", landmark_map.top_m, "{:.2f}"),
    )
    table = new_table(f"{len(landmark_map)} landmarks", "", "10 % below", "median", "90 % below", "known")
    for name, values, form in rows:
        known = values[np.isfinite(values)]
        figures = [form.format(value) for value in np.quantile(known, (0.1, 0.5, 0.9))] if len(known) else ["–"] * 3
        table.add_row(name, *figures, str(len(known)))
    return table
