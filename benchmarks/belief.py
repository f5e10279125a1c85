"""Is the filter's belief right? It must not leave the truth, must not be sure of a wrong place, and must say so.

    tracking   logs, and a simulated shop (another one with every seed), from a start near the truth and from anywhere
    wrong      every log on every other one's map, on its own mirrored, and on its own with blocks of 1.5 m shuffled;
               simulated buildings on the map of another of their kind, such as another floor of one building;
               start: its own true pose, the other log's first pose, none
    right      every log on its own map, whole, without 30 % of its landmarks, or with 30 % of them moved by 0.3 m
    recovery   simulated hours of tracking in worlds of six kinds: how often the estimate jumps away from the truth
    kidnapped  carried away without the wheels' knowing
    misplaced  a start that is stated to 0.1 m and is wrong by 2 m or more
    mrclam     real bearings without identities
    time       of an image, edges not counted: median and 99th percentile

A figure that misses what is asked has an exclamation mark. After the tables follows how well p_correct is calibrated
over all scenarios (`belief_score.py`), with its reliability diagram. Data that is not there is left out.

python benchmarks/belief.py --seeds 5 --json belief.json --diagram docs/images/reliability.png
python benchmarks/belief.py --scenario tracking wrong --only bookstore --observation slope --seeds 1 --jobs 1
python benchmarks/belief.py --scenario recovery --seeds 10
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import belief_score
import belief_table
from belief_scenarios import MINUTES, SCENARIOS, Case, Outcome, outcome
from joblib import Parallel, delayed
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.table import Table
from robustness import workers


def cases_of(arguments: argparse.Namespace) -> list[Case]:
    """Return the cases that are asked for, in the order of scenarios."""
    asked = (arguments.observation, arguments.minutes)
    every = [case for name in arguments.scenario for case in SCENARIOS[name].asked(name, *asked)]
    return [case for case in every if all(word in case.about for word in arguments.only)]


def measured(cases: Sequence[Case], seeds: Sequence[int], jobs: int, console: Console) -> list[Outcome]:
    """Return what all seeds of all cases come to, in their order. Seeds of a log follow each other: it is read once."""
    tasks = [(case, seed) for case in cases for seed in seeds]
    columns = (TextColumn("Running"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(), TimeRemainingColumn())
    outcomes = []
    with workers(jobs, None), Progress(*columns, console=console) as bar:
        counted = bar.add_task("", total=len(tasks))
        for one in Parallel(return_as="generator_unordered")(delayed(outcome)(*task) for task in tasks):
            outcomes.append(one)
            bar.advance(counted)
            if not console.is_terminal:  # where no bar is drawn, and where a long campaign may be cut short
                print(json.dumps(plain_run(one)), file=sys.stderr, flush=True)
    order = {task: number for number, task in enumerate(tasks)}
    return sorted(outcomes, key=lambda one: order[one.case, one.seed])


def calibrations(outcomes: Sequence[Outcome]) -> dict[str, belief_score.Calibration]:
    """Return how well p_correct is calibrated, by scenario, and over `all` of them with equal weight."""
    claims: dict[str, list[belief_score.Claims]] = {}
    for one in outcomes:
        if one.claims is not None:
            claims.setdefault(one.case.scenario, []).append(one.claims)
    each = {name: belief_score.calibration({name: runs}) for name, runs in claims.items()}
    return {**each, "all": belief_score.calibration(claims)} if claims else {}


def calibration_table(found: dict[str, belief_score.Calibration], before: dict[str, Any]) -> Table:
    """Return the log score and the expected calibration error of each scenario and of all, and both of before."""
    table = Table("p_correct", title="calibration; 95 % intervals in brackets", title_justify="left")
    for name in ("images", "log score", "before", "expected calibration error", "before"):
        table.add_column(name, justify="right")
    for scenario, one in found.items():
        then = before.get(scenario, {"log_score": None, "ece": None})
        cells = [_interval(each) for each in (one.log_score, then["log_score"], one.ece, then["ece"])]
        table.add_row(scenario, str(one.images), *cells)
    return table


def _interval(interval: Sequence[float] | None) -> str:
    return "" if interval is None else "{:.4f} [{:.4f}, {:.4f}]".format(*interval)


def reliability_table(one: belief_score.Calibration) -> Table:
    """Return what was claimed against what was right, by range of p_correct."""
    table = Table("p_correct", title="reliability, every scenario with the same weight", title_justify="left")
    for name in ("images", "claimed", "right"):
        table.add_column(name, justify="right")
    for number, images, claimed, right, low, high in one.rows:
        limits = f"{number / 10:.1f} … {number / 10 + 0.1:.1f}"
        table.add_row(limits, f"{images:.0f}", f"{claimed:.3f}", f"{right:.3f} [{low:.3f}, {high:.3f}]")
    return table


def plain_run(one: Outcome) -> dict[str, object]:
    """Return one run as JSON can have it."""
    about = {"scenario": one.case.scenario, "case": one.case.name, "seed": one.seed, "wall_s": round(one.wall_s, 1)}
    return about | {name: belief_table.finite(value) for name, value in one.values.items()}


def plain(outcomes: Sequence[Outcome], found: dict[str, belief_score.Calibration]) -> dict[str, object]:
    """Return everything as JSON can have it."""
    figures = [
        row
        for name in dict.fromkeys(one.case.scenario for one in outcomes)
        for row in belief_table.figures_of(name, [one for one in outcomes if one.case.scenario == name])
    ]
    calibrated = {
        name: {"images": one.images, "ece": one.ece, "log_score": one.log_score, "rows": one.rows.tolist()}
        for name, one in found.items()
    }
    hours = [one for one in outcomes if one.case.scenario == "recovery"]
    rates = belief_table.rates_of(hours) if hours else []
    return {"figures": figures, "rates": rates, "calibration": calibrated, "runs": [plain_run(one) for one in outcomes]}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenario", nargs="+", default=list(SCENARIOS), choices=list(SCENARIOS))
    parser.add_argument(
        "--observation", nargs="+", choices=["line", "slope"], help="default: tracking and wrong both, else line"
    )
    parser.add_argument("--only", nargs="+", default=[], metavar="WORD", help="cases whose names have all these words")
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--minutes", type=float, default=MINUTES, help="of each simulated drive of `recovery`")
    parser.add_argument("--jobs", type=int, default=-1, help="processes; -1: one for each core")
    parser.add_argument("--json", type=Path, help="where to write all figures")
    parser.add_argument("--against", type=Path, help="figures of another state, written with --json, to compare with")
    parser.add_argument("--diagram", type=Path, help="where to draw the reliability diagram")
    arguments = parser.parse_args()
    cases = cases_of(arguments)
    if not cases:
        parser.error("no case is left: see the names in --help, and LOCALISER_DATA for data")
    console = Console(stderr=True)
    seeds = range(arguments.first_seed, arguments.first_seed + arguments.seeds)
    outcomes = measured(cases, seeds, arguments.jobs, console)
    before = json.loads(arguments.against.read_text(encoding="utf-8"))["calibration"] if arguments.against else {}
    report, found = Console(width=None if console.is_terminal else 200), calibrations(outcomes)
    for name in arguments.scenario:
        own = [one for one in outcomes if one.case.scenario == name]
        if own:
            report.print(belief_table.table_of(name, own))
        if own and name == "recovery":
            report.print(belief_table.rate_table(belief_table.rates_of(own)))
    if found:
        report.print(calibration_table(found, before))
        report.print(reliability_table(found["all"]))
        if arguments.diagram:
            everything = found.pop("all")
            belief_score.draw(everything, found, arguments.diagram)
            found["all"] = everything
    if arguments.json:
        arguments.json.write_text(json.dumps(plain(outcomes, found), indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
