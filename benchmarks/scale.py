"""What a building costs by its size: start, memory, tracking, and finding the robot anywhere.

Buildings are those of `scale_building.py`. The first rooms are the same in all of them, and tracking is measured there,
so that only what is far away differs. Each size runs in a process of its own, with compiled loops loaded before.

    read     the map's file, s
    start    s, from a map in memory to a localiser that is ready
    MB       more than a process that has the loops and a map of 50 landmarks: after the start
    track    ms of the thread an image: median and 95 % over a drive
    found    images until the robot is where it is believed to be, surely, from nothing: median and worst of the drives
    ms most  the longest that an image took then

python benchmarks/scale.py
python benchmarks/scale.py --landmarks 100 1000 --drives 3
"""

from __future__ import annotations

import argparse
import json
import resource
import subprocess
import sys
import tempfile
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
from board.run import run
from rich.console import Console
from rich.table import Table
from scale_building import CAMERA, drive_of, floor_of

from localiser import Localiser, read_map, write_map

TRACKED, SEARCHED = 150, 60  # images
FIRST_ROOM = 2
MOST_YAML = 20_000  # landmarks, above which writing and reading the text takes minutes
HEADS = ("landmarks", "read", "start", "MB", "track", "95 %", "found", "worst", "ms most")


def memory_mb() -> float:
    """Return the most memory that this process has had."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def figures_of(landmarks: int, drives: int, *, with_file: bool) -> dict[str, Any]:
    """Return the figures of a building of this size."""
    floor = floor_of(landmarks)
    Localiser(floor_of(50).landmark_map, CAMERA).warm_up(images=False)
    before = memory_mb()
    begin = perf_counter()
    robot = Localiser(floor.landmark_map, CAMERA)
    robot.warm_up(images=False)
    figures: dict[str, Any] = {"landmarks": landmarks, "start_s": perf_counter() - begin, "mb": memory_mb() - before}
    tracked = run(drive_of(floor, FIRST_ROOM, TRACKED), 1)
    figures |= {"track_ms": float(np.median(tracked.ms[5:])), "track_95_ms": float(np.quantile(tracked.ms[5:], 0.95))}
    figures |= {"error_m": float(np.median(tracked.error_m))}
    figures |= _searched(floor, drives)
    return figures | (_read(floor) if with_file else {})


def _searched(floor: Any, drives: int) -> dict[str, Any]:
    """Return how many images it took to find the robot; the number of all of them where it was not found."""
    rng = np.random.default_rng(5)
    found, longest, wrong = [], 0.0, 0
    for drive in range(drives):
        first = int(rng.integers(max(floor.rooms - 12, 1)))
        record = run(drive_of(floor, first, SEARCHED, drive), drive, start=None)
        sure = record.sure & record.right
        found.append(int(sure.argmax()) + 1 if sure.any() else SEARCHED)
        longest = max(longest, float(record.ms.max()))
        wrong += int((record.sure & ~record.right).sum())
    return {"found": float(np.median(found)), "found_worst": max(found), "search_ms": longest, "surely_wrong": wrong}


def _read(floor: Any) -> dict[str, float]:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "map.yaml"
        write_map(floor.landmark_map, path)
        begin = perf_counter()
        read_map(path)
        return {"read_s": perf_counter() - begin}


def table_of(rows: list[dict[str, Any]]) -> Table:
    """Return the figures as a table."""
    table = Table(title="Cost by the size of the building: one thread")
    for head in HEADS:
        table.add_column(head, justify="right")
    for row in rows:
        table.add_row(
            str(row["landmarks"]),
            *(f"{row[name]:.2f} s" if name in row else "" for name in ("read_s", "start_s")),
            f"{row['mb']:.0f}",
            *(f"{row[name]:.1f} ms" for name in ("track_ms", "track_95_ms")),
            f"{row['found']:.0f}",
            str(row["found_worst"]),
            f"{row['search_ms']:.0f}",
        )
    return table


def main() -> None:
    """Measure every size in a process of its own, or one in this process."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--landmarks", nargs="+", type=int, default=[100, 1000, 10_000, 100_000])
    parser.add_argument("--drives", type=int, default=8, help="from nothing, in each building")
    parser.add_argument("--files", action="store_true", help="read and write maps of any size as YAML too: minutes")
    parser.add_argument("--here", action="store_true", help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.here:
        (landmarks,) = arguments.landmarks
        with_file = arguments.files or landmarks <= MOST_YAML
        print(json.dumps(figures_of(landmarks, arguments.drives, with_file=with_file)))
        return
    rows = []
    for landmarks in arguments.landmarks:
        command = [sys.executable, __file__, "--here", "--landmarks", str(landmarks), "--drives", str(arguments.drives)]
        command += ["--files"] if arguments.files else []
        done = subprocess.run(command, stdout=subprocess.PIPE, check=True, text=True)
        rows.append(json.loads(done.stdout))
    Console(width=120).print(table_of(rows))
    if len(rows) > 1:
        sizes, ms = np.log([row["landmarks"] for row in rows]), np.log([row["track_ms"] for row in rows])
        print(f"tracking grows as landmarks^{np.polyfit(sizes, ms, 1)[0]:.3f}")


if __name__ == "__main__":
    main()
