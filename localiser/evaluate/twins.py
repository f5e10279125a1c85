"""Identical runs: the same log, settings and seed give the same figures, which must not count twice in a median."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

TIMES = ("frame_ms_median", "frame_ms_p95", "stage_ms")
"""What differs between identical runs."""


def without_twins(runs: Mapping[str, Mapping[str, Any]]) -> tuple[dict[str, Mapping[str, Any]], dict[str, str]]:
    """Return the runs that differ, each by the first of its names, and for each other name the run it is identical to.

    Two runs are identical where all their figures are, but for what a frame took. Seeds are among the figures.
    """
    first: dict[str, str] = {}
    twins: dict[str, str] = {}
    for name, figures in runs.items():
        content = json.dumps({key: figures[key] for key in figures if key not in TIMES}, sort_keys=True)
        if first.setdefault(content, name) != name:
            twins[name] = first[content]
    return {name: runs[name] for name in first.values()}, twins
