"""`localiser camera tilt`: tilt and roll from the vertical edges in a log's images."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from localiser.commands.convert import to_folder
from localiser.commands.options import ConfigFile, NewLog, Overrides, is_quiet, open_with_settings, progress, show, warn
from localiser.errors import InputError

if TYPE_CHECKING:
    from localiser.calibration import LogMount
    from localiser.config import Config
    from localiser.storage import Log

EPILOG = """Examples:

`localiser camera tilt logs/corridor`

`localiser camera tilt logs/corridor -o logs/levelled`"""

_MOST_IMAGES = 500  # more of a log tell hardly more of the tilt


def tilt(
    log: Annotated[Path, typer.Argument(metavar="LOG", help="Log folder with images.")],
    out: NewLog = None,
    config: ConfigFile = None,
    overrides: Overrides = None,
) -> None:
    """Find tilt and roll from the vertical edges in a LOG's images; the stated tilt may be several degrees off."""
    from dataclasses import replace

    from localiser.calibration import mount_of_images, spread
    from localiser.documents import plain_name
    from localiser.storage import require_new, require_odometry

    if out is not None:
        require_new(out)
    recorded, settings = open_with_settings(log, config, overrides)
    require_odometry(recorded, "finding the tilt")
    images = [image for image in recorded.images if recorded.odometry.covers(image.t_ns)]
    if not images:
        raise InputError("expected a log with images, found edges that were measured already", path=recorded.path)
    if any(image.mount is not None for image in images):
        problem = "expected a camera that does not move on the robot, found a mount of its own for each image"
        raise InputError(problem, path=recorded.path, field="images")
    used = [images[i] for i in spread(len(images), _MOST_IMAGES)]
    poses = recorded.odometry.sampled([image.t_ns for image in used]).poses
    with progress("Looking", len(used)) as advance:
        found = mount_of_images(
            lambda i: used[i].load(),
            poses,
            recorded.camera,
            settings.edges,
            advance,
            lambda i: recorded.twist_at(used[i].t_ns),
        )
    if not is_quiet():
        _show(found, len(used))
    if out is not None:
        _require_certain(found, settings, recorded)
        tilt_rad, roll_rad = (float(angle) for angle in found.mount)
        camera = recorded.camera.with_mount(tilt_rad=tilt_rad, roll_rad=roll_rad)
        to_folder(replace(recorded, name=plain_name(out.name), camera=camera), out)
        typer.echo(f"The log with this tilt and roll is in {out}")


def _show(found: LogMount, images: int) -> None:
    import numpy as np

    from localiser.evaluate import new_table

    table = new_table("", "", "stated", "found", "1σ", "found - stated")
    rows = zip(("tilt (°)", "roll (°)"), *np.rad2deg([found.stated, found.mount, found.sigma]), strict=True)
    for name, stated, mean, sigma in rows:
        table.add_row(name, f"{stated:.3f}", f"{mean:.3f}", f"{sigma:.3f}", f"{mean - stated:+.3f}")
    show(table)
    share = found.vertical / found.lines if found.lines else 0.0
    typer.echo(f"{found.lines} lines in {images} images, {share:.0%} of them vertical edges, at {found.places} places.")
    warn(found.problem)


def _require_certain(found: LogMount, config: Config, log: Log) -> None:
    """Raise InputError when tilt and roll are less certain than what is stated is taken to be."""
    import numpy as np

    believed_deg = (config.edges.tilt_sigma_deg, config.edges.roll_sigma_deg)
    for name, sigma, believed in zip(("tilt", "roll"), np.rad2deg(found.sigma), believed_deg, strict=True):
        if sigma > believed:
            raise InputError(
                f"not written: the images tell the {name} to {sigma:.2f}° only, and what is stated is taken to be "
                f"certain to {believed:g}° (edges.{name}_sigma_deg)",
                path=log.path,
            )
