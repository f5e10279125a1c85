"""One page that decides whether a change is good: every situation, five seeds, before and after.

    python benchmarks/scoreboard.py                             all rows; at most 20 minutes on two quiet cores
    python benchmarks/scoreboard.py --quick                     real and tracking rows, 3 seeds; at most 5 minutes
    python benchmarks/scoreboard.py --only office_real "30 %"   rows whose title has one of these words
    python benchmarks/scoreboard.py --against benchmarks/scoreboard.json    what is worse or better than a saved page
    python benchmarks/scoreboard.py --against HEAD~3            than that commit, which is run here, too
    python benchmarks/scoreboard.py --off wheels-check --against HEAD       what a mechanism is worth
    python benchmarks/scoreboard.py --save page.json --page page.md    keep all figures, and the page to read

Edges are found once and kept by content of image, camera and the code that finds them (`results/scoreboard`, or
LOCALISER_SCOREBOARD); then only the filter runs. Finding edges and rendering are not part of the time above. Rows whose
data (LOCALISER_DATA) is missing are left out, and named.

Each figure is the median of the seeds, with the worst in brackets where that differs, or how many seeds never came to a
value. Never is worse than any value.

{figures}

*Worse* or *better* is said of a figure by its changes, paired by row and seed: their mean is not 0 by its 95 % interval
(t, not corrected for how many figures there are), and their median is at least 3 % of the figure before (a rate: one
point). Five of five seeds that change by 10 % say it, too. Changes below 0.5 mm, 0.01° or one image count as none. NEES
counts by its logarithm over 3: twice and half are as bad. Not judged: {unjudged}. Where other random numbers are drawn,
chance alone calls about one figure in forty worse; in doubt, other seeds confirm: `--seeds 5-14`.

Ends with 1 when a figure is worse, or when a row of the saved page is no longer among the rows.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tarfile
import tempfile
from collections import Counter
from collections.abc import Callable, Sequence
from io import BytesIO
from pathlib import Path
from time import perf_counter

from program import ONE_THREAD, ROOT

os.environ |= dict.fromkeys(ONE_THREAD, "1")
sys.path.insert(0, os.environ.get("LOCALISER_SOURCE", str(ROOT)))  # whatever is installed, this source runs

from board import page
from board.drives import drive_of, map_of
from board.off import MECHANISMS, switch_off
from board.rows import Row, every_row, maps_needed
from board.run import FIGURES, Values
from joblib import Parallel, delayed, parallel_config
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

QUICK_SEEDS = "0-2"


def prepare(make: Callable[[str], object], name: str) -> None:
    """Find the edges of a log, or make a map, so that it is kept."""
    make(name)


def outcome(title: str, seed: int, off: str) -> tuple[str, int, Values]:
    """Return the figures of one run, without these mechanisms."""
    switch_off(off)
    (row,) = (one for one in every_row() if one.title == title)
    return title, seed, page.rounded(row.judged(seed))


def measured(rows: Sequence[Row], seeds: Sequence[int], jobs: int, off: str = "") -> page.Page:
    """Return the figures of all rows and seeds. Seeds of a row follow each other: a process keeps its log.

    off: mechanisms that are switched off, separated by commas.
    """
    tasks = [(row.title, seed) for row in rows for seed in (seeds[:1] if row.is_exact else seeds)]
    left = Counter(title for title, _ in tasks)
    needed = {log for row in rows for log in row.logs}
    found: page.Page = {}
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    is_seen = sys.stderr.isatty()
    with (
        parallel_config(backend="loky", n_jobs=jobs, inner_max_num_threads=1),
        Progress(*columns, console=Console(stderr=True), disable=not is_seen) as bar,
    ):
        logs = [delayed(prepare)(drive_of, log) for log in sorted(needed - {"york_urban"})]
        maps = [delayed(prepare)(map_of, name) for name in maps_needed(needed)]
        counted = bar.add_task("Edges and maps", total=len(logs) + len(maps))
        for first in (logs, maps):
            for _ in Parallel(return_as="generator_unordered")(first):
                bar.advance(counted)
        counted = bar.add_task("Replaying", total=len(tasks))
        for title, seed, values in Parallel(return_as="generator_unordered")(
            delayed(outcome)(*task, off) for task in tasks
        ):
            found.setdefault(title, {})[seed] = values
            bar.advance(counted)
            left[title] -= 1
            if not left[title] and not is_seen:
                print(f"{sum(not one for one in left.values())}/{len(rows)} {title}", file=sys.stderr, flush=True)
    return {row.title: dict(sorted(found[row.title].items())) for row in rows}


def page_of(reference: str, titles: Sequence[str], seeds: Sequence[int], jobs: int) -> page.Page:
    """Return the page of a saved file, or of a commit, whose `localiser/` these benchmarks run here.

    Raises SystemExit where the commit cannot be found or run.
    """
    if Path(reference).is_file():
        return page.load(Path(reference))
    packed = subprocess.run(["git", "archive", reference, "localiser"], check=False, cwd=ROOT, capture_output=True)
    if packed.returncode:
        raise SystemExit(f"--against: expected a saved page or a commit, found {reference}: {packed.stderr.decode()}")
    with tempfile.TemporaryDirectory() as name:
        with tarfile.open(fileobj=BytesIO(packed.stdout)) as archive:
            archive.extractall(name, filter="data")
        saved = Path(name) / "page.json"
        command = [sys.executable, __file__, "--seeds", f"{seeds[0]}-{seeds[-1]}", "--jobs", str(jobs)]
        command += ["--save", str(saved), "--only", *titles]
        source = os.environ | {"LOCALISER_SOURCE": name}
        if subprocess.run(command, check=False, cwd=ROOT, env=source, stdout=subprocess.DEVNULL).returncode:
            raise SystemExit(
                f"--against: these benchmarks do not run with the code of {reference}; give its saved page"
            )
        return page.load(saved)


def main() -> int:
    """Measure, print and compare."""
    options = arguments()
    every = every_row()
    titles = {row.title for row in every}
    rows = [row for row in every if row.quick or not options.quick]
    if options.only:  # a whole title is that row alone
        rows = [
            row for row in rows if any(w == row.title or (w not in titles and w in row.title) for w in options.only)
        ]
    if missing := [row.title for row in rows if not row.is_there]:
        print(f"without their data (LOCALISER_DATA): {'; '.join(missing)}", file=sys.stderr)
    rows = [row for row in rows if row.is_there]
    if not rows:
        print("no row is left; `--only` takes words of their titles: see --list", file=sys.stderr)
        return 2
    if options.list:
        print(*(row.title for row in rows), sep="\n")
        return 0
    seeds = page.seeds_of(options.seeds or (QUICK_SEEDS if options.quick else "0-4"))
    begin = perf_counter()
    now = measured(rows, seeds, options.jobs, options.off)
    minutes = (perf_counter() - begin) / 60
    print(page.tables(now))
    print(f"{len(rows)} rows, seeds {seeds[0]} to {seeds[-1]}, {minutes:.1f} minutes with {options.jobs} processes\n")
    if options.save:
        page.save(options.save, now)
    if options.page:
        options.page.write_text(page.markdown(now), encoding="utf-8")
    if options.against is None:
        return 0
    before = page_of(options.against, list(now), seeds, options.jobs)
    found = page.compared(before, now, exact=[row.title for row in rows if row.is_exact])
    print(page.comparison(found, options.against))
    if gone := [title for title in before if title not in titles]:
        print(f"\nno longer among the rows: {'; '.join(gone)}")
    return int(bool(gone) or any(one.verdict == "worse" for one in found))


def mechanisms(names: str) -> str:
    """Return names of mechanisms, all of which are there. Raises argparse.ArgumentTypeError."""
    if unknown := [name for name in filter(None, names.split(",")) if name not in MECHANISMS]:
        raise argparse.ArgumentTypeError(f"expected some of {', '.join(MECHANISMS)}; found {', '.join(unknown)}")
    return names


def arguments() -> argparse.Namespace:
    """Return what was asked for."""
    figures = "\n".join(f"    {one.title:14} {one.meaning}" for one in FIGURES.values())
    unjudged = ", ".join(one.title for one in FIGURES.values() if not one.is_judged)
    parser = argparse.ArgumentParser(
        description=(__doc__ or "").format(figures=figures, unjudged=unjudged),
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--only", nargs="+", default=[], metavar="WORD", help="rows whose title has one of them")
    parser.add_argument("--quick", action="store_true", help="real and tracking rows, seeds 0-2")
    parser.add_argument("--seeds", metavar="FIRST-LAST", help="default: 0-4, with --quick 0-2")
    parser.add_argument("--against", metavar="REF", help="a saved page, or a commit, to compare with")
    parser.add_argument(
        "--off",
        default="",
        metavar="NAME,...",
        type=mechanisms,
        help=f"mechanisms that are switched off here, not in what it is compared with: {', '.join(MECHANISMS)}",
    )
    parser.add_argument("--save", type=Path, metavar="FILE", help="where to keep all figures, as JSON")
    parser.add_argument("--page", type=Path, metavar="FILE", help="where to write the page, as Markdown")
    parser.add_argument("--jobs", type=int, default=2, help="processes (default: %(default)s)")
    parser.add_argument("--list", action="store_true", help="name the rows, and run none")
    return parser.parse_args()


if __name__ == "__main__":
    sys.exit(main())
