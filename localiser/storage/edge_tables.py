"""Read and write measured edges as CSV: a row is an edge, the rows of one time are one frame.

In a file a bearing is measured from the robot's forward axis; inside the program from the camera's, which is turned
by the mount's yaw. It is converted here, both ways, and nowhere else.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import groupby
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from localiser.camera import Camera
from localiser.documents import Place, write_text
from localiser.edges import Edges, complete
from localiser.filter import Sighting
from localiser.geometry import Array, wrap_angle
from localiser.storage.tables import Column, Table, csv_of, integer, name_or_none, read_table, sign
from localiser.storage.tables import number_or_unknown as number
from localiser.storage.tables import positive_or_unknown as positive

_MEASURED = ("bearing_rad", "bearing_sigma_rad", "lean_rad", "lean_sigma_rad", "length_px")
MOST_EDGES = 2000  # in an image; hundreds are found in one that is full of them
COLUMNS = (
    Column("t_ns", integer),
    Column("bearing_rad", number),
    Column("bearing_sigma_rad", positive),
    Column("lean_rad", number),
    Column("lean_sigma_rad", positive),
    Column("length_px", positive),
    Column("polarity", sign),
    Column("landmark_id", name_or_none, required=False),
)


def read_edges(path: Path, camera: Camera) -> tuple[list[Sighting], dict[str, Place]]:
    """Return one sighting for each time in the table, at least one, and the landmarks that edges are said to belong to.

    Landmarks are given by id, in the order of their first row, which is their place; `landmark_id` of an edge is the
    number of its landmark in that order. A row with a time and nothing else is a frame in which no edge was found. Of
    bearing and lean the one that is missing follows from the other and the tilt. Raises InputError.
    """
    table = read_table(path, COLUMNS, rows_at_least=1)
    table.require_time_order(strictly=False)
    measured = table.numbers(*_MEASURED)
    measured[:, 0] = wrap_angle(measured[:, 0] + camera.mount.yaw_rad)
    found = np.isfinite(measured[:, 0]) | np.isfinite(measured[:, 2])
    for row in range(len(table)):
        _check_row(table, row, measured[row], found[row])

    frames, times = [], table.columns["t_ns"]
    polarity = np.array(table.columns["polarity"], dtype=np.int8)
    identified, named = _landmarks(table)
    for t_ns, rows in groupby(range(len(table)), key=lambda row: times[row]):
        index = np.array([row for row in rows if found[row]], dtype=np.int64)
        if len(index) > MOST_EDGES:
            problem = f"expected at most {MOST_EDGES} edges in an image, found {len(index)}"
            raise table.error(int(index[MOST_EDGES]), "t_ns", problem)
        bearing, bearing_sigma, lean, lean_sigma, length_px = measured[index].T
        edges = Edges.from_columns(
            *complete(bearing, bearing_sigma, lean, lean_sigma, camera.mount.tilt_rad),
            length_px=length_px,
            polarity=polarity[index],
            landmark_id=identified[index],
        )
        frames.append(Sighting(t_ns, edges))
    return frames, named


def _landmarks(table: Table) -> tuple[NDArray[np.int64], dict[str, Place]]:
    """Return the number (R,) of each row's landmark, -1 for none, and the landmarks that are named."""
    number, order, named = np.full(len(table), -1, dtype=np.int64), dict[str, int](), dict[str, Place]()
    for row, name in enumerate(table.columns.get("landmark_id", [])):
        if name:
            number[row] = order.setdefault(name, len(order))
            named.setdefault(name, Place(str(table.path), table.lines[row]))
    return number, named


def _check_row(table: Table, row: int, measured: Array, found: np.bool_) -> None:
    """Raise InputError unless every angle lies in front of the camera and has a sigma, and an edge has an angle."""
    known = dict(zip(_MEASURED, ~np.isnan(measured), strict=True))
    if not found and (any(known.values()) or table.columns["polarity"][row]):
        raise table.error(row, "bearing_rad", "expected a bearing or a lean, found neither")
    for place, name in ((0, "bearing"), (2, "lean")):
        if known[f"{name}_rad"] != known[f"{name}_sigma_rad"]:
            missing = "sigma_rad" if known[f"{name}_rad"] else "rad"
            raise table.error(row, f"{name}_{missing}", f"expected {name}_rad and {name}_sigma_rad, found one of them")
        if abs(measured[place]) >= np.pi / 2:
            given = table.columns[f"{name}_rad"][row]
            raise table.error(row, f"{name}_rad", f"expected a {name} within ±90° of the camera's axis, found {given}")


def write_edges(frames: Iterable[Sighting], camera: Camera, path: Path, ids: Sequence[int | str] = ()) -> None:
    """Write the table of edges, a frame without any as a row with the time alone. Raises OutputError.

    ids: of the landmarks that `landmark_id` of an edge numbers; where there are none, that number is the id.
    """
    rows: list[list[object]] = [[column.name for column in COLUMNS]]
    for frame in frames:
        edges = frame.edges
        bearing = wrap_angle(edges.bearing - camera.at(edges.mount).mount.yaw_rad)
        measured = (bearing, edges.bearing_sigma, edges.lean, edges.lean_sigma, edges.length_px)
        for row in range(len(edges)):
            cells: list[object] = [str(frame.t_ns)]
            cells += ["" if np.isnan(column[row]) else repr(float(column[row])) for column in measured]
            cells += [str(edges.polarity[row]) if edges.polarity[row] else ""]
            landmark = int(edges.landmark_id[row])
            cells += ["" if landmark < 0 else str(ids[landmark] if ids else landmark)]
            rows.append(cells)
        if len(edges) == 0:
            rows.append([frame.t_ns, *[""] * (len(COLUMNS) - 1)])
    write_text(path, csv_of(rows))
