"""Find tilt and roll of a log's camera, and write them into its file."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from localiser.calibration import LogMount, mount_of_images, save_mount_plot, spread
from localiser.config import Config
from localiser.errors import InputError
from localiser.geometry import Array
from localiser.storage import ImageEvent, Log, camera_file, require_new_file, require_odometry, update_mount


@dataclass(frozen=True, slots=True, eq=False)
class Tilt:
    """What the images of a log say about tilt and roll. seconds: (F,) since the log's start, of the images used."""

    log: Log
    found: LogMount
    seconds: Array


def usable_images(log: Log, most: int) -> list[ImageEvent]:
    """Return at most `most` images, evenly spread over the log, taken while there is odometry. Raises InputError."""
    require_odometry(log, "finding the tilt")
    images = [image for image in log.images if log.odometry.covers(image.t_ns)]
    if not images:
        raise InputError("expected a log with images, found edges that were measured already", path=log.path)
    if any(image.mount is not None for image in images):
        problem = "expected a camera that does not move on the robot, found a mount of its own for each image"
        raise InputError(problem, path=log.path, field="images")
    return [images[i] for i in spread(len(images), most)]


def find_tilt(log: Log, images: list[ImageEvent], config: Config, progress: Callable[[], None]) -> Tilt:
    """Return tilt and roll that images of a log tell. Raises InputError when one of them cannot be read."""
    times = np.array([image.t_ns for image in images])
    poses = log.odometry.sampled(times).poses
    found = mount_of_images(
        lambda i: images[i].load(), poses, log.camera, config.edges, progress, lambda i: log.twist_at(images[i].t_ns)
    )
    return Tilt(log, found, (times - log.start_ns) / 1e9)


def write_plot(tilt: Tilt, path: Path) -> None:
    """Draw what was found. Raises OutputError when the file is there already."""
    require_new_file(path)
    save_mount_plot(path, tilt.found, tilt.seconds, f"{tilt.log.name}: tilt and roll")


def write_tilt(tilt: Tilt, config: Config) -> tuple[Path, Path]:
    """Write tilt and roll into the log's camera file; return that, and where the old one is kept.

    Raises InputError when they are less certain than what is stated is taken to be, OutputError.
    """
    path = camera_file(tilt.log.path)
    sigma_deg = np.rad2deg(tilt.found.sigma)
    believed_deg = (config.edges.tilt_sigma_deg, config.edges.roll_sigma_deg)
    for name, sigma, believed in zip(("tilt", "roll"), sigma_deg, believed_deg, strict=True):
        if sigma > believed:
            raise InputError(
                f"not written: the images tell the {name} to {sigma:.2f}° only, and what is stated is taken to be "
                f"certain to {believed:g}° (edges.{name}_sigma_deg)",
                path=path,
            )
    tilt_deg, roll_deg = (round(float(value), 4) for value in np.rad2deg(tilt.found.mount))
    return path, update_mount(path, {"tilt_deg": tilt_deg, "roll_deg": roll_deg})
