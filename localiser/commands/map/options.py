"""Arguments that several `localiser map` commands take."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from localiser.errors import OutputError

MapFile = Annotated[Path, typer.Argument(metavar="MAP", help="Landmark map (YAML).")]
MapOut = Annotated[Path, typer.Option("--out", "-o", metavar="MAP", help="The map file to write; may be the same one.")]
NewMap = Annotated[Path, typer.Option("--out", "-o", metavar="MAP", help="The map file to write.")]
Picture = Annotated[Path | None, typer.Option("--out", "-o", metavar="PNG", help="The picture; by default beside MAP.")]
WasAt = Annotated[
    str, typer.Option("--poses", metavar="truth|FILE|odometry", help="Where the robot was, as for `map build`.")
]
PlanFile = Annotated[
    Path | None, typer.Option("--plan", metavar="PLAN", help="Floor plan of map_server (YAML): draw its walls.")
]
Force = Annotated[bool, typer.Option("--force", help="Overwrite what exists.")]
Within = Annotated[float, typer.Option(min=1e-3, max=10.0, metavar="M", help="How near landmarks that are one lie.")]


def require_writable(*paths: Path | None, overwrite: bool) -> None:
    """Raise OutputError when there is a file at one of the paths that is not to be overwritten, or a folder."""
    for path in paths:
        if path is not None and path.is_dir():
            raise OutputError(f"{path}: expected the name of a file, found a folder")
        if path is not None and path.exists() and not overwrite:
            raise OutputError(f"{path}: exists already; --force overwrites it")
