"""The figures of a run as one flat row, so that tables and other programs can read them.

A figure of a group is named `group.figure`, as in `confidence.sure`. A list becomes its length, but texts are joined.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

TIMES = ("frame_ms_median", "frame_ms_p95", "stage_ms.")
"""How the names begin of figures that tell how long something took: alone of all, they differ from run to run."""


def figure_at(figures: Mapping[str, Any], name: str) -> Any:
    """Return the figure of that name, as `flat_figures` has it (`group.figure`), None where it is not there."""
    value: Any = figures
    for part in name.split("."):
        value = value.get(part) if isinstance(value, Mapping) else None
    return value


def flat_figures(figures: Mapping[str, Any]) -> dict[str, Any]:
    """Return metrics as a row of numbers, truth values, texts and None, in the order that they have.

    Why images were not sure (`confidence.reasons`) is one text, `reason (images); …`, since its keys differ from run to
    run.
    """
    return dict(_flat(figures, ""))


def is_time(name: str) -> bool:
    """Whether a figure tells how long something took."""
    return name.startswith(TIMES)


def _flat(figures: Mapping[str, Any], prefix: str) -> Iterator[tuple[str, Any]]:
    for key, value in figures.items():
        name = f"{prefix}{key}"
        if key == "reasons" and isinstance(value, Mapping):
            yield name, "; ".join(f"{reason} ({count})" for reason, count in value.items()) or None
        elif isinstance(value, Mapping):
            yield from _flat(value, f"{name}.")
        elif isinstance(value, list):
            texts = [one for one in value if isinstance(one, str)]
            yield name, " ".join(texts) or None if texts or key == "warnings" else len(value)
        else:
            yield name, value
