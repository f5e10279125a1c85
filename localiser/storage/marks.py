"""Read the table of marks that a robot stood on: `t_s` or `t_ns`, `x,z`, and where known heading and sigmas."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from localiser.calibration import MARK_SIGMA_M, MARK_SIGMA_RAD, Mark
from localiser.documents import read_text
from localiser.errors import InputError
from localiser.storage.tables import (
    MAX_TABLE_BYTES,
    Column,
    integer,
    number,
    number_or_unknown,
    positive_or_unknown,
    read_table,
)
from localiser.storage.trajectories import nanoseconds


def _seconds(cell: str) -> int:
    """Return seconds as nanoseconds that fit 62 bits."""
    t_ns = nanoseconds(cell)
    if abs(t_ns) >= 2**62:
        raise ValueError("a time below 2^62 ns")
    return t_ns


_TIMES = {"t_s": _seconds, "t_ns": integer}


@dataclass(frozen=True, slots=True)
class MarksTable:
    """The marks in a file, the line of each, and the name of the column of times."""

    path: Path
    marks: list[Mark]
    lines: list[int]
    time: str


def read_marks(path: Path, first_ns: int) -> MarksTable:
    """Return the marks in a CSV file. first_ns: the time that `t_s` counts from.

    Raises InputError with file, line and field.
    """
    header = next(iter(read_text(path, MAX_TABLE_BYTES).splitlines()), "")
    found = [name for name in (cell.strip() for cell in header.split(",")) if name in _TIMES]
    if len(found) != 1:
        raise InputError(
            f"expected one column of times, t_s or t_ns, found {' and '.join(found) or 'none'}", path=path, line=1
        )
    (time,) = found
    columns = [Column(time, _TIMES[time]), Column("x", number), Column("z", number)]
    columns += [Column("heading_deg", number_or_unknown, required=False)]
    columns += [Column(name, positive_or_unknown, required=False) for name in ("sigma_m", "sigma_deg")]
    table = read_table(path, columns, rows_at_least=2)
    times = [t_ns + (first_ns if time == "t_s" else 0) for t_ns in table.integers(time).tolist()]
    places = table.numbers("x", "z")

    def optional(name: str, otherwise: float) -> np.ndarray:
        values = table.numbers(name) if name in table.columns else np.full(len(table), np.nan)
        return np.where(np.isnan(values), otherwise, values)

    heading = np.radians(optional("heading_deg", np.nan))
    sigma_m, sigma_rad = (
        optional("sigma_m", MARK_SIGMA_M),
        np.radians(optional("sigma_deg", np.degrees(MARK_SIGMA_RAD))),
    )
    rows = zip(times, *places.T.tolist(), heading.tolist(), sigma_m.tolist(), sigma_rad.tolist(), strict=True)
    return MarksTable(path, [Mark(*row) for row in rows], table.lines, time)
