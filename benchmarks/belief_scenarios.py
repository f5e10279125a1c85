"""The scenarios that the belief is judged by: which cases each has, and what one run of a case comes to.

Values are numbers by name; infinite is "never", nan "not asked here". `claims` are of all runs that have a truth.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import product
from time import perf_counter

import belief_drives as drives
import belief_maps as maps
import numpy as np
import scenarios
from belief_buildings import HOURS, KINDS
from belief_drives import LOGS, drive_of, is_there
from belief_run import CORRECT_M, Drive, Record, first_of, run, settled_at
from belief_score import Claims
from belief_worlds import hours_of

About = tuple[str, ...]
Values = dict[str, float]
BEGIN_S = 3.0  # what is said earlier on a wrong map is not judged
BACK_M = 0.25
MINUTES = 12.0  # of a drive in a simulated building: ten seeds of six kinds are twelve hours
SHOP_MINUTES = 1.5
OF_ONE_KIND = ("floor", "corridors", "shelves")  # kinds whose buildings are judged on each other's maps
DOUBTFUL, FEWEST_EXPECTED, FEWEST_SHOWN = 0.5, 3, 5
NEVER = math.inf


@dataclass(frozen=True, slots=True)
class Case:
    """One thing that is measured with many seeds. about: what it is, the observation last."""

    scenario: str
    about: About

    @property
    def name(self) -> str:
        """Its name within the scenario."""
        return " ".join(self.about)


@dataclass(frozen=True, slots=True, eq=False)
class Outcome:
    """What one run of a case came to. claims: None where nothing is judged but time. wall_s: how long it took."""

    case: Case
    seed: int
    values: Values
    claims: Claims | None
    wall_s: float


@dataclass(frozen=True, slots=True)
class Scenario:
    """Its cases, from the observations asked for; and what one of them comes to with one seed."""

    cases: Callable[[Sequence[str]], list[About]]
    judge: Callable[..., tuple[Values, Record]]
    claims: bool = True
    kinds: tuple[str, ...] = ("line",)

    def asked(self, name: str, kinds: Sequence[str] | None, minutes: float = MINUTES) -> list[Case]:
        """Return the cases whose data is there.

        kinds: of observation, its own where None. minutes: of a simulated drive.
        """
        every = self.cases(kinds or self.kinds)
        found = [Case(name, tuple(word.format(minutes=minutes) for word in about)) for about in every]
        return [case for case in found if all(is_there(word) for word in (name, *case.about) if word in drives.NAMES)]


def outcome(case: Case, seed: int) -> Outcome:
    """Return what one seed of a case comes to."""
    begin, scenario = perf_counter(), SCENARIOS[case.scenario]
    values, record = scenario.judge(*case.about, seed=seed)
    claims = None
    if scenario.claims:
        claims = Claims.of(record.p_correct, record.right)
        values |= {"log_score": claims.log_score / len(record.right)}
    return Outcome(case, seed, values, claims, perf_counter() - begin)


# -- tracking ----------------------------------------------------------------------------------------------------------


def tracking(log: str, start: str, kind: str, *, seed: int) -> tuple[Values, Record]:
    """A log on its own map, from a start near the truth or from anywhere; `shop` is another one with every seed."""
    drive = hours_of("shelves", seed, SHOP_MINUTES) if log == "shop" else drive_of(log)
    record = run(drive, kind, seed, start="truth" if start == "truth" else None)
    return tracked(record), record


def tracked(record: Record) -> Values:
    """Return how well a run follows the truth. Found is the first of five images in succession that are right."""
    found = settled_at(record.right)
    after = slice(found if found >= 0 else len(record.right), None)
    missing = found < 0
    return {
        "rmse_m": rms(record.error_m),
        "median_m": float(np.median(record.error_m)),
        "rmse_found_m": NEVER if missing else rms(record.error_m[after]),
        "nees / 3": float(np.nanmean(record.nees)) / 3,
        "sure": float(record.sure.mean()),
        "sure_found": 0.0 if missing else float(record.sure[after].mean()),
        "sure_wrong": float((record.sure & ~record.right).mean()),
        "found_s": NEVER if missing else float(record.seconds[found]),
        "lost_images": float((~record.right[after]).sum()),
    }


def rms(error_m: np.ndarray) -> float:
    """Return the root of the mean square."""
    return float(np.sqrt(np.square(error_m).mean()))


# -- maps ----------------------------------------------------------------------------------------------------------


def wrong(log: str, other: str, start: str, kind: str, *, seed: int) -> tuple[Values, Record]:
    """A log on a map of another building, or on a null world made of its own map.

    log: a log, or a kind of simulated building: then the map is `another` of its kind. start: `own` is the log's true
    pose, `theirs` the first pose of the other log, `none` anywhere.
    """
    drive = hours_of(log, seed, SHOP_MINUTES) if log in KINDS else drive_of(log)
    if other == "another":
        landmark_map = hours_of(log, seed + 1, 0.1).landmark_map
    elif other == "mirrored":
        landmark_map = maps.mirrored(drive.landmark_map)
    elif other == "shuffled":
        landmark_map = maps.shuffled(drive.landmark_map, seed)
    else:
        landmark_map = drive_of(other).landmark_map
    stated = {"own": lambda: drive.truth[0], "theirs": lambda: drive_of(other).truth[0], "none": lambda: None}[start]()
    record = run(drive, kind, seed, start=stated, landmark_map=landmark_map, same_building=False)
    return warned(record), record


def right(log: str, change: str, start: str, kind: str, *, seed: int) -> tuple[Values, Record]:
    """A log on its own map, as it is or worn; it must never be said that it does not fit."""
    drive = drive_of(log)
    worn = {"whole": lambda one, _: one, "removed": maps.thinned, "moved": maps.rearranged}[change]
    stated = "truth" if start == "truth" else None
    record = run(drive, kind, seed, start=stated, landmark_map=worn(drive.landmark_map, seed))
    return tracked(record) | warned(record), record


def warned(record: Record) -> Values:
    """Return how sure a run was after its beginning, and when it said that the map does not fit."""
    later, first = record.seconds > BEGIN_S, first_of(record.warned)
    return {
        "sure_later": float(record.sure[later].mean()),
        "p_mean": float(record.p_correct[later].mean()),
        "p_max": float(record.p_correct[later].max()),
        "warned_s": NEVER if first < 0 else float(record.seconds[first]),
        "warned_images": float(record.warned.mean()),
    }


# -- hours of tracking -------------------------------------------------------------------------------------------------


def recovery(kind_of_world: str, minutes: str, kind: str, *, seed: int) -> tuple[Values, Record]:
    """Some minutes of tracking in a simulated building, from a start near the truth."""
    drive = hours_of(kind_of_world, seed, float(minutes.removesuffix(" min")))
    record = run(drive, kind, seed)
    way = np.hypot(*np.diff(drive.truth[:, :2], axis=0).T)
    return {
        "hours": float(record.seconds[-1]) / 3600,
        "images": float(len(record.seconds)),
        "metres": float(way.sum()),
        "false_recoveries": float(false_recoveries(record)),
        "off": float((~record.right).mean()),
        "edges": float(record.shows.mean()),
        "mapped": float(np.mean([(one.landmark_id >= 0).sum() for one in drive.edges])),
    } | tracked(record), record


def false_recoveries(record: Record) -> int:
    """Return how often the estimate jumps by more than 0.5 m away from a truth that it had."""
    jump_m = np.hypot(*np.diff(record.error[:, :2], axis=0).T)
    had, left = record.error_m[:-1] <= CORRECT_M, record.error_m[1:] > CORRECT_M
    return int((had & left & (jump_m > CORRECT_M)).sum())


# -- a wrong belief ----------------------------------------------------------------------------------------------------


def kidnapped(log: str, kind: str, *, seed: int) -> tuple[Values, Record]:
    """The robot is carried away; its wheels do not notice."""
    if log == "office":
        drive = drives.drive_of_trial(log, scenarios.kidnapped(seed))
    else:
        drive = drives.carried(drive_of(log), seed)
    record = run(drive, kind, seed)
    return carried_off(record, drive), record


def carried_off(record: Record, drive: Drive) -> Values:
    """Return when the robot was noticed to be elsewhere, and when it was found there."""
    first = drive.carried or 0
    right, sure = record.right[first:], record.sure[first:]
    back = settled_at(record.within(BACK_M), first)
    was_right = bool(record.right[first - 1])
    return {
        "was_right": float(was_right),
        "back_images": NEVER if back < 0 else float(back),
        "back_s": NEVER if back < 0 else float(record.seconds[first + back] - record.seconds[first]),
        "noticed_images": _or_never(first_of(~sure | right)),
        "sure_images": float((sure & ~right)[: back if back >= 0 else None].sum()),
        "lost_images": NEVER if back < 0 else float((~right[back:]).sum()),
        "for_good": float(0 <= back <= 100 and right[back:].all()),
    }


def misplaced(log: str, kind: str, *, seed: int) -> tuple[Values, Record]:
    """The start is stated to 0.1 m and 3°, and is wrong by 2 m or more."""
    drive = drive_of(log)
    record = run(drive, kind, seed, start=drives.elsewhere(drive, seed))
    return found_out(record), record


def found_out(record: Record) -> Values:
    """Return after how many images a wrong start is found out: p_correct below one half, or the estimate right.

    Only images count that the estimate expects at least three landmarks in and that show at least five edges.
    """
    telling = (record.expects >= FEWEST_EXPECTED) & (record.shows >= FEWEST_SHOWN)
    first = first_of((record.p_correct < DOUBTFUL) | record.right)
    back = settled_at(record.within(BACK_M))
    return {
        "telling_images": NEVER if first < 0 else float(telling[: first + 1].sum()),
        "images": _or_never(first),
        "sure_images": float((record.sure & ~record.right).sum()),
        "back_s": NEVER if back < 0 else float(record.seconds[back]),
    }


def _or_never(index: int) -> float:
    return NEVER if index < 0 else float(index)


# -- real bearings, and time -------------------------------------------------------------------------------------------


def mrclam(robot: str, kind: str, *, seed: int) -> tuple[Values, Record]:
    """A robot of MRCLAM, bearings without identities."""
    record = run(drive_of(f"mrclam {robot}"), kind, seed)
    return tracked(record), record


def timed(log: str, start: str, kind: str, *, seed: int) -> tuple[Values, Record]:
    """The time that an image takes this thread, edges not counted; the first one of a global start is excepted."""
    record = run(drive_of(log), kind, seed, start="truth" if start == "truth" else None)
    median, late, longest = np.quantile(record.ms[1:], [0.5, 0.99, 1.0])
    return {
        "median_ms": float(median),
        "p99 / median": float(late / median),
        "max / median": float(longest / median),
        "first / median": float(record.ms[0] / median),
    }, record


# -- all ---------------------------------------------------------------------------------------------------------------


def _each(*parts: Sequence[str]) -> Callable[[Sequence[str]], list[About]]:
    return lambda kinds: list(product(*parts, kinds))


def _wrong(kinds: Sequence[str]) -> list[About]:
    pairs = [(log, other) for log in LOGS for other in LOGS if other != log]
    null = list(product(LOGS, ("mirrored", "shuffled"), ("own", "none"), kinds))
    others = [(*pair, start, kind) for pair in pairs for start in ("own", "theirs", "none") for kind in kinds]
    return others + null + list(product(OF_ONE_KIND, ("another",), ("own", "none"), kinds))


NEAR_OR_NOT, BOTH = ("truth", "global"), ("line", "slope")
SCENARIOS: dict[str, Scenario] = {
    "tracking": Scenario(_each(("corridor", "house", "bookstore", "shop"), NEAR_OR_NOT), tracking, kinds=BOTH),
    "wrong": Scenario(_wrong, wrong, kinds=BOTH),
    "right": Scenario(_each(LOGS, ("whole", "removed", "moved"), NEAR_OR_NOT), right),
    "recovery": Scenario(_each(HOURS, ("{minutes:g} min",)), recovery),
    "kidnapped": Scenario(_each(("office", "house", "bookstore")), kidnapped),
    "misplaced": Scenario(_each(LOGS), misplaced),
    "mrclam": Scenario(lambda _: [(str(robot), "line") for robot in (1, 2, 3)], mrclam),
    "time": Scenario(_each(("bookstore",), NEAR_OR_NOT), timed, claims=False),
}
