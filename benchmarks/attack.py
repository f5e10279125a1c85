"""Attack every reader and every command with changed files, messages and options; count what is not told as an error.

    python benchmarks/attack.py --cases 1000                 # all targets
    python benchmarks/attack.py --targets map,bag-mcap --cases 10000
    python benchmarks/attack.py --cases 10000 --readers --resume
    python benchmarks/attack.py --one map 123                # one case again, in this process, with its traceback
    python benchmarks/attack.py --keep map 123 a_name        # its input becomes a regression test

Good files are made first (`attack_samples`), then changed by their structure (`attack_formats`), with numbers and texts
at the edges of what is possible (`attack_values`). A case ends with a value, with an error that is told, or with a
fault: another exception, more than its processor time or memory, a process that died, a draft left behind. Workers
stay, are watched from outside and are started anew after a fault (`attack_pool`). Inputs of faults are kept in
`results/attack/faults`. A case is made from the name of its target and its number alone. How each ended is written at
once to `results/attack/ends.jsonl`; `--resume` leaves out the cases that are there, and counts them. SIGTERM and Ctrl-C
stop after the cases that run, with the table of what was done.
"""

from __future__ import annotations

import argparse
import json
import math
import random
import shutil
import signal
import statistics
import tempfile
import time
from collections import Counter, defaultdict
from pathlib import Path
from threading import Event
from typing import Any

import attack_samples
import attack_targets as targets
from attack_pool import Case, run_all

FAULT_FREE = ("value", "refused")


def table(results: dict[str, list[dict[str, Any]]]) -> str:
    """Return the counts, times and memory of every target as a table of Markdown."""
    lines = ["| target | cases | read | refused | faults | median ms | worst s | worst MB |", "|---|" + "---:|" * 7]
    for name, ends in results.items():
        counts = Counter(end["end"] for end in ends)
        seconds = [end["seconds"] for end in ends]
        faults = len(ends) - counts["value"] - counts["refused"]
        cells = [name, len(ends), counts["value"], counts["refused"], faults, f"{1e3 * statistics.median(seconds):.1f}"]
        cells += [f"{max(seconds):.1f}", f"{max(end.get('peak_mb', 0.0) for end in ends):.0f}"]
        lines.append("| " + " | ".join(map(str, cells)) + " |")
    return "\n".join(lines)


def faults(results: dict[str, list[dict[str, Any]]]) -> list[str]:
    """Return what went wrong, once for each place, with how often and the first case."""
    found: dict[str, list[str]] = defaultdict(list)
    for name, ends in results.items():
        for end in ends:
            if end["end"] not in FAULT_FREE:
                found[f"{end['end']} at {end.get('at', '')}"].append(f"{name} {end['case']}")
    return [f"{len(cases)} × {what}: {', '.join(cases[:4])}" for what, cases in found.items()]


def attack(
    names: list[str], numbers: range, folder: Path, workers: int, minutes: float, resume: bool
) -> dict[str, list[dict[str, Any]]]:
    """Run the cases of some targets, evenly mixed, and return how they ended, by target."""
    samples = folder / "samples"
    if not (resume and samples.exists()):
        made_samples(folder)
    written = folder / "ends.jsonl"
    results = earlier(written, names, numbers) if resume else {name: [] for name in names}
    begin, stop = time.monotonic(), Event()
    for wanted in (signal.SIGTERM, signal.SIGINT):
        signal.signal(wanted, lambda *_: stop.set())
    ends = written.open("a" if resume else "w", buffering=1)

    def done(case: Case, end: dict[str, Any]) -> None:
        kept = {key: part for key, part in end.items() if key != "text"} | {"case": case[1]}
        results[case[0]].append(kept)
        ends.write(json.dumps({"target": case[0]} | kept) + "\n")
        if end["end"] not in FAULT_FREE:
            print(
                f"{time.monotonic() - begin:7.0f} s  {case[0]} {case[1]}: {end['end']} at {end.get('at')}", flush=True
            )

    before = {name: {end["case"] for end in ended} for name, ended in results.items()}
    every = [(name, number) for number in numbers for name in names if number not in before[name]]
    with ends:
        run_all(every, samples, folder, workers, lambda name: targets.TARGETS[name].limit_s, done, minutes, stop)
    return {name: ended for name, ended in results.items() if ended}


def earlier(written: Path, names: list[str], numbers: range) -> dict[str, list[dict[str, Any]]]:
    """Return how cases ended that were run before, by target; a line that was cut off is left out of the file."""
    results: dict[str, list[dict[str, Any]]] = {name: [] for name in names}
    if written.exists():
        whole = written.read_text().rpartition("\n")[0]
        written.write_text(whole + "\n" if whole else "")
        for end in map(json.loads, whole.splitlines()):
            name = end.pop("target")
            if name in results and end["case"] in numbers:
                results[name].append(end)
    return results


def made_samples(folder: Path) -> Path:
    """Return the folder of the good files, made anew."""
    samples, draft = folder / "samples", folder / "samples.part"
    for old in (samples, draft):
        shutil.rmtree(old, ignore_errors=True)
    attack_samples.make(draft)
    attack_samples.write_others(draft)
    return draft.rename(samples)


def one(name: str, number: int, keep: str | None) -> None:
    """Run one case in this process; or keep its input as a regression test, under a name."""
    with tempfile.TemporaryDirectory() as temporary:
        samples = made_samples(Path(temporary))
        targets.use_samples(samples)
        path = targets.prepared(
            targets.TARGETS[name], samples, Path(temporary) / "in", random.Random(f"{name} {number}")
        )
        if keep is None:
            (Path(temporary) / "out").mkdir()
            targets.TARGETS[name].run(path, Path(temporary) / "out")
            print("a value")
            return
        kept = attack_samples.ROOT / "tests" / "attacks" / name / keep
        kept.mkdir(parents=True)
        (shutil.copytree if path.is_dir() else shutil.copy)(path, kept / path.name)
        print(f"kept in {kept}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--targets", help="some of them, with commas between; * at the end stands for any rest")
    parser.add_argument("--readers", action="store_true", help="those that read a file or messages, not the commands")
    parser.add_argument("--cases", type=int, default=1000, help="cases of every target")
    parser.add_argument("--first", type=int, default=0, help="number of the first case")
    parser.add_argument("--minutes", type=float, default=math.inf, help="no case begins later")
    parser.add_argument("--resume", action="store_true", help="go on where an earlier run was stopped")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--out", type=Path, default=Path("results/attack"))
    parser.add_argument("--one", nargs=2, metavar=("TARGET", "CASE"))
    parser.add_argument("--keep", nargs=3, metavar=("TARGET", "CASE", "NAME"))
    arguments = parser.parse_args()
    if chosen := arguments.one or arguments.keep:
        one(chosen[0], int(chosen[1]), arguments.keep[2] if arguments.keep else None)
        return
    patterns = (
        arguments.targets.split(",")
        if arguments.targets
        else list(targets.READERS if arguments.readers else targets.TARGETS)
    )
    names = [
        name
        for name in targets.TARGETS
        if any(name == one or (one.endswith("*") and name.startswith(one[:-1])) for one in patterns)
    ]
    begin = time.monotonic()
    folder = arguments.out.resolve()
    numbers = range(arguments.first, arguments.first + arguments.cases)
    results = attack(names, numbers, folder, arguments.workers, arguments.minutes, arguments.resume)
    (folder / "results.json").write_text(json.dumps(results))
    print(f"\n{table(results)}\n\n{time.monotonic() - begin:.0f} s with {arguments.workers} workers")
    print("\n".join(faults(results)) or "no faults")


if __name__ == "__main__":
    main()
