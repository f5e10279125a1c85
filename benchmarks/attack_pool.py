"""Workers that stay, watched from outside: one that takes too long or too much memory is killed and started anew."""

from __future__ import annotations

import json
import math
import os
import resource
import select
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterable
from pathlib import Path
from queue import Empty, Queue
from threading import Event, Lock, Thread
from typing import Any

MEMORY_MB = 1500.0
"""What a case may take at most, the program itself (300 MB) included."""

_ADDRESSES = 16 * 2**30  # what is reserved is more than what is used
_LARGEST_FILE = 2 * 2**30
LOOK_S = 0.05
_PATIENCE = 10  # times the limit of processor time: who sleeps that long, and does nothing else, waits for ever

Case = tuple[str, int]


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
        if end["end"] not in ("value", "refused"):
            shutil.rmtree(keep, ignore_errors=True)
            place.mkdir(exist_ok=True)
            shutil.copytree(place, keep, symlinks=True, ignore=_no_pipes)
            (keep / "end.json").write_text(json.dumps(end, indent=1))
            self.close()
        return end

    def _start(self) -> subprocess.Popen[bytes]:
        here = Path(__file__).resolve().parent
        paths = os.pathsep.join((str(here), str(here.parent)))
        variables = {"PYTHONPATH": paths, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "NUMBA_NUM_THREADS": "1"}
        self._said = (self._folder / "said").open("wb")
        self._process = subprocess.Popen(
            [sys.executable, str(here / "attack_worker.py"), str(self._samples)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._said,
            cwd=self._folder,
            env=os.environ | variables,
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
                line = process.stdout.readline()
                if line:
                    found: dict[str, Any] = json.loads(line)
                    return found
                return {"end": f"died ({process.wait()})", "at": "", "text": self._told(), "seconds": 0.0}
            seconds = processor_s(process.pid) - worked
            if not is_asleep(process.pid):  # it may wait for a processor that others have, which is no fault
                awake = time.monotonic()
            if used > MEMORY_MB or seconds > limit_s or time.monotonic() - awake > _PATIENCE * limit_s:
                what = "memory" if used > MEMORY_MB else "hang"
                process.send_signal(signal.SIGUSR1)
                time.sleep(0.3)
                process.kill()
                process.wait()
                text = self._told()
                end = {"end": what, "at": _innermost(text), "text": text}
                return end | {"seconds": round(seconds, 2), "peak_mb": round(used, 1)}

    def _told(self) -> str:
        self._said.flush()
        return Path(self._said.name).read_text(errors="replace")[-5000:]

    def close(self) -> None:
        """End the process."""
        if self._process is not None:
            self._process.kill()
            self._process.wait()
            self._said.close()
        self._process = None


def _no_pipes(folder: str, names: list[str]) -> list[str]:
    return [name for name in names if (Path(folder) / name).is_fifo()]


def _innermost(stack: str) -> str:
    """Return the innermost place in our program that a stack of faulthandler names."""
    lines = [line for line in stack.splitlines() if "/localiser/" in line and "File" in line]
    return lines[0].split("/localiser/")[-1].replace('", line ', ":").split(" in ")[0] if lines else ""


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


def run_all(
    cases: Iterable[Case],
    samples: Path,
    folder: Path,
    workers: int,
    limit_s: Callable[[str], float],
    done: Callable[[Case, dict[str, Any]], None],
    minutes: float = math.inf,
    stop: Event | None = None,
) -> None:
    """Run cases on some workers; `done` gets how each ended, on one thread at a time.

    minutes, stop: no case begins later than that, or once that is set.
    """
    end = time.monotonic() + 60 * minutes
    queue: Queue[Case] = Queue()
    for case in cases:
        queue.put(case)
    lock = Lock()

    def work(place: int) -> None:
        worker = Worker(samples, folder / f"worker{place}")
        try:
            while time.monotonic() < end and not (stop and stop.is_set()):
                name, number = queue.get_nowait()
                found = worker(name, number, limit_s(name), folder / "faults" / name / str(number))
                with lock:
                    done((name, number), found)
        except Empty:
            pass
        finally:
            worker.close()

    threads = [Thread(target=work, args=(place,)) for place in range(workers)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
