"""One page that decides whether a change is good: every situation, five seeds, before and after.

    python benchmarks/scoreboard.py                             all rows; at most 20 minutes on two quiet cores
    python benchmarks/scoreboard.py --quick                     real and tracking rows, 3 seeds; at most 5 minutes
    python benchmarks/scoreboard.py --only office_real "30 %"   rows whose group or name has one of these words
    python benchmarks/scoreboard.py --against benchmarks/scoreboard.json    what is worse or better than a saved page
    python benchmarks/scoreboard.py --against HEAD~3            than that commit, which is run here, too
    python benchmarks/scoreboard.py --save page.json            keep all figures

Edges are found once and kept by content of image, camera and the code that finds them; then only the filter runs.
Finding edges and rendering are not part of the time above. Rows whose data (LOCALISER_DATA) is missing are left out.

Each figure is the median of the seeds, with the worst in brackets:

{figures}

*Worse* or *better* is said of a figure, paired by row and seed, when the 95 % interval (t, uncorrected) of the mean
difference lies beyond 0 and the median changes by at least 3 % (rates: one point), or when all of five seeds change by
10 %. In doubt, seeds 5-14 confirm: `--seeds 5-14`.
"""

from __future__ import annotations

import argparse
import os
import sys
from pathlib import Path
from time import perf_counter

from figures.program import ONE_THREAD, ROOT

os.environ |= dict.fromkeys(ONE_THREAD, "1")
sys.path.insert(0, os.environ.get("LOCALISER_SOURCE", str(ROOT)))  # whatever is installed, this source runs

from board import page
from board.drives import drive_of, map_of
from board.rows import Row, every_row, maps_needed
from board.run import FIGURES, Values
from joblib import Parallel, delayed, parallel_config
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

QUICK_SEEDS = "0-2"


def prepare(name: str, *, is_map: bool) -> None:
    """Find the edges of a log, or make a map, so that it is kept."""
    if is_map:
        map_of(name)
    else:
        drive_of(name)


def outcome(name: str, seed: int) -> tuple[str, int, Values]:
    """Return the figures of one run."""
    (row,) = (one for one in every_row() if one.name == name)
    return name, seed, row.judged(seed)


def measured(rows: list[Row], seeds: list[int], jobs: int) -> page.Page:
    """Return the figures of all rows and seeds. Seeds of a row follow each other: a process keeps its log."""
    tasks = [(row.name, seed) for row in rows for seed in (seeds if row.seeded else seeds[:1])]
    logs = sorted({log for row in rows for log in row.logs if not log.startswith("york")})
    found: page.Page = {}
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    with (
        parallel_config(backend="loky", n_jobs=jobs, inner_max_num_threads=1),
        Progress(*columns, console=Console(stderr=True)) as bar,
    ):
        first = [delayed(prepare)(log, is_map=False) for log in logs]
        counted = bar.add_task("Edges and maps", total=len(first))
        for _ in Parallel(return_as="generator_unordered")(first):
            bar.advance(counted)
        if any(log.startswith(("vicon", "office_real")) for log in logs):
            Parallel()(delayed(prepare)(name, is_map=True) for name in maps_needed())
        counted = bar.add_task("Replaying", total=len(tasks))
        for name, seed, values in Parallel(return_as="generator_unordered")(delayed(outcome)(*task) for task in tasks):
            found.setdefault(name, {})[seed] = values
            bar.advance(counted)
    return {row.name: dict(sorted(found[row.name].items())) for row in rows}


def main() -> int:
    """Measure, print and compare. Returns 1 when a row is worse."""
    options = arguments()
    rows = [row for row in every_row() if row.is_there]
    if options.quick:
        rows = [row for row in rows if row.quick]
    if options.only:
        rows = [row for row in rows if any(word in f"{row.group}: {row.name}" for word in options.only)]
    if not rows:
        print("no row is left: see --list, and LOCALISER_DATA for data", file=sys.stderr)
        return 2
    if options.list:
        print(*(f"{row.group}: {row.name}" for row in rows), sep="\n")
        return 0
    seeds = page.seeds_of(options.seeds or (QUICK_SEEDS if options.quick else "0-4"))
    begin = perf_counter()
    now = measured(rows, seeds, options.jobs)
    minutes = (perf_counter() - begin) / 60
    groups = {row.name: row.group for row in rows}
    print(page.table(now, groups))
    print(
        f"\n{len(rows)} rows, seeds {', '.join(map(str, seeds))}, {minutes:.1f} minutes with {options.jobs} processes"
    )
    if options.save:
        page.save(options.save, now, groups)
    if options.against is None:
        return 0
    before = page.of(options.against, sys.argv[0], rows, seeds, options.jobs)
    verdicts = page.compared(before, now)
    print(page.comparison(verdicts, options.against))
    return int(any(one.verdict == "worse" for one in verdicts))


def arguments() -> argparse.Namespace:
    """Return what was asked for."""
    figures = "\n".join(f"    {short:12} {meaning}" for short, meaning in FIGURES.values())
    parser = argparse.ArgumentParser(
        description=(__doc__ or "").format(figures=figures), formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--only", nargs="+", default=[], metavar="WORD", help="rows whose group or name has one of them"
    )
    parser.add_argument("--quick", action="store_true", help="real and tracking rows, seeds 0-2")
    parser.add_argument("--seeds", metavar="FIRST-LAST", help="default: 0-4, with --quick 0-2")
    parser.add_argument("--against", metavar="REF", help="a saved page, or a commit, to compare with")
    parser.add_argument("--save", type=Path, metavar="FILE", help="where to keep the page, as JSON")
    parser.add_argument("--jobs", type=int, default=2, help="processes (default: %(default)s)")
    parser.add_argument("--list", action="store_true", help="name the rows, and run none")
    return parser.parse_args()


if __name__ == "__main__":
    sys.exit(main())
