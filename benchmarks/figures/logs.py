"""How well the filter follows whole logs: errors, NEES, and how sure it was, each with many seeds."""

from __future__ import annotations

import json
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

from figures.inputs import CORRIDOR
from figures.measures import Measure
from figures.program import run
from figures.tasks import Task, Values

MEASURES = {
    "position_rmse_m": Measure("up"),
    "position_median_m": Measure("up"),
    "heading_rmse_deg": Measure("up"),
    "nees / 3": Measure("from one"),
    "sure": Measure("down", "mean"),
    "sure_and_wrong": Measure("up", "mean"),
}


def tasks(data: Path, seeds: int) -> list[Task]:
    """Return what is measured. data: folder of the logs that do not ship."""
    both, near = ("line", "slope"), ("--start", "truth")
    logs: list[tuple[str, Path, str, tuple[str, ...], tuple[str, ...]]] = [
        ("corridor", CORRIDOR, "", both, ()),
        ("house", data / "house", "", both, near),
        ("bookstore", data / "bookstore", "", both, near),
    ]
    logs += [(f"mrclam {robot}", data / "mrclam", f":{robot}", ("line",), near) for robot in (1, 2, 3)]
    return [
        Task("logs", f"{name} {kind}", seed, partial(judged, f"{folder}{robot}", kind, seed, options), folder)
        for seed in range(seeds)
        for name, folder, robot, kinds, options in logs
        for kind in kinds
    ]


def judged(log: str, observation: str, seed: int, options: tuple[str, ...]) -> Values:
    """Return the figures of one replay."""
    with TemporaryDirectory() as name:
        out = Path(name) / "out"
        asked = ("--observation", observation, "--seed", seed, "--out", out, "--quiet", "--no-rrd", *options)
        run("replay", log, *asked, cache=Path(name) / "cache")
        (written,) = out.glob("*/1/metrics.json")
        metrics = json.loads(written.read_text(encoding="utf-8"))
    sure = metrics["confidence"]
    values = metrics | sure | {"nees / 3": metrics["nees_mean"] / 3}
    return {measure: float(values[measure]) for measure in MEASURES}
