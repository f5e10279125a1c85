"""One run of the filter, as it ships, on a trial of `scenarios.py`, and what it came to."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache, partial

import numpy as np
import scenarios
from observable import is_observable
from scenarios import Trial

from localiser.config import Config, read_config
from localiser.filter import Event, FilterState, Mcl, Odometry, Sighting, step
from localiser.geometry import Array, wrap_angle
from localiser.observation import EdgeObservation
from localiser.relocalisation.global_localisation import GlobalLocalisation

CORRECT_M, CORRECT_RAD = 0.5, np.deg2rad(10.0)  # what `Located.p_correct` speaks of
BACK_M, BACK_FRAMES, BACK_WAY_M, SETTLED_FRAMES = 0.25, 100, 8.0, 5
SURE, DOUBTFUL = 0.9, 0.5
HELD_M = {"line": 0.25, "slope": 0.6}

SCENARIOS: dict[str, Callable[[int], Trial]] = {
    "global office": partial(scenarios.whereabouts, "office"),
    "global corridor": partial(scenarios.whereabouts, "corridor"),
    "kidnapped": scenarios.kidnapped,
    "clutter": scenarios.clutter,
    "empty": scenarios.empty,
    "normal": scenarios.normal,
}


@dataclass(frozen=True, slots=True, eq=False)
class Told:
    """What the filter said of T images: position error (m), heading error (rad), p_correct, all (T,)."""

    error_m: Array
    turned_rad: Array
    p_correct: Array

    @property
    def wrong(self) -> Array:
        """Whether (T,) the estimate is not within 0.5 m and 10°."""
        return (self.error_m > CORRECT_M) | (self.turned_rad > CORRECT_RAD)


@dataclass(frozen=True, slots=True)
class Outcome:
    """What one run came to.

    passed: whether it met the scenario's bar. error_m: what was judged. frames: judged. sure_wrong, doubtful_right: how
    many of them the filter was sure and wrong in, doubtful and right in. back_frames: until it was back, -1 if never.
    excused: whether a start from nowhere is not judged, since the images cannot tell the place; see `observable`.
    """

    scenario: str
    observation: str
    seed: int
    passed: bool
    error_m: float
    rmse_m: float
    frames: int
    sure_wrong: int
    doubtful_right: int
    back_frames: int
    excused: bool


def run(scenario: str, observation: str, seed: int, settings: tuple[str, ...] = ()) -> Outcome:
    """Return what the filter makes of one seed of a scenario."""
    trial, config, excused = SCENARIOS[scenario](seed), configured(observation, settings), False
    told = told_by(trial, config, seed)
    judged = slice(trial.judged, None)
    wrong, sure, doubtful = told.wrong[judged], told.p_correct[judged] > SURE, told.p_correct[judged] < DOUBTFUL
    back = _back_after(trial, told)
    if scenario.startswith("global"):
        error_m = float(told.error_m[BACK_FRAMES])
        passed = error_m <= BACK_M
        seen_by = EdgeObservation(trial.camera, config.observation)
        excused = not passed and not is_observable(trial, seen_by, config.motion, BACK_FRAMES)
    elif trial.carried is not None:
        error_m, passed = float(told.error_m[-1]), back >= 0
    else:
        error_m = float(told.error_m[judged].max())
        passed = error_m <= (CORRECT_M if scenario == "normal" else HELD_M[observation])
    return Outcome(
        scenario,
        observation,
        seed,
        bool(passed),
        error_m,
        float(np.sqrt(np.square(told.error_m[judged]).mean())),
        len(wrong),
        int((wrong & sure).sum()),
        int((~wrong & doubtful).sum()),
        back,
        excused,
    )


@cache
def configured(observation: str, settings: tuple[str, ...]) -> Config:
    """Return the configuration as it ships, with `settings` on top."""
    return read_config(None, [f"observation.kind={observation}", *settings])


def told_by(trial: Trial, config: Config, seed: int) -> Told:
    """Return what the filter says along a trial."""
    observation = EdgeObservation(trial.camera, config.observation)
    search = GlobalLocalisation.of(observation, trial.landmark_map, config.search)
    mcl = Mcl(trial.landmark_map, observation, config.mcl, config.motion, config.observation, search=search)
    state, rng = FilterState(), np.random.default_rng([seed, 2])
    located = [result for event in _events(trial) for result in step(mcl, state, event, rng)]
    error = np.array([result.estimate.pose for result in located]) - trial.truth.poses
    return Told(
        np.hypot(error[:, 0], error[:, 1]),
        np.abs(wrap_angle(error[:, 2])),
        np.array([result.p_correct for result in located]),
    )


def _events(trial: Trial) -> Iterator[Event]:
    if trial.start is not None:
        yield trial.start
    for t_ns, pose, frame in zip(trial.odometry.t_ns, trial.odometry.poses, trial.frames, strict=True):
        yield Odometry(int(t_ns), pose)
        yield Sighting(int(t_ns), frame)


def _back_after(trial: Trial, told: Told) -> int:
    """Return how many frames after it was carried, or began, the robot is back for good; -1 when too late or never."""
    first = trial.carried or 0
    step_m = np.hypot(*np.diff(trial.truth.poses[first:, :2], axis=0).T)
    way_m = np.concatenate([[0.0], np.cumsum(step_m)])
    right = (told.error_m[first:] <= BACK_M) & (told.turned_rad[first:] <= CORRECT_RAD)
    settled = np.convolve(right, np.ones(SETTLED_FRAMES), "valid") == SETTLED_FRAMES
    in_time = (way_m[: len(settled)] <= BACK_WAY_M) & (np.arange(len(settled)) <= BACK_FRAMES)
    found = np.flatnonzero(settled & in_time)
    return int(found[0]) if found.size else -1
