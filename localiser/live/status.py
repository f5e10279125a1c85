"""What a live run looks like in the terminal: one line while it runs, a table at its end."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from localiser.live.monitor import Monitor

if TYPE_CHECKING:
    from rich.table import Table

    from localiser.live.run import LiveRun

# Key in `Monitor.figures`, how it reads, format, and what it is multiplied by.
ROWS = (
    ("located", "images located", "{:.0f}", 1.0),
    ("rate_hz", "rate", "{:.1f} Hz", 1.0),
    ("latency_median_ms", "latency, median", "{:.0f} ms", 1.0),
    ("latency_99_ms", "latency, 99 %", "{:.0f} ms", 1.0),
    ("edges_and_filter_median_ms", "edges and filter, median", "{:.0f} ms", 1.0),
    ("edges_and_filter_99_ms", "edges and filter, 99 %", "{:.0f} ms", 1.0),
    ("sure", "images sure", "{:.0f} %", 100.0),
    ("edges_matched", "edges matched", "{:.0f} %", 100.0),
    ("error_rmse_m", "error, RMSE", "{:.3f} m", 1.0),
    ("error_worst_m", "error, worst", "{:.3f} m", 1.0),
)


def status_line(monitor: Monitor) -> str:
    """Return where the robot is, how sure that is, and how the run goes, the most important first."""
    frame = monitor.newest
    if frame is None:
        return "waiting for the first image"
    located, landmark = frame.located, frame.matches.landmark
    x, z, heading = located.estimate.pose
    cov = located.estimate.pose_cov
    matched = int((landmark >= 0).sum())
    parts = [
        f"{x:.2f}, {z:.2f} ± {np.sqrt(np.trace(cov[:2, :2])):.2f} m",
        f"{np.degrees(heading):.1f} ± {np.degrees(np.sqrt(cov[2, 2])):.1f}°",
        f"sure {located.p_correct:.2f}" + (f" ({located.reason})" if located.reason else ""),
        f"{monitor.warnings} warning{'s' * (monitor.warnings > 1)}" if monitor.warnings else "",
        f"{monitor.rate_now_hz:.1f} Hz",
        f"{monitor.work_ms[-1]:.0f} ms",
        f"edges {matched}/{len(landmark)}",
    ]
    return "  ".join(part for part in parts if part)


def end_table(run: LiveRun) -> Table:
    """Return what a run came to: its figures, what was wrong how often, and what was left out."""
    figures = run.monitor.figures()
    rows = {label: text.format(figures[key] * per) for key, label, text, per in ROWS if key in figures}
    return table_of(rows, run.monitor.wrong, _left_out(run))


def table_of(figures: Mapping[str, str], wrong: Mapping[str, int], left_out: Mapping[str, int]) -> Table:
    """Return a table of figures, and of counts of what was wrong and left out."""
    from rich.box import SIMPLE_HEAD
    from rich.table import Table

    table = Table(title="Live run", title_justify="left", box=SIMPLE_HEAD, show_header=False, pad_edge=False)
    table.add_column("figure")
    table.add_column("value", justify="right")
    for label, text in figures.items():
        table.add_row(label, text)
    for title, counts in (("warning", wrong), ("left out", left_out)):
        for kind, count in counts.items():
            table.add_row(f"{title}: {kind}", str(count))
    return table


def _left_out(run: LiveRun) -> dict[str, int]:
    left_out = {**run.timeline.skipped, **{f"{role} dropped": n for role, n in run.inbox.dropped.items()}}
    if run.timeline.late_odometry:
        left_out["odometry"] = run.timeline.late_odometry
    return left_out
