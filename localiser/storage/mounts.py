"""The mount of each image as columns of a table of images: degrees and metres, an empty cell where it is as usual."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

from localiser.camera import Camera, Mount, MountSigma
from localiser.storage.cameras import degrees
from localiser.storage.tables import Column, Table, number_or_unknown

SIGMA = "_sigma"
_FIELDS = {
    "tilt_deg": "tilt_rad",
    "roll_deg": "roll_rad",
    "yaw_deg": "yaw_rad",
    "height_m": "height_m",
    "right_m": "right_m",
    "back_m": "back_m",
}


def _within(expected: str, is_right: Callable[[float], bool]) -> Callable[[str], float]:
    """Return what reads a cell: a number for which `is_right`, nan for an empty cell."""

    def read(cell: str) -> float:
        value = number_or_unknown(cell)
        if not (math.isnan(value) or is_right(value)):
            raise ValueError(expected)
        return value

    return read


_TILT = _within("an angle above -90 and below 90 degrees", lambda value: -90 < value < 90)
_ANGLE = _within("an angle within ±180 degrees", lambda value: abs(value) <= 180)
_HEIGHT = _within("a height above 0 and at most 100 m", lambda value: 0 < value <= 100)
_LENGTH = _within("a length within ±100 m", lambda value: abs(value) <= 100)
_SIGMA_DEG = _within("a sigma from 0 to 45 degrees", lambda value: 0 <= value <= 45)
_SIGMA_M = _within("a sigma from 0 to 10 m", lambda value: 0 <= value <= 10)
_READERS = (_TILT, _ANGLE, _ANGLE, _HEIGHT, _LENGTH, _LENGTH)
MOUNT_COLUMNS = (
    *(Column(name, read, required=False) for name, read in zip(_FIELDS, _READERS, strict=True)),
    *(Column(name + SIGMA, _SIGMA_DEG if name.endswith("_deg") else _SIGMA_M, required=False) for name in _FIELDS),
)


def mounts_of_table(table: Table, usual: Mount) -> list[Mount | None]:
    """Return the mount of each row (R); None where all its cells are empty. usual: what an empty cell means."""
    return [_mount(_cells(table, row), usual) for row in range(len(table))]


def _cells(table: Table, row: int) -> dict[str, float]:
    """Return what a row states of the mount, by column."""
    stated = {column.name: table.columns.get(column.name, ()) for column in MOUNT_COLUMNS}
    return {name: cells[row] for name, cells in stated.items() if cells and not math.isnan(cells[row])}


def _mount(cells: dict[str, float], usual: Mount) -> Mount | None:
    if not cells:
        return None
    inside = {name: math.radians(value) if "_deg" in name else value for name, value in cells.items()}
    values = {field: inside[name] for name, field in _FIELDS.items() if name in inside}
    sigmas = {field: inside[name + SIGMA] for name, field in _FIELDS.items() if name + SIGMA in inside}
    return replace(usual, **values, sigma=MountSigma(**sigmas) if sigmas else None)


def mount_cells(mounts: Sequence[Mount | None], camera: Camera) -> tuple[list[str], list[list[str]]]:
    """Return the names of the columns that say how the camera was mounted, and the cells of each row.

    mounts: of the images; None: as the camera says. Columns that would say nothing are left out.
    """
    usual = camera.mount
    names, columns = [], []
    for name, field in _FIELDS.items():
        values = [None if mount is None else getattr(mount, field) for mount in mounts]
        sigmas = [None if mount is None or mount.sigma is None else getattr(mount.sigma, field) for mount in mounts]
        if any(value is not None and value != getattr(usual, field) for value in values):
            names.append(name)
            columns.append(values)
        if any(sigma is not None for sigma in sigmas):
            names.append(name + SIGMA)
            columns.append(sigmas)
    rows = [
        [_cell(name, column[row]) for name, column in zip(names, columns, strict=True)] for row in range(len(mounts))
    ]
    return names, rows


def _cell(name: str, value: float | None) -> str:
    if value is None:
        return ""
    return repr(degrees(value) if "_deg" in name else float(value))
