"""What the command prints: the edges of a single image, and what detectors found in all."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import numpy as np

from localiser.commands.edges.records import Row, mount_by_edges, rows_of
from localiser.commands.edges.run import EdgeRun
from localiser.edges import Edges

if TYPE_CHECKING:
    from rich.table import Table

_MOST_ROWS = 60
UNKNOWN = "–"


def tables_of(run: EdgeRun) -> Iterator[Table | str]:
    """Yield the edges (or that there are none) where one detector saw one image, else the comparison of detectors."""
    if len(run.images) == 1 and len(run.detectors) == 1:
        (edges,) = run.last.values()
        if len(edges) == 0:
            yield f"No vertical edges in {run.images[0].image}; segments rejected: {len(edges.rejected_px)}"
            return
        table = _edge_table(rows_of(edges), run.images[0].image)
        table.caption = _mount_text(run, edges)
        yield table
    else:
        yield _detector_table(run.comparison.rows())
    if len(run.detectors) > 1:
        yield _agreement_table(run.comparison.rows())


def _edge_table(rows: list[Row], image: str) -> Table:
    from rich.box import SIMPLE_HEAD
    from rich.table import Table

    table = Table(title=f"{len(rows)} vertical edges in {image}", title_justify="left", box=SIMPLE_HEAD, pad_edge=False)
    titles = (
        "edge",
        "bearing °",
        "sigma °",
        "lean °",
        "sigma °",
        "slope °",
        "vertical %",
        "length px",
        "side",
        "foot m",
        "± m",
        "foot %",
    )
    for title in titles:
        table.add_column(title, justify="right", no_wrap=True)
    for row in rows[:_MOST_ROWS]:
        degrees = [np.rad2deg(row[name]) for name in ("bearing_rad", "bearing_sigma_rad", "lean_rad", "lean_sigma_rad")]
        specs = ("+.2f", ".3f", "+.2f", ".2f")
        angles = [format(angle, spec) for angle, spec in zip(degrees, specs, strict=True)]
        side = {1: "lighter right", -1: "lighter left"}.get(row["polarity"], UNKNOWN)
        foot = [_text(row[name], ".2f") for name in ("foot_range_m", "foot_range_sigma_m")]
        foot.append(_text(100 * row["foot_probability"], ".0f"))
        lengths = _text(100 * row["vertical_probability"], ".0f"), f"{row['length_px']:.0f}"
        table.add_row(str(row["edge"]), *angles, f"{row['slope_deg']:.2f}", *lengths, side, *foot)
    if len(rows) > _MOST_ROWS:
        table.add_row(f"{len(rows) - _MOST_ROWS} more in edges.csv")
    return table


def _mount_text(run: EdgeRun, edges: Edges) -> str:
    found = mount_by_edges(edges, run.camera, run.config.edges)
    stated = np.rad2deg([run.camera.mount.tilt_rad, run.camera.mount.roll_rad])
    parts = [
        f"{name} {found[f'{name}_deg']:.2f} ± {found[f'{name}_sigma_deg']:.2f}° (stated {value:.2f}°)"
        for name, value in zip(("tilt", "roll"), stated, strict=True)
    ]
    return "By these edges: " + ", ".join(parts)


def _detector_table(rows: list[dict[str, Any]]) -> Table:
    from rich.box import SIMPLE_HEAD
    from rich.table import Table

    images = rows[0]["images"]
    title = f"Vertical edges in {images} image{'' if images == 1 else 's'}"
    table = Table(title=title, title_justify="left", box=SIMPLE_HEAD, pad_edge=False)
    columns = (
        ("edges", "edges", "d"),
        ("an image", "edges_per_image", ".1f"),
        ("rejected", "rejected_per_image", ".1f"),
        ("on floor", "feet_per_image", ".1f"),
        ("length px", "length_median_px", ".0f"),
        ("sigma °", "bearing_sigma_median_deg", ".3f"),
        ("ms", "ms_median", ".1f"),
    )
    table.add_column("detector")
    for name, _, _ in columns:
        table.add_column(name, justify="right", no_wrap=True)
    for row in rows:
        table.add_row(row["detector"], *(_text(row[key], spec) for _, key, spec in columns))
    table.caption = (
        "edges in all, then per image, feet by their probability; medians of length, bearing's sigma and time"
    )
    return table


def _agreement_table(rows: list[dict[str, Any]]) -> Table:
    from rich.box import SIMPLE_HEAD
    from rich.table import Table

    table = Table(title="Edges of … also found by …", title_justify="left", box=SIMPLE_HEAD, pad_edge=False)
    names = [row["detector"] for row in rows]
    table.add_column("")
    for name in names:
        table.add_column(name, justify="right", no_wrap=True)
    for row in rows:
        table.add_row(row["detector"], *(UNKNOWN if name == row["detector"] else _shared(row, name) for name in names))
    table.caption = "share of edges, and the median distance of their bearings"
    return table


def _shared(row: dict[str, Any], other: str) -> str:
    if row["edges"] == 0:
        return UNKNOWN
    return f"{row[f'share_also_{other}']:.0%}, {_text(row[f'apart_median_{other}_deg'], '.3f')}°"


def _text(value: float, spec: str) -> str:
    return format(value, spec) if np.isfinite(value) else UNKNOWN
