"""`localiser camera sync`: the offset between the clocks of a log's images and wheels."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from localiser.commands.convert import to_folder
from localiser.commands.options import (
    BagCamera,
    ConfigFile,
    NewLog,
    Overrides,
    Topics,
    is_quiet,
    open_with_settings,
    progress,
    warn,
)
from localiser.errors import InputError

if TYPE_CHECKING:
    from localiser.edges import Edges

EPILOG = """Examples:

`localiser camera sync logs/corridor`

`localiser camera sync drive -o drive_by_one_clock`"""

WRITTEN_SIGMA_S = 0.05
"""An offset that is less certain than this is not written."""


def sync(
    log: Annotated[Path, typer.Argument(metavar="LOG", help="Log with images and odometry, in which the robot turns.")],
    out: NewLog = None,
    config: ConfigFile = None,
    overrides: Overrides = None,
    topics: Topics = None,
    camera: BagCamera = None,
) -> None:
    """Find the offset between the clocks of images and wheels, from the turns that both of them show."""
    from dataclasses import replace

    import numpy as np

    from localiser.calibration import MOST_PAIRS, clock_offset
    from localiser.documents import plain_name
    from localiser.edges import find_edges
    from localiser.storage import require_new, require_odometry

    if out is not None:
        require_new(out)
    recorded, settings = open_with_settings(log, config, overrides, topics, camera)
    require_odometry(recorded, "comparing the clocks")
    if not recorded.has_images:
        raise InputError("expected a log with images, found edges that were measured already", path=recorded.path)
    images = recorded.images

    def edges_of(index: int) -> Edges:
        image = images[index]
        twist = recorded.twist_at(image.t_ns)
        return find_edges(image.load(), recorded.camera, settings.edges, mount=image.mount, twist=twist)

    times = np.array([image.t_ns for image in images])
    with progress("Looking", MOST_PAIRS) as advance:
        found = clock_offset(times, edges_of, recorded.odometry, recorded.camera, progress=advance)
    if not is_quiet():
        typer.echo(
            f"Images are stamped {found.text} than wheels (1σ), by {np.rad2deg(found.turned_rad):.0f}° of turning in "
            f"{found.pairs} pairs of images."
        )
        warn(found.problem)
    if out is None:
        return
    if found.sigma_s > WRITTEN_SIGMA_S:
        raise InputError(
            f"not written: the images tell the offset to {found.sigma_s:.3f} s only, expected {WRITTEN_SIGMA_S:g} s or "
            "better; record a drive with some turns",
            path=recorded.path,
        )
    earlier_ns = round(found.offset_s * 1e9)
    moved = [replace(image, t_ns=image.t_ns - earlier_ns) for image in images]
    to_folder(replace(recorded, name=plain_name(out.name), frames=moved), out)
    typer.echo(f"The log with its images by the clock of the wheels is in {out}")
