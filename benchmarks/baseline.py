"""Measure the program and compare it with a baseline that is committed: is anything worse than it was?

    hashes        digests of trajectories, maps and other files: not one byte has changed
    efficiency    errors over the limit of accuracy
    edges         recall, precision and bearing error of edge detectors
    speed         ratios of times within one run
    instructions  that an image takes, counted by valgrind: with --only instructions alone, five minutes

python benchmarks/baseline.py --check                    compare; ends with 1 when something is worse
python benchmarks/baseline.py --check --only hashes      two minutes, after every step that must change nothing
python benchmarks/baseline.py --write                    measure anew and write benchmarks/baseline.json
python benchmarks/baseline.py --list                     what is measured

How far a figure may move by chance is in the file, by the rule of `figures/measures.py`. Data that do not ship are
found through LOCALISER_DATA; figures that need them are skipped where they are absent, and the summary says so. Bytes
can only be equal on the same processor with the same libraries: elsewhere a digest that differs is told, but is no
loss. `--write` goes on where an earlier `--write` with the same source was interrupted.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Mapping, Sequence
from itertools import chain
from pathlib import Path

from figures import store
from figures.compare import LOSSES, Compared, Key, Value, compared, elsewhere
from figures.groups import GROUPS, SEEDS, Group, samples_of
from figures.program import KEPT, ROOT, fingerprint
from figures.show import summary_of, table_of
from figures.tasks import Task, measured
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

FILE = Path(__file__).with_name("baseline.json")
Samples = Mapping[Key, Sequence[Value]]
Failed = dict[tuple[str, str], str]
"""What went wrong, by group and case."""


def measure(
    tasks: Sequence[Task], jobs: int, partial: Path | None = None
) -> tuple[Samples, dict[tuple[str, str], str]]:
    """Return the values of every figure, and what went wrong by group and case; with a bar on standard error."""
    together = [task for task in tasks if not GROUPS[task.group].alone]
    alone = [task for task in tasks if GROUPS[task.group].alone]
    columns = (TextColumn("Measuring"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    results = []
    failed: Failed = {}
    with Progress(*columns, TextColumn("{task.description}"), console=Console(stderr=True)) as bar:
        counted = bar.add_task("", total=len(tasks))
        for task, values in chain(measured(together, jobs, partial), measured(alone, 1, partial, afresh=True)):
            if isinstance(values, Exception):
                failed[task.group, task.case] = f"{type(values).__name__}: {values}"
            else:
                results.append((task, values))
            bar.update(counted, advance=1, description=task.name)
    return samples_of(results), failed


def write(groups: Mapping[str, Group], data: Path, jobs: int, most_seeds: int) -> None:
    """Measure these groups with all seeds, or fewer, and write them into the file; other groups stay as they are."""
    seeds = {name: min(group.seeds, most_seeds) for name, group in groups.items()}
    tasks = [task for name, group in groups.items() for task in group.tasks(data, seeds[name])]
    tasks.sort(key=lambda task: task.seed)
    if missing := {task.missing for task in tasks if task.missing}:
        raise SystemExit(f"--write needs everything: {', '.join(sorted(missing))}")
    samples, failed = measure(tasks, jobs, KEPT / f"{fingerprint('localiser', 'benchmarks')}.jsonl")
    if failed:
        raise SystemExit("\n".join(f"{' · '.join(case)}: {reason}" for case, reason in failed.items()))
    figures, about = store.read(FILE)
    figures = {key: figure for key, figure in figures.items() if key[0] not in groups}
    figures |= {key: groups[key[0]].figure(key[2], values) for key, values in samples.items()}
    for name, group in groups.items():
        about[name] = {"seeds": seeds[name], "check_seeds": group.checked(seeds[name]), "machine": store.machine()}
    store.write(FILE, figures, {name: about[name] for name in GROUPS if name in about})
    print(f"{len(samples)} figures written to {FILE.relative_to(ROOT)}")


def check(groups: Mapping[str, Group], data: Path, jobs: int) -> list[Compared]:
    """Measure these groups and return the verdicts."""
    figures, about = store.read(FILE)
    figures = {key: figure for key, figure in figures.items() if key[0] in groups}
    seeds = {name: group.checked(about.get(name, {}).get("seeds", SEEDS)) for name, group in groups.items()}
    tasks = [task for name, group in groups.items() for task in group.tasks(data, seeds[name])]
    samples, failed = measure([task for task in tasks if not task.missing], jobs)
    missing = {(task.group, task.case): task.missing for task in tasks if task.missing}
    verdicts = compared(
        figures,
        {key: groups[key[0]].value(key[2], values) for key, values in samples.items()},
        {key: missing[key[:2]] for key in figures if key[:2] in missing},
        {key: failed[key[:2]] for key in figures if key[:2] in failed},
    )
    here = store.machine()
    bound = {name for name in about if not GROUPS[name].portable and about[name]["machine"] != here}
    return [elsewhere(one) if one.key[0] in bound else one for one in verdicts]


def main() -> int:
    options = arguments()
    groups = {name: group for name, group in GROUPS.items() if name in options.only}
    if options.list:
        for name, group in groups.items():
            for case in dict.fromkeys(task.case for task in group.tasks(options.data, 1)):
                print(f"{name}: {case}: {', '.join(group.measures)}")
        return 0
    if options.write:
        write(groups, options.data, options.jobs, options.seeds)
        return 0
    verdicts = check(groups, options.data, options.jobs)
    if any(one.verdict != "same" for one in verdicts):
        Console(width=None if sys.stdout.isatty() else 150).print(table_of(verdicts))
    print(summary_of(verdicts))
    return int(any(one.verdict in LOSSES for one in verdicts))


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    usual = ",".join(name for name, group in GROUPS.items() if not group.by_hand)
    what = parser.add_mutually_exclusive_group(required=True)
    what.add_argument("--check", action="store_true", help="compare with the baseline")
    what.add_argument("--write", action="store_true", help="make the baseline")
    what.add_argument("--list", action="store_true", help="say what is measured")
    parser.add_argument("--only", metavar="GROUP[,GROUP]", default=usual, help="by default %(default)s")
    parser.add_argument("--seeds", type=int, default=SEEDS, help="fewer than %(default)s, for a first --write")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1, help="processes (default: one a core)")
    default_data = ROOT.parent / "shared" / "data"
    parser.add_argument("--data", type=Path, default=Path(os.environ.get("LOCALISER_DATA", default_data)))
    options = parser.parse_args()
    options.only = options.only.split(",")
    if unknown := set(options.only) - set(GROUPS):
        parser.error(f"--only: expected some of {', '.join(GROUPS)}, found {', '.join(sorted(unknown))}")
    return options


if __name__ == "__main__":
    sys.exit(main())
