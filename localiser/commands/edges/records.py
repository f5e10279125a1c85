"""The edges of one image as rows for CSV and JSON, each value with its unit in its name."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from localiser import geometry
from localiser.camera import Camera
from localiser.edges import PROFILE_OFFSETS_PX, EdgeParameters, Edges, mount_error_of_edges
from localiser.storage import csv_of

Row = dict[str, Any]

FLOOR = 0.5
"""A lower end that is as likely as this stands on the floor."""


def foot_flag(edges: Edges) -> NDArray[np.str_]:
    """Return (E,) floor, hidden or outside: what the lower end most likely is; empty where that is not known."""
    unseen = np.where(edges.foot_probability == 0, "outside", "")
    return np.where(np.isnan(edges.foot_range_m), unseen, np.where(edges.foot_probability >= FLOOR, "floor", "hidden"))


COLUMNS = {
    "edge": "number in the picture, from left to right",
    "bearing_rad": "direction from the camera's forward axis, positive right, of the line held through the nadir point",
    "bearing_sigma_rad": "its standard deviation",
    "lean_rad": "angle of the free line from the image's vertical, top to the right positive, roll undone",
    "lean_sigma_rad": "its standard deviation",
    "slope": "the paper's slope m = 1 / tan(lean)",
    "slope_deg": "the paper's slope as an angle, from the image's horizontal: 90 is vertical",
    "vertical_probability": "how likely it is a vertical edge and not another line that points at the nadir point",
    "length_px": "visible length",
    "polarity": "1 dark to light from left to right, -1 light to dark, 0 unknown",
    "bottom_u_px": "lower end in the image as taken, to the right of the top-left pixel's centre",
    "bottom_v_px": "and below it",
    "top_u_px": "upper end",
    "top_v_px": "and below the top-left pixel's centre",
    "foot_range_m": "floor distance of the lower end from the camera, if it stands on the floor; empty if not seen",
    "foot_range_sigma_m": "its standard deviation, the mount's error left out",
    "foot_probability": "how likely the lower end stands on the floor",
    "foot": "floor: likely; hidden: likelier something else, such as what stands in front; outside: not in the image",
    "foot_right_m": "that floor point to the right of the camera",
    "foot_back_m": "and behind it, so negative ahead",
}

PROFILE = (
    f"grey values across it, {PROFILE_OFFSETS_PX[0]:g} … {PROFILE_OFFSETS_PX[-1]:g} px from it in equal steps, left to "
    "right, means along it; JSON only"
)


def rows_of(edges: Edges) -> list[Row]:
    """Return one row an edge with the keys of `COLUMNS`; what is not known is nan."""
    computed = {
        "edge": np.arange(1, len(edges) + 1),
        "slope": geometry.slope_from_lean(edges.lean),
        "slope_deg": 90.0 - np.rad2deg(edges.lean),
        "foot": foot_flag(edges),
        "foot_right_m": edges.foot_range_m * np.sin(edges.bearing),
        "foot_back_m": -edges.foot_range_m * np.cos(edges.bearing),
    }
    ends = ("bottom_u_px", "bottom_v_px", "top_u_px", "top_v_px")
    computed |= dict(zip(ends, edges.ends_px.reshape(-1, 4).T, strict=True))
    columns = (computed.get(name, getattr(edges, name.removesuffix("_rad"), None)) for name in COLUMNS)
    values = [np.asarray(column).tolist() for column in columns]
    return [dict(zip(COLUMNS, cells, strict=True)) for cells in zip(*values, strict=True)]


def mount_by_edges(edges: Edges, camera: Camera, parameters: EdgeParameters) -> dict[str, float]:
    """Return the tilt and roll of the camera by the edges of one image, from what is stated and how certain that is."""
    stated = np.array([camera.mount.tilt_rad, camera.mount.roll_rad])
    plumb_rad = float(np.deg2rad(parameters.plumb_sigma_deg))
    error = mount_error_of_edges(edges, camera, parameters.mount_sigma_rad, plumb_rad)
    found = np.rad2deg([stated + error.mean, np.sqrt(np.diag(error.cov))])
    return dict(zip(("tilt_deg", "roll_deg", "tilt_sigma_deg", "roll_sigma_deg"), found.ravel().tolist(), strict=True))


def csv_text(columns: Iterable[str], rows: Iterable[Mapping[str, Any]], *, header: bool = True) -> str:
    """Return rows as CSV; nan and None are empty cells, numbers read back to the same value."""
    names = list(columns)
    head = [names] if header else []
    return csv_of([*head, *([_cell(row[name]) for name in names] for row in rows)])


def _cell(value: object) -> object:
    return "" if value is None or (isinstance(value, float) and math.isnan(value)) else value
