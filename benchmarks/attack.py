"""Attack every reader and every command with changed files, messages and options; count what is not told as an error.

    python benchmarks/attack.py --cases 100                      # all targets
    python benchmarks/attack.py --targets 'bag-*,map' --cases 10000 --minutes 60
    python benchmarks/attack.py --one map 123                    # one case again, in this process, with its traceback

`attack_inputs` makes good files and changes them by their structure, `attack_bombs` makes small ones that ask for
much. A case ends with a value, with an error that is told, or with a fault: another exception, more than its processor
time or memory, a process that died, a draft left behind, a file changed that was only read, an escape or HTML that
reached the terminal or a table. Workers stay, are watched from outside and are started anew after a fault. Inputs of
faults are kept in `results/attack/faults`. A case is made from the name of its target and its number alone.
"""

from __future__ import annotations

import argparse
import contextlib
import faulthandler
import json
import math
import os
import random
import resource
import select
import shutil
import signal
import statistics
import subprocess
import sys
import tempfile
import time
import traceback
import warnings
from collections import Counter, defaultdict
from fnmatch import fnmatch
from pathlib import Path
from queue import Empty, Queue
from threading import Lock, Thread
from typing import Any

import attack_inputs as inputs

from localiser.errors import LocaliserError

FAULT_FREE = ("value", "refused")
MEMORY_MB = 1500.0
"""What a case may take at most, the program itself (300 MB) included."""
LOOK_S = 0.05
_ADDRESSES, _LARGEST_FILE = 16 * 2**30, 2 * 2**30
_PATIENCE = 10  # times the limit of processor time: who sleeps that long, and does nothing else, waits for ever

# -- one case, in a worker --------------------------------------------------------------------------------------------


def case(name: str, number: int, samples: Path, folder: Path) -> dict[str, Any]:
    """Prepare a case in `folder`, run it, and return how it ended.

    end: value, refused, or what is wrong; at: where, for faults; seconds: processor time, without the preparation.
    """
    target = inputs.TARGETS[name]
    out = folder / "out"
    out.mkdir(parents=True)
    path = inputs.prepared(target, samples, folder / "in", random.Random(f"{name} {number}"))
    before = contents(folder / "in")
    end = attempt(target, path, out)
    if name in inputs.READERS and contents(folder / "in") != before:
        end |= {"end": "changed", "at": "a file that is read, or one beside it"}
    return end


def contents(folder: Path) -> dict[str, bytes]:
    """Return what the regular files in a folder hold, by their paths."""
    files = [path for path in folder.rglob("*") if path.is_file() and not path.is_symlink()]
    return {os.fsdecode(path): path.read_bytes() for path in files}


def attempt(target: inputs.Target, path: Path, out: Path) -> dict[str, Any]:
    """Run a target on an input and return how that ended, see `case`."""
    begin, here = time.process_time(), Path.cwd()
    try:
        target.run(path, out)
        end: dict[str, Any] = {"end": "value"}
    except LocaliserError as error:
        end = {"end": "refused"}
        if "\n" in str(error) or len(str(error)) > 2001:
            end = {"end": "message", "at": "an error of more than one paragraph", "text": str(error)[:5000]}
    except Exception as error:
        last = [frame for frame in traceback.extract_tb(error.__traceback__) if "/localiser/" in frame.filename]
        place = f"{last[-1].filename.split('/localiser/')[-1]}:{last[-1].lineno}" if last else "outside"
        end = {"end": type(error).__name__, "at": place, "text": traceback.format_exc()[-5000:]}
    finally:
        os.chdir(here)
    if end["end"] in FAULT_FREE:
        if drafts := [part.name for part in out.rglob(".localiser-*")]:
            end = {"end": "draft", "at": "left behind", "text": ", ".join(drafts)}
        tables = [part for part in out.rglob("*") if part.suffix in (".md", ".csv", ".html") and part.is_file()]
        if active := [part.name for part in tables if inputs.is_active(part.read_text(errors="replace"))]:
            end = {"end": "markup", "at": ", ".join(active)}
    return end | {"seconds": round(time.process_time() - begin, 4)}


def work(samples: Path) -> None:
    """Take cases from standard input, a line each, and answer on standard output how each ended."""
    faulthandler.register(signal.SIGUSR1, file=sys.__stderr__, all_threads=True)
    warnings.filterwarnings("error", category=RuntimeWarning, module="localiser")
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(os.open(os.devnull, os.O_RDWR), 1)
    inputs.use_samples(samples)
    import localiser.batch
    import localiser.commands.map
    import localiser.simulate
    import localiser.storage.bags  # noqa: F401 - so that the first cases take no longer than others

    for line in sys.stdin:
        name, number, folder = json.loads(line)
        _peak_mb()
        said = Path(folder).with_suffix(".said")
        with said.open("w") as file, contextlib.redirect_stdout(file), contextlib.redirect_stderr(file):
            end = case(name, number, samples, Path(folder))
        text = said.read_text(errors="replace")
        if end["end"] in FAULT_FREE and ("Traceback" in text or "\x1b" in text):
            end |= {"end": "traceback or escape", "at": "printed", "text": text[-5000:]}
        print(json.dumps(end | {"peak_mb": round(_peak_mb(), 1)}), file=answers, flush=True)


def _peak_mb() -> float:
    """Return the most memory (MB) since it was asked last (Linux)."""
    words = Path("/proc/self/status").read_text().split("VmHWM:")[1].split()
    Path("/proc/self/clear_refs").write_text("5")
    return int(words[0]) / 1024


# -- workers, watched from outside ------------------------------------------------------------------------------------


class Worker:
    """A process that takes cases, one after another, in a folder of its own."""

    def __init__(self, samples: Path, folder: Path) -> None:
        self._samples, self._folder = samples, folder
        self._process: subprocess.Popen[bytes] | None = None
        folder.mkdir(parents=True, exist_ok=True)

    def __call__(self, name: str, number: int, limit_s: float, keep: Path) -> dict[str, Any]:
        """Run a case and return how it ended; the input of one that went wrong is kept in the folder `keep`."""
        place = self._folder / "case"
        shutil.rmtree(place, ignore_errors=True)
        process = self._process or self._start()
        assert process.stdin is not None
        process.stdin.write(json.dumps([name, number, str(place)]).encode() + b"\n")
        process.stdin.flush()
        end = self._answer(process, limit_s)
        if end["end"] not in FAULT_FREE:
            shutil.rmtree(keep, ignore_errors=True)
            place.mkdir(exist_ok=True)
            pipes = [part.name for part in place.rglob("*") if part.is_fifo()]
            shutil.copytree(place, keep, symlinks=True, ignore=shutil.ignore_patterns(*pipes))
            (keep / "end.json").write_text(json.dumps(end, indent=1))
            self.close()
        return end

    def _start(self) -> subprocess.Popen[bytes]:
        here = Path(__file__).resolve()
        paths = os.pathsep.join((str(here.parent), str(here.parent.parent)))
        few = {f"{name}_NUM_THREADS": "1" for name in ("OMP", "OPENBLAS", "NUMBA")}
        self._said = (self._folder / "said").open("wb")
        self._process = subprocess.Popen(
            [sys.executable, str(here), "--worker", str(self._samples)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._said,
            cwd=self._folder,
            env=os.environ | few | {"PYTHONPATH": paths},
            start_new_session=True,  # Ctrl-C is for the parent
        )
        resource.prlimit(self._process.pid, resource.RLIMIT_AS, (_ADDRESSES, _ADDRESSES))
        resource.prlimit(self._process.pid, resource.RLIMIT_FSIZE, (_LARGEST_FILE, _LARGEST_FILE))
        return self._process

    def _answer(self, process: subprocess.Popen[bytes], limit_s: float) -> dict[str, Any]:
        assert process.stdout is not None
        awake, worked = time.monotonic(), processor_s(process.pid)
        while True:
            used = resident_mb(process.pid)  # before what it answers: a worker that is too large ends, however quick
            if used <= MEMORY_MB and select.select([process.stdout], [], [], LOOK_S)[0]:
                if line := process.stdout.readline():
                    found: dict[str, Any] = json.loads(line)
                    return found
                return {"end": f"died ({process.wait()})", "at": "", "text": self._told(), "seconds": 0.0}
            seconds = processor_s(process.pid) - worked
            if not is_asleep(process.pid):  # it may wait for a processor that others have, which is no fault
                awake = time.monotonic()
            if used > MEMORY_MB or seconds > limit_s or time.monotonic() - awake > _PATIENCE * limit_s:
                process.send_signal(signal.SIGUSR1)
                time.sleep(0.3)
                process.kill()
                process.wait()
                end = {"end": "memory" if used > MEMORY_MB else "hang", "text": (text := self._told())}
                lines = [line for line in text.splitlines() if "/localiser/" in line and "File" in line]
                return end | {"at": lines[:1], "seconds": round(seconds, 2), "peak_mb": round(used, 1)}

    def _told(self) -> str:
        return Path(self._said.name).read_text(errors="replace")[-5000:]

    def close(self) -> None:
        """End the process."""
        if self._process is not None:
            self._process.kill()
            self._process.wait()
            self._said.close()
        self._process = None


def resident_mb(pid: int) -> float:
    """Return how much memory (MB) a process has now (Linux)."""
    try:
        pages = int(Path(f"/proc/{pid}/statm").read_text().split()[1])
    except (OSError, IndexError):
        return 0.0
    return pages * resource.getpagesize() / 2**20


def processor_s(pid: int) -> float:
    """Return the processor time (s) of a process until now (Linux)."""
    try:
        words = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()
    except (OSError, IndexError):
        return 0.0
    return (int(words[11]) + int(words[12])) / os.sysconf("SC_CLK_TCK")


def is_asleep(pid: int) -> bool:
    """Return whether all threads of a process wait for something, other than a processor or the disk (Linux)."""
    try:
        stats = [path.read_text() for path in Path(f"/proc/{pid}/task").glob("*/stat")]
    except OSError:
        return False
    return all(stat.rsplit(")", 1)[1].split()[0] not in "RD" for stat in stats)


# -- all cases --------------------------------------------------------------------------------------------------------

Ends = dict[str, list[dict[str, Any]]]


def attack(names: list[str], numbers: range, folder: Path, workers: int, minutes: float) -> Ends:
    """Run the cases of some targets, evenly mixed, and return how they ended, by target. No case begins later."""
    samples = inputs.make(folder / "samples")
    results: Ends = {name: [] for name in names}
    begin, lock, queue = time.monotonic(), Lock(), Queue[tuple[str, int]]()
    for number in numbers:
        for name in names:
            queue.put((name, number))

    def run(place: int) -> None:
        worker = Worker(samples, folder / f"worker{place}")
        with contextlib.suppress(Empty):
            while time.monotonic() - begin < 60 * minutes:
                name, number = queue.get_nowait()
                keep = folder / "faults" / name / str(number)
                end = worker(name, number, inputs.TARGETS[name].limit_s, keep) | {"case": number}
                with lock:
                    results[name].append(end)
                    if end["end"] not in FAULT_FREE:
                        print(f"{name} {number}: {end['end']} at {end['at']}", flush=True)
        worker.close()

    threads = [Thread(target=run, args=(place,)) for place in range(workers)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    return {name: ends for name, ends in results.items() if ends}


def table(results: Ends) -> str:
    """Return counts, times and memory of every target as a table of Markdown, and each fault with its first cases."""
    lines = ["| target | cases | read | refused | faults | median ms | worst s | worst MB |", "|---|" + "---:|" * 7]
    found: dict[str, list[str]] = defaultdict(list)
    for name, ends in results.items():
        counts, seconds = Counter(end["end"] for end in ends), [end["seconds"] for end in ends]
        wrong = [end for end in ends if end["end"] not in FAULT_FREE]
        cells = [
            name,
            len(ends),
            counts["value"],
            counts["refused"],
            len(wrong),
            f"{1e3 * statistics.median(seconds):.1f}",
        ]
        cells += [f"{max(seconds):.1f}", f"{max(end.get('peak_mb', 0.0) for end in ends):.0f}"]
        lines.append("| " + " | ".join(map(str, cells)) + " |")
        for end in wrong:
            found[f"{end['end']} at {end['at']}"].append(f"{name} {end['case']}")
    told = [f"{len(cases)} × {what}: {', '.join(cases[:4])}" for what, cases in found.items()]
    return "\n".join([*lines, "", *(told or ["no faults"])])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--targets", default="*", help="some, with commas between; * stands for anything")
    parser.add_argument("--cases", type=int, default=1000, help="cases of every target")
    parser.add_argument("--minutes", type=float, default=math.inf, help="no case begins later")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--out", type=Path, default=Path("results/attack"))
    parser.add_argument("--one", nargs=2, metavar=("TARGET", "CASE"))
    parser.add_argument("--worker", type=Path, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.worker:
        work(arguments.worker)
    elif arguments.one:
        with tempfile.TemporaryDirectory() as folder:
            inputs.use_samples(samples := inputs.make(Path(folder) / "samples"))
            print(case(arguments.one[0], int(arguments.one[1]), samples, Path(folder) / "case"))
    else:
        patterns = arguments.targets.split(",")
        names = [name for name in inputs.TARGETS if any(fnmatch(name, each) for each in patterns)]
        begin = time.monotonic()
        results = attack(names, range(arguments.cases), arguments.out.resolve(), arguments.workers, arguments.minutes)
        print(f"\n{table(results)}\n{sum(map(len, results.values()))} cases in {time.monotonic() - begin:.0f} s")


if __name__ == "__main__":
    main()
