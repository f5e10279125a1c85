"""The scenarios of benchmarks/robustness.py, with some seeds each."""

from __future__ import annotations

from functools import partial

from figures.measures import Measure
from figures.tasks import Task, Values

SCENARIOS = ("global office", "global corridor", "kidnapped", "clutter", "empty", "normal")
NEVER_BACK = 101  # frames; a robot must be back within 100
MEASURES = {
    "passed": Measure("down", "mean"),
    "error_m": Measure("up"),
    "rmse_m": Measure("up"),
    "sure_wrong": Measure("up", "mean"),
    "doubtful_right": Measure("up", "mean"),
    "back_frames": Measure("up"),
}


def tasks(seeds: int) -> list[Task]:
    """Return what is measured."""
    return [
        Task("scenarios", f"{scenario} {kind}", seed, partial(outcome, scenario, kind, seed))
        for seed in range(seeds)
        for scenario in SCENARIOS
        for kind in ("line", "slope")
    ]


def outcome(scenario: str, observation: str, seed: int) -> Values:
    """Return what one run came to; shares are of its frames, and what is excused has passed."""
    import trials

    one = trials.run(scenario, observation, seed)
    values: Values = {
        "passed": float(one.passed or one.excused),
        "error_m": one.error_m,
        "rmse_m": one.rmse_m,
        "sure_wrong": one.sure_wrong / one.frames,
        "doubtful_right": one.doubtful_right / one.frames,
    }
    if scenario == "kidnapped":
        values["back_frames"] = float(one.back_frames if one.back_frames >= 0 else NEVER_BACK)
    return values
