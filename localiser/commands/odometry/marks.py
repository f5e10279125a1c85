"""What the command `odometry marks` says of a drive, and where in the file of marks an error is."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

import numpy as np

from localiser.errors import InputError

if TYPE_CHECKING:
    from localiser.calibration import MarkedDrive
    from localiser.storage import MarksTable


@contextmanager
def named(table: MarksTable) -> Iterator[None]:
    """Name the file and the line of the mark that an error is about."""
    try:
        yield
    except InputError as error:
        line = None if error.line is None else table.lines[error.line - 1]
        field = table.time if error.field == "time" else error.field
        raise InputError(error.problem, path=table.path, line=line, field=field) from None


def shown_drive(drive: MarkedDrive) -> str:
    """Return how certain the poses are, and what was found out about the odometry."""
    position, heading = drive.position_sigma_m, np.degrees(np.sqrt(drive.covs[:, 2, 2]))
    distance, turn, veer = drive.constants * [100.0, 100.0, np.rad2deg(1.0)]
    sigma = drive.sigmas * [100.0, 100.0, np.rad2deg(1.0)]
    return (
        f"{len(drive.trajectory)} poses over {len(drive.left_out)} marks\n"
        f"position, 1 sigma: {np.median(position):.3f} m median, {position.max():.3f} m worst\n"
        f"heading, 1 sigma: {np.median(heading):.2f}° median, {heading.max():.2f}° worst\n"
        f"odometry: distance {distance:+.2f} ± {sigma[0]:.2f} %, turn {turn:+.2f} ± {sigma[1]:.2f} %, "
        f"veer {veer:+.2f} ± {sigma[2]:.2f}°/m\n"
        f"the mark that the others contradict most: {drive.left_out.max():.1f} sigma"
    )
