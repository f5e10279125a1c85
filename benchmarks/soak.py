"""A live run for hours with a robot that misbehaves at random: does anything grow, and is the robot ever lost for good?

    python benchmarks/soak.py --minutes 120 --plot docs/images/soak.png

What happens is drawn from a seed: calm, then one of the faults of the tests (messages twice, in another order, with
times in the future, damaged, junk, no odometry), a robot that stops for seconds, one that is started anew, or a pose
stated by hand. The run saves its state and records what comes in. Every few seconds its memory, descriptors and
threads are read from /proc (Linux), and how many images were located, how far off, and how sure. The samples go to a
CSV file, from which `--draw` draws the plot again.
"""

from __future__ import annotations

import argparse
import csv
import random
import signal
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).resolve().parent.parent
sys.path[:0] = [str(ROOT / "tests" / "support")]

from live_processes import SETTINGS, START, Program, free_endpoint, program  # noqa: E402

LOG = ROOT / "logs" / "corridor"
ROBOT = ROOT / "benchmarks" / "faulty_robot.py"
MESSAGES = ("duplicated", "reordered", "in the future", "corrupt", "junk", "no odometry")
OTHERS = ("stopped", "started anew", "pose stated")
FIELDS = ("seconds", "memory_mb", "descriptors", "threads", "images", "error_m", "p_correct", "fault")
CALM_S, FAULT_S, SAMPLE_S = 8.0, 8.0, 5.0
LOST_M = 0.5


def happenings(rng: random.Random) -> Iterator[tuple[str, float]]:
    """Yield what happens and for how long (s), without end: calm and faults by turns."""
    while True:
        yield "", rng.expovariate(1 / CALM_S) + 2
        yield rng.choice(MESSAGES + OTHERS), rng.expovariate(1 / FAULT_S) + 2


class Robot:
    """The robot's process, with what is wrong with it."""

    def __init__(self, endpoint: str) -> None:
        self._endpoint = endpoint
        self._kept = ExitStack()
        self._start()

    def _start(self) -> None:
        self._program = self._kept.enter_context(program(LOG, self._endpoint, script=ROBOT))

    def become(self, fault: str) -> None:
        """Let something go wrong, or everything be well again ("")."""
        self._program.process.send_signal(signal.SIGCONT)
        if fault == "started anew":
            self.close()
            self._kept = ExitStack()
            self._start()
        elif fault == "stopped":
            self._program.process.send_signal(signal.SIGSTOP)
        elif fault == "pose stated":
            with program("pose", "set", START, "--set", f"live.connect={self._endpoint}") as stating:
                stating.process.wait(60)
        else:
            self._program.tell(fault)

    def close(self) -> None:
        """End the process."""
        self._kept.close()


def sample(live: Program, begin: float, fault: str) -> dict[str, Any]:
    """Return the state of a live run now, and what it has located since it was asked last."""
    place = Path(f"/proc/{live.process.pid}")
    status = dict(line.split(":\t", 1) for line in (place / "status").read_text().splitlines() if ":\t" in line)
    lines = live.rest()
    errors = [line["error_m"] for line in lines if "error_m" in line]
    return {
        "seconds": round(time.monotonic() - begin, 1),
        "memory_mb": round(int(status["VmRSS"].split()[0]) / 1024, 1),
        "descriptors": len(list((place / "fd").iterdir())),
        "threads": int(status["Threads"]),
        "images": len(lines),
        "error_m": round(float(np.median(errors)), 4) if errors else "",
        "p_correct": round(float(np.median([line["p_correct"] for line in lines])), 4) if lines else "",
        "fault": fault,
    }


def soak(minutes: float, seed: int, out: Path) -> list[dict[str, Any]]:
    """Run, write the samples as they come, and return them."""
    rng, endpoint = random.Random(seed), free_endpoint()
    samples = []
    with ExitStack() as kept:
        folder = Path(kept.enter_context(tempfile.TemporaryDirectory()))
        robot = Robot(endpoint)
        kept.callback(robot.close)
        files = ("--record", folder / "run.db3", "--checkpoint", folder / "state")
        arguments = ("--map", LOG / "map.yaml", "--json", "--connect", endpoint, *files)
        live = kept.enter_context(program("live", *arguments, *SETTINGS))
        live.poses(1)
        table = csv.DictWriter(kept.enter_context(out.open("w", newline="", buffering=1)), FIELDS, lineterminator="\n")
        table.writeheader()
        begin = time.monotonic()
        for fault, seconds in happenings(rng):
            if time.monotonic() - begin > 60 * minutes:
                break
            robot.become(fault)
            end = time.monotonic() + seconds
            while time.monotonic() < end:
                time.sleep(min(SAMPLE_S, max(end - time.monotonic(), 0.1)))
                if live.process.poll() is not None:
                    raise SystemExit(f"the live run has ended: {live.all_said()[-3000:]}")
                samples.append(sample(live, begin, fault))
                table.writerow(samples[-1])
        robot.become("")
        code = live.end()
        said = live.all_said()
        print(f"exit code {code}; tracebacks: {said.count('Traceback')}; said {len(said.splitlines())} lines")
    return samples


def read(path: Path) -> list[dict[str, Any]]:
    """Return the samples that were written."""
    with path.open(newline="") as file:
        return [
            {name: cell if name == "fault" else float(cell) if cell else "" for name, cell in row.items()}
            for row in csv.DictReader(file)
        ]


def growth(samples: list[dict[str, Any]], name: str) -> tuple[float, float]:
    """Return the slope per hour of a column over the second half of a run, and its standard error."""
    half = samples[len(samples) // 2 :]
    hours = np.array([row["seconds"] for row in half]) / 3600
    values = np.array([row[name] for row in half], dtype=float)
    coefficients, cov = np.polyfit(hours, values, 1, cov=True)
    return float(coefficients[0]), float(np.sqrt(cov[0, 0]))


def summary(samples: list[dict[str, Any]]) -> str:
    """Return what the samples say, in a few lines."""
    seconds = samples[-1]["seconds"]
    calm = [row for row in samples if row["fault"] == "" and row["error_m"] != ""]
    lost = sum(row["error_m"] > LOST_M for row in calm)
    lines = [f"{seconds / 60:.1f} minutes, {sum(row['images'] for row in samples):.0f} images located"]
    lines.append(f"samples in calm with the median image off by more than {LOST_M} m: {lost} of {len(calm)}")
    for name in ("memory_mb", "descriptors", "threads"):
        values = [row[name] for row in samples]
        slope, error = growth(samples, name)
        lines.append(f"{name}: {min(values):g} to {max(values):g}; second half {slope:+.1f} ± {error:.1f} an hour")
    return "\n".join(lines)


def draw(samples: list[dict[str, Any]], path: Path) -> None:
    """Draw the samples over time; shaded where something was wrong."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    minutes = np.array([row["seconds"] for row in samples]) / 60
    gaps = np.diff(minutes, prepend=0.0) * 60
    rows = {
        "memory (MB)": [row["memory_mb"] for row in samples],
        "descriptors": [row["descriptors"] for row in samples],
        "threads": [row["threads"] for row in samples],
        "images per second": [row["images"] / max(gap, 1e-3) for row, gap in zip(samples, gaps, strict=True)],
        "error (m)": [np.nan if row["error_m"] == "" else row["error_m"] for row in samples],
    }
    figure, axes = plt.subplots(len(rows), 1, figsize=(9, 9), sharex=True, layout="constrained")
    for axis, (name, column) in zip(axes, rows.items(), strict=True):
        axis.plot(minutes, column, color="#2f6690", linewidth=1.2)
        axis.set_ylabel(name)
        if name == "error (m)":
            axis.set_yscale("log")
        else:
            axis.set_ylim(0, 1.15 * max(np.nanmax(column), 1))
        axis.grid(alpha=0.3)
        for before, now, row in zip([0.0, *minutes[:-1]], minutes, samples, strict=True):
            if row["fault"]:
                axis.axvspan(before, now, color="#d1782f", alpha=0.18, linewidth=0)
    axes[-1].set_xlabel("minutes; shaded: something is wrong with the robot")
    figure.savefig(path, dpi=110)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--minutes", type=float, default=120)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, default=Path("results/soak.csv"))
    parser.add_argument("--plot", type=Path)
    parser.add_argument("--draw", action="store_true", help="draw what is in --out, and run nothing")
    arguments = parser.parse_args()
    arguments.out.parent.mkdir(parents=True, exist_ok=True)
    samples = read(arguments.out) if arguments.draw else soak(arguments.minutes, arguments.seed, arguments.out)
    print(summary(samples))
    if arguments.plot:
        draw(samples, arguments.plot)


if __name__ == "__main__":
    main()
