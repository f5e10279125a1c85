"""What the command prints: the edges of a single image, and what detectors found in all."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING, Any

import numpy as np

from localiser.commands.edges.records import Row, rows_of
from localiser.commands.edges.run import EdgeRun

if TYPE_CHECKING:
    from rich.table import Table

_MOST_ROWS = 60
UNKNOWN = "–"
_SIDES = {1: "lighter right", -1: "lighter left"}
_DEG = np.rad2deg(1.0)

Columns = tuple[tuple[str, str, float, str], ...]
"""Title, key of the row, factor, and format of a number."""
_EDGE: Columns = (
    ("edge", "edge", 1, "d"),
    ("bearing °", "bearing_rad", _DEG, "+.2f"),
    ("sigma °", "bearing_sigma_rad", _DEG, ".3f"),
    ("lean °", "lean_rad", _DEG, "+.2f"),
    ("sigma °", "lean_sigma_rad", _DEG, ".2f"),
    ("slope °", "slope_deg", 1, ".2f"),
    ("vertical %", "vertical_probability", 100, ".0f"),
    ("length px", "length_px", 1, ".0f"),
    ("side", "side", 1, ""),
    ("foot m", "foot_range_m", 1, ".2f"),
    ("± m", "foot_range_sigma_m", 1, ".2f"),
    ("foot %", "foot_probability", 100, ".0f"),
)
_DETECTOR: Columns = (
    ("detector", "detector", 1, ""),
    ("edges", "edges", 1, "d"),
    ("an image", "edges_per_image", 1, ".1f"),
    ("rejected", "rejected_per_image", 1, ".1f"),
    ("on floor", "feet_per_image", 1, ".1f"),
    ("length px", "length_median_px", 1, ".0f"),
    ("sigma °", "bearing_sigma_median_deg", 1, ".3f"),
    ("ms", "ms_median", 1, ".1f"),
)


def tables_of(run: EdgeRun) -> Iterator[Table | str]:
    """Yield the edges (or that there are none) where one detector saw one image, else the comparison of detectors."""
    compared = run.comparison.rows()
    if len(run.images) == 1 and len(run.detectors) == 1:
        ((name, edges),) = run.last.items()
        image = run.images[0].image
        if len(edges) == 0:
            yield f"No vertical edges in {image}; segments rejected: {len(edges.rejected_px)}"
            return
        rows = [{**row, "side": _SIDES.get(row["polarity"], UNKNOWN)} for row in rows_of(edges)]
        table = _table(f"{len(rows)} vertical edges in {image}", _EDGE, rows[:_MOST_ROWS])
        if len(rows) > _MOST_ROWS:
            table.add_row(f"{len(rows) - _MOST_ROWS} more in edges.csv")
        table.caption = _mount_text(run, run.mounts[name])
    else:
        images = compared[0]["images"]
        table = _table(f"Vertical edges in {images} image{'' if images == 1 else 's'}", _DETECTOR, compared)
        table.columns[0].justify = "left"
        table.caption = (
            "edges in all, then per image, feet by their probability; medians of length, bearing's sigma and time"
        )
    yield table
    if len(run.detectors) > 1:
        yield _agreement_table(compared)


def _table(title: str, columns: Columns, rows: Iterable[Row]) -> Table:
    from rich.box import SIMPLE_HEAD
    from rich.table import Table

    table = Table(title=title, title_justify="left", box=SIMPLE_HEAD, pad_edge=False)
    for name, _, _, _ in columns:
        table.add_column(name, justify="right", no_wrap=True)
    for row in rows:
        table.add_row(*(_text(row[key], factor, spec) for _, key, factor, spec in columns))
    return table


def _text(value: Any, factor: float, spec: str) -> str:
    if isinstance(value, str):
        return value
    return format(value * factor, spec) if np.isfinite(value) else UNKNOWN


def _mount_text(run: EdgeRun, found: dict[str, float]) -> str:
    stated = np.rad2deg([run.camera.mount.tilt_rad, run.camera.mount.roll_rad])
    parts = [
        f"{name} {found[f'{name}_deg']:.2f} ± {found[f'{name}_sigma_deg']:.2f}° (stated {value:.2f}°)"
        for name, value in zip(("tilt", "roll"), stated, strict=True)
    ]
    return "By these edges: " + ", ".join(parts)


def _agreement_table(rows: list[dict[str, Any]]) -> Table:
    names = [row["detector"] for row in rows]
    columns = (("", "detector", 1.0, ""), *((name, f"text {name}", 1.0, "") for name in names))
    shared = [{**row, **{f"text {name}": _shared(row, name) for name in names}} for row in rows]
    table = _table("Edges of … also found by …", columns, shared)
    table.columns[0].justify = "left"
    table.caption = "share of edges, and the median distance of their bearings"
    return table


def _shared(row: dict[str, Any], other: str) -> str:
    if row["edges"] == 0 or row["detector"] == other:
        return UNKNOWN
    return f"{row[f'share_also_{other}']:.0%}, {_text(row[f'apart_median_{other}_deg'], 1, '.3f')}°"
