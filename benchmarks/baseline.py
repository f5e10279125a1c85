"""Measure the program and compare it with a baseline that is committed: is anything worse than it was?

    hashes      digests of trajectories, maps and other files: not one byte has changed
    logs        errors, NEES, sureness over whole logs
    scenarios   clutter, bare corridors, no start, robots carried away
    efficiency  errors over the limit of accuracy
    edges       recall, precision and bearing error of edge detectors
    speed       ratios of times within one run

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
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain
from pathlib import Path

from figures import detection, hashes, limit, logs, robust, speed, store
from figures.compare import LOSSES, Compared, Figure, Key, Value, compared
from figures.measures import Measure, tolerance
from figures.program import KEPT, ROOT, fingerprint
from figures.tasks import Task, Values, measured
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

FILE = Path(__file__).with_name("baseline.json")


@dataclass(frozen=True, slots=True)
class Group:
    """Figures that are measured together.

    tasks: from the folder of data and how many seeds. measures: what each figure means. check_seeds, seeds: of a check
    and of the baseline. alone: whether nothing may run beside it.
    """

    tasks: Callable[[Path, int], Sequence[Task]]
    measures: Mapping[str, Measure]
    check_seeds: int = 1
    seeds: int = 1
    alone: bool = False


GROUPS = {
    "hashes": Group(lambda data, _: hashes.tasks(data), hashes.MEASURES),
    "logs": Group(logs.tasks, logs.MEASURES, 5, 20),
    "scenarios": Group(lambda _, seeds: robust.tasks(seeds), robust.MEASURES, 5, 20),
    "efficiency": Group(lambda _, seeds: limit.tasks(seeds), limit.MEASURES, 10, 20),
    "edges": Group(lambda data, _: detection.tasks(data), detection.MEASURES),
    "speed": Group(lambda _, seeds: speed.tasks(seeds), speed.MEASURES, 3, 20, alone=True),
}


def samples_of(results: Sequence[tuple[Task, Values]]) -> dict[Key, list[Value]]:
    """Return the values of every figure in the order of seeds."""
    samples: dict[Key, list[Value]] = {}
    for task, values in sorted(results, key=lambda result: (result[0].case, result[0].seed)):
        for measure, value in values.items():
            samples.setdefault((task.group, task.case, measure), []).append(value)
    return samples


def figure_of(group: Group, measure: Measure, samples: Sequence[Value]) -> Figure:
    """Return a figure of the baseline."""
    first = samples[0]
    if isinstance(first, str):
        return Figure(first, "change")
    value = measure.of(samples[: group.check_seeds])
    allowed = tolerance(measure, samples, group.check_seeds)
    return Figure(value, measure.loss, allowed, measure.over, [float(f"{one:.6g}") for one in samples])


def summed_up(group: Group, measure: Measure, samples: Sequence[Value]) -> Value:
    """Return a figure of a check."""
    first = samples[0]
    return first if isinstance(first, str) else measure.of(samples[: group.check_seeds])


# -- measuring --------------------------------------------------------------------------------------------------------


def measure(tasks: Sequence[Task], jobs: int, partial: Path | None) -> dict[Key, list[Value]]:
    """Return the values of every figure, with a bar on standard error."""
    columns = (
        TextColumn("Measuring"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TextColumn("{task.description}"),
    )
    results = []
    together = [task for task in tasks if not GROUPS[task.group].alone]
    alone = [task for task in tasks if GROUPS[task.group].alone]
    with Progress(*columns, console=Console(stderr=True)) as bar:
        counted = bar.add_task("", total=len(tasks))
        for task, values in chain(measured(together, jobs, partial), measured(alone, 1, partial, afresh=True)):
            results.append((task, values))
            bar.update(counted, advance=1, description=task.name)
    return samples_of(results)


def write(groups: Mapping[str, Group], data: Path, jobs: int) -> None:
    """Measure these groups with all seeds and write them into the file; others stay as they are."""
    tasks = [task for group in groups.values() for task in group.tasks(data, group.seeds)]
    if missing := {task.missing for task in tasks if task.missing}:
        raise SystemExit(f"--write needs everything: {', '.join(sorted(missing))}")
    samples = measure(tasks, jobs, KEPT / f"{fingerprint()}.jsonl")
    figures, about = store.read(FILE)
    figures = {key: figure for key, figure in figures.items() if key[0] not in groups}
    for key, values in samples.items():
        group = groups[key[0]]
        figures[key] = figure_of(group, group.measures[key[2]], values)
    for name, group in groups.items():
        about[name] = {"seeds": group.seeds, "check_seeds": group.check_seeds, "machine": store.machine()}
    store.write(FILE, figures, {name: about[name] for name in GROUPS if name in about})
    print(f"{len(samples)} figures written to {FILE.relative_to(ROOT)}")


def check(groups: Mapping[str, Group], data: Path, jobs: int) -> list[Compared]:
    """Measure these groups and return the verdicts."""
    figures, about = store.read(FILE)
    tasks = [task for group in groups.values() for task in group.tasks(data, group.check_seeds)]
    samples = measure([task for task in tasks if not task.missing], jobs, None)
    now = {key: summed_up(groups[key[0]], groups[key[0]].measures[key[2]], values) for key, values in samples.items()}
    left_out = {(task.group, task.case): task.missing for task in tasks if task.missing}
    wanted = {key: figure for key, figure in figures.items() if key[0] in groups}
    skipped = {key: left_out[key[:2]] for key in wanted if key[:2] in left_out}
    same = all(about[name]["machine"] == store.machine() for name in groups if name in about)
    return compared(wanted, now, skipped, same_machine=same)


# -- showing ----------------------------------------------------------------------------------------------------------


def table_of(verdicts: Sequence[Compared]) -> Table:
    """Return the figures that are not as they were."""
    table = Table("figure", title="Figures that are not as they were")
    for name in ("baseline", "now", "tolerance"):
        table.add_column(name, justify="right")
    table.add_column("verdict")
    for one in verdicts:
        if one.verdict != "same":
            allowed = f"{one.tolerance:.3g}" if one.verdict not in ("skipped", "new") else ""
            verdict = f"{one.verdict}: {one.reason}" if one.reason else one.verdict
            table.add_row(" · ".join(one.key), _shown(one.before), _shown(one.now), allowed, verdict)
    return table


def _shown(value: Value | None) -> str:
    if value is None:
        return ""
    return value[:10] if isinstance(value, str) else f"{value:.5g}"


def summary_of(verdicts: Sequence[Compared]) -> str:
    """Return how many figures had which verdict, in each group."""
    lines = []
    for group in dict.fromkeys(one.key[0] for one in verdicts):
        counts: dict[str, int] = {}
        for one in verdicts:
            if one.key[0] == group:
                counts[one.verdict] = counts.get(one.verdict, 0) + 1
        lines.append(f"{group}: " + ", ".join(f"{count} {verdict}" for verdict, count in counts.items()))
    return "\n".join(lines)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    what = parser.add_mutually_exclusive_group(required=True)
    what.add_argument("--check", action="store_true", help="compare with the baseline")
    what.add_argument("--write", action="store_true", help="make the baseline")
    what.add_argument("--list", action="store_true", help="say what is measured")
    parser.add_argument("--only", metavar="GROUP[,GROUP]", help=f"some of {', '.join(GROUPS)}")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1, help="processes (default: one a core)")
    default_data = ROOT.parent / "shared" / "data"
    parser.add_argument("--data", type=Path, default=Path(os.environ.get("LOCALISER_DATA", default_data)))
    options = parser.parse_args()
    names = options.only.split(",") if options.only else list(GROUPS)
    if unknown := set(names) - set(GROUPS):
        parser.error(f"--only: no group {', '.join(sorted(unknown))}; there are {', '.join(GROUPS)}")
    groups = {name: group for name, group in GROUPS.items() if name in names}
    if options.list:
        for name, group in groups.items():
            for case in dict.fromkeys(task.case for task in group.tasks(options.data, 1)):
                print(f"{name}: {case}")
        return 0
    if options.write:
        write(groups, options.data, options.jobs)
        return 0
    verdicts = check(groups, options.data, options.jobs)
    if any(one.verdict != "same" for one in verdicts):
        Console(width=None if sys.stdout.isatty() else 150).print(table_of(verdicts))
    print(summary_of(verdicts))
    lost = sum(one.verdict in LOSSES for one in verdicts)
    print(f"{lost} figures are worse" if lost else "nothing is worse")
    return int(lost > 0)


if __name__ == "__main__":
    sys.exit(main())
