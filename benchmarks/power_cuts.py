"""Programs killed at random moments: is a file under its final name ever cut off, is what was promised there?

    python benchmarks/power_cuts.py --kills 200

Five kinds of work, each in a process of its own that is killed (SIGKILL) at a random moment: a recording of a live run
(promised: what was committed), a saved state and a map that are written again and again (promised: the last one that
was done), a log that is converted into a folder or a bag (the target is whole, or not there), and a batch (runs that
were reported are in their folders; every file that is there can be read; the batch goes on and comes to the same
table). With no failure in 200 kills, the probability of one is below 1.5 % at 95 % confidence. A kill is not quite a
power cut: what a program has handed to the system survives it. Only saved states and recordings wait for the disk.
"""

from __future__ import annotations

import argparse
import csv
import os
import random
import shutil
import signal
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import attack_samples

from localiser.documents import read_bytes, write_bytes
from localiser.storage import open_log, read_figures, read_json, read_map, read_runs, read_track, write_map
from localiser.storage.bags import TEXT, BagRecorder, Messages
from localiser.storage.bags.bag import Bag
from localiser.storage.checkpoint import checkpoint_of

Tell = Callable[[object], None]
SHORTEST_S = 0.01


@dataclass(frozen=True)
class Work:
    """do: works in a folder until it is done or killed, and tells what it promises. check: raises where that is wrong.

    lasts_s: how long to wait at most before the kill; None: as long as it takes when it is not killed.
    """

    do: Callable[[Path, Tell], None]
    check: Callable[[Path, list[str]], None]
    lasts_s: float | None = None


class Works:
    """The kinds of work, on the good files in a folder."""

    def __init__(self, samples: Path) -> None:
        self.samples = samples
        self.log = open_log(samples / "log")
        self.state = (samples / "saved.state").read_bytes()
        self.map = read_map(samples / "map.yaml")
        everything = {
            "recording": Work(self.record, self.check_recording, 0.6),
            "saved state": Work(self.save, self.check_state, 0.6),
            "map": Work(self.write_map, self.check_map, 0.6),
            "convert to a folder": Work(self.convert("log"), self.check_converted("log")),
            "convert to a bag": Work(self.convert("log.mcap"), self.check_converted("log.mcap")),
            "batch": Work(self.batch, self.check_batch),
        }
        self.by_name = everything

    def record(self, folder: Path, tell: Tell) -> None:
        """Record messages, and tell how many are committed."""
        recorder, make = BagRecorder(folder / "run.db3"), Messages()
        for number in range(10**9):
            text = make.encode(make.text(str(number) * 200))
            recorder.write("/text", TEXT, number, text)
            if number % 20 == 19:
                recorder.commit()
                tell(number + 1)

    def check_recording(self, folder: Path, told: list[str]) -> None:
        """Every message that was committed is there, whole."""
        if not told:
            return
        with Bag(folder / "run.db3") as bag:
            texts = [message.content.data for message in bag.messages(bag.topics)]
        assert len(texts) >= int(told[-1]), f"{len(texts)} of {told[-1]} messages"
        assert texts == [str(number) * 200 for number in range(len(texts))]

    def save(self, folder: Path, tell: Tell) -> None:
        """Save a state again and again, durably, as a live run does."""
        for number in range(10**9):
            write_bytes(folder / "state", self.state, durably=True)
            tell(number)

    def check_state(self, folder: Path, told: list[str]) -> None:
        """The state is whole, and is there once it was said to be."""
        if told or (folder / "state").exists():
            checkpoint_of(read_bytes(folder / "state", 2**30), folder / "state")

    def write_map(self, folder: Path, tell: Tell) -> None:
        """Write a map that grows by a name, again and again."""
        from dataclasses import replace

        for number in range(10**9):
            write_map(replace(self.map, name=str(number)), folder / "map.yaml")
            tell(number)

    def check_map(self, folder: Path, told: list[str]) -> None:
        """The map is whole, and the last one that was written or the next."""
        if told or (folder / "map.yaml").exists():
            found = read_map(folder / "map.yaml")
            assert len(found) == len(self.map)
            assert int(found.name) - int(told[-1] if told else -1) in (0, 1), f"{found.name} after {told[-1:]}"

    def convert(self, name: str) -> Callable[[Path, Tell], None]:
        """Return what converts the log."""
        return lambda folder, _: attack_samples.run("convert", self.samples / "log", folder / name, "--quiet")

    def check_converted(self, name: str) -> Callable[[Path, list[str]], None]:
        """Return what looks whether the new log is whole, or not there."""

        def check(folder: Path, _: list[str]) -> None:
            if (folder / name).exists():
                found = open_log(folder / name)
                assert len(found.frames) == len(self.log.frames) and len(found.odometry) == len(self.log.odometry)
                for frame in found.frames:
                    frame.load()  # type: ignore[union-attr]

        return check

    def batch(self, folder: Path, tell: Tell) -> None:
        """Run a batch of three runs; tell of each that is done."""
        from localiser.batch import Batch, Workers, choices_of, run_batch

        choices = choices_of([], attack_samples.FEW[1::2], "0-2")
        batch = Batch([self.samples / "edges"], choices, folder / "out")
        run_batch(batch, Workers(1, None), lambda done, left: lambda: tell(left))

    def check_batch(self, folder: Path, told: list[str]) -> None:
        """Whatever is there can be read, and as many runs as were reported are complete."""
        readers = {
            "row.json": read_figures,
            "metrics.json": read_json,
            "trajectory.csv": read_track,
            "runs.csv": read_runs,
        }
        for path in sorted((folder / "out").rglob("*")):
            if path.name in readers and not (path.name == "trajectory.csv" and len(path.read_text().splitlines()) < 2):
                readers[path.name](path)
        assert len(list((folder / "out").rglob("row.json"))) >= len(told)


def killed(work: Work, folder: Path, after_s: float) -> list[str]:
    """Do the work in a process that is killed after some time; return what it told until then."""
    reading, writing = os.pipe()
    child = os.fork()
    if child == 0:
        try:
            os.close(reading)
            work.do(folder, lambda what: os.write(writing, f"{what}\n".encode()) and None)
        finally:
            os._exit(0)
    os.close(writing)
    time.sleep(after_s)
    os.kill(child, signal.SIGKILL)
    os.waitpid(child, 0)
    with os.fdopen(reading, "rb") as pipe:
        return [line.decode() for line in pipe.read().split(b"\n")[:-1]]


def duration_s(work: Work, folder: Path) -> float:
    """Return how long the work takes in a process like those that are killed."""
    begin = time.monotonic()
    child = os.fork()
    if child == 0:
        try:
            work.do(folder, lambda what: None)
        finally:
            os._exit(0)
    os.waitpid(child, 0)
    return time.monotonic() - begin


def figures(path: Path) -> list[dict[str, str]]:
    """Return the rows of runs.csv without times."""
    with path.open(newline="") as file:
        return [
            {name: cell for name, cell in row.items() if "ms" not in name and "path" not in name}
            for row in csv.DictReader(file)
        ]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--kills", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", help="names of works that contain this")
    arguments = parser.parse_args()
    rng = random.Random(arguments.seed)
    with tempfile.TemporaryDirectory() as temporary:
        works = Works(attack_samples.make(Path(temporary) / "samples"))
        for name, work in works.by_name.items():
            if arguments.only is None or arguments.only in name:
                failures = attacked(name, work, Path(temporary), arguments.kills, rng)
                print("\n".join(failures[:5]) or f"{name}: no failure in {arguments.kills} kills", flush=True)


def attacked(name: str, work: Work, temporary: Path, kills: int, rng: random.Random) -> list[str]:
    """Kill the work at random moments; return what was wrong, and for a batch whether it goes on."""
    place = temporary / "work"
    shutil.rmtree(place, ignore_errors=True)
    place.mkdir()
    whole_s = work.lasts_s or duration_s(work, place)
    promised, failures = 0, []
    for number in range(kills):
        wanted = place if work.lasts_s is None and number == 0 else None
        expected = figures(wanted / "out" / "runs.csv") if wanted and name == "batch" else []
        shutil.rmtree(place)
        place.mkdir()
        told = killed(work, place, SHORTEST_S + rng.random() * whole_s)
        promised += len(told)
        try:
            work.check(place, told)
        except Exception as error:
            failures.append(f"{name}, kill {number}: {error}")
        if expected:
            works_again = duration_s(work, place)
            found = figures(place / "out" / "runs.csv")
            if found != expected:
                failures.append(f"{name}: goes on to another table, in {works_again:.1f} s")
    print(f"{name}: killed within {whole_s:.2f} s, {promised / kills:.1f} promises a kill (mean)", flush=True)
    return failures


if __name__ == "__main__":
    main()
