"""Verdicts for people: a table of the figures that are not as they were, and a summary."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence

from rich.table import Table

from figures.compare import LOSSES, ORDER, Compared, Figure, Value


def table_of(verdicts: Sequence[Compared]) -> Table:
    """Return the figures that are not as they were, what is worse at the end."""
    table = Table("figure", title="Figures that are not as they were")
    for name in ("baseline", "now", "tolerance"):
        table.add_column(name, justify="right")
    table.add_column("verdict")
    for one in sorted(verdicts, key=lambda one: ORDER.index(one.verdict)):
        if one.verdict != "same":
            before = one.before.value if one.before else None
            allowed = _allowed(one.before) if one.before and one.now is not None else ""
            verdict = f"{one.verdict}: {one.reason}" if one.reason else one.verdict
            table.add_row(" · ".join(one.key), _shown(before), _shown(one.now), allowed, verdict)
    return table


def _allowed(figure: Figure) -> str:
    """Return the tolerance with its direction; of what should be one it is a factor away from there."""
    if figure.loss == "from one":
        return f"×÷ {math.exp(figure.tolerance):.3g}"
    return {"up": "+", "down": "−", "change": ""}[figure.loss] + f"{figure.tolerance:.3g}"


def _shown(value: Value | None) -> str:
    if value is None:
        return ""
    return value[:10] if isinstance(value, str) else f"{value:.5g}"


def summary_of(verdicts: Sequence[Compared]) -> str:
    """Return how many figures of each group had which verdict, and what it comes to."""
    lines = []
    for group in dict.fromkeys(one.key[0] for one in verdicts):
        counts = Counter(one.verdict for one in verdicts if one.key[0] == group)
        told = ", ".join(f"{counts[verdict]} {verdict}" for verdict in ORDER if counts[verdict])
        lines.append(f"{group:10} {told}")
    lost = sum(one.verdict in LOSSES for one in verdicts)
    skipped = sum(one.verdict == "skipped" for one in verdicts)
    unseen = f"; {skipped} figures were not looked at" if skipped else ""
    return "\n".join([*lines, (f"{lost} figures are worse" if lost else "nothing is worse") + unseen])
