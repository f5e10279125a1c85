"""Real processes for the tests of the live mode: a robot's stand-in, and live runs whose lines are read."""

import json
import os
import resource
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from itertools import count
from pathlib import Path
from queue import Empty, Queue
from threading import Thread
from typing import Any

PATIENCE_S = 90.0
"""For what takes seconds: a machine that is busy must not fail a test."""

START = "0.11,0.60,1.2"
"""Where the log that ships starts."""

LEAST_HZ = 0.8 * 5.0
"""What is left of the rate of the log that ships, whatever goes wrong."""

SETTINGS = ("--set", "mcl.start_particles=1000", "--set", "mcl.particles=500", "--set", "search.particles_most=3000")
_NO_DISPLAY = {"DISPLAY": "", "WAYLAND_DISPLAY": ""}
_ENVIRONMENT = {
    **os.environ,
    **_NO_DISPLAY,
    "OPENBLAS_NUM_THREADS": "1",
    "OMP_NUM_THREADS": "1",
    "PYTHONUNBUFFERED": "1",
}


class Program:
    """A process of the program, or of a script. said: what it wrote on standard error."""

    def __init__(self, *arguments: object, script: Path | None = None, largest_file: int | None = None) -> None:
        what = ["-m", "localiser"] if script is None else [str(script)]
        command, pipe = [sys.executable, *what, *map(str, arguments)], subprocess.PIPE
        self.process = subprocess.Popen(command, stdin=pipe, stdout=pipe, stderr=pipe, text=True, env=_ENVIRONMENT)
        if largest_file is not None:  # what would be more fails, as on a full disk
            resource.prlimit(self.process.pid, resource.RLIMIT_FSIZE, (largest_file, largest_file))
        self._queue: Queue[str] = Queue()
        self.said: list[str] = []
        takes = ((self.process.stdout, self._queue.put), (self.process.stderr, self.said.append))
        self._readers = [
            Thread(target=lambda stream=stream, take=take: [take(line) for line in stream], daemon=True)
            for stream, take in takes
        ]
        for reader in self._readers:
            reader.start()

    def tell(self, line: str) -> None:
        """Write a line on its standard input."""
        self.process.stdin.write(f"{line}\n")
        self.process.stdin.flush()

    def poses(self, count: int) -> list[dict[str, Any]]:
        """Return the next `count` lines of JSON."""
        end = time.monotonic() + PATIENCE_S
        found: list[dict[str, Any]] = []
        while len(found) < count:
            try:
                found.append(json.loads(self._queue.get(timeout=max(end - time.monotonic(), 0.01))))
            except Empty:
                raise AssertionError(f"{len(found)} of {count} poses; said: {''.join(self.said)}") from None
        return found

    def poses_at(self, least_hz: float, count: int) -> list[dict[str, Any]]:
        """Return the first `count` lines in a row of images that were located at this rate, by their own stamps.

        What a run is slowed down to for good, it never gets out of; a machine that is busy for a while, it does.
        """
        end = time.monotonic() + PATIENCE_S
        lines = self.poses(count)
        while (rate_hz := (count - 1) / ((lines[-1]["stamp_ns"] - lines[0]["stamp_ns"]) / 1e9)) < least_hz:
            assert time.monotonic() < end, f"{rate_hz:.2f} Hz; said: {''.join(self.said)}"
            lines = [*lines[1:], *self.poses(1)]
        return lines

    def rest(self) -> list[dict[str, Any]]:
        """Return the lines that came and were not read yet."""
        lines = []
        while not self._queue.empty():
            lines.append(self._queue.get())
        return [json.loads(line) for line in lines if line.endswith("}\n")]

    def wait_to_say(self, text: str) -> None:
        """Wait until it has said something on standard error."""
        end = time.monotonic() + PATIENCE_S
        while not any(text in line for line in self.said):
            assert time.monotonic() < end and self.process.poll() is None, "".join(self.said)
            time.sleep(0.05)

    def end(self, number: int = signal.SIGTERM) -> int:
        """End it, which must not take long, and return its exit code."""
        if self.process.poll() is None:
            self.process.send_signal(number)
        return self.process.wait(PATIENCE_S)

    def all_said(self) -> str:
        """Return all that it said, once it has ended."""
        for reader in self._readers:
            reader.join(PATIENCE_S)
        return "".join(self.said)

    def children(self) -> list[int]:
        """Return the processes that it and its children have started (Linux)."""
        found, parents = [], [self.process.pid]
        while parents:
            listed = Path(f"/proc/{parents[0]}/task/{parents[0]}/children")
            new = [int(pid) for pid in listed.read_text().split()] if listed.exists() else []
            parents = [*parents[1:], *new]
            found += new
        return found


@contextmanager
def program(*arguments: object, script: Path | None = None, largest_file: int | None = None) -> Iterator[Program]:
    """Run a process of the program, or of a script, and end it whatever happens."""
    running = Program(*arguments, script=script, largest_file=largest_file)
    try:
        yield running
    finally:
        if running.process.poll() is None:
            running.process.send_signal(signal.SIGCONT)
            running.process.kill()
            running.process.wait()


def wait_until(met: Callable[[], object]) -> None:
    """Wait until something is true."""
    end = time.monotonic() + PATIENCE_S
    while not met():
        assert time.monotonic() < end
        time.sleep(0.02)


def free_endpoint() -> str:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return f"tcp/127.0.0.1:{probe.getsockname()[1]}"


_DOMAINS = range(102, 214)
_tried = count(7 * os.getpid())  # the workers of one test run begin apart


def free_domain() -> int:
    """Return a domain of DDS that nobody on this machine takes part in: nobody listens where participants are found."""
    for number in _tried:
        domain = _DOMAINS[number % len(_DOMAINS)]
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe, suppress(OSError):
            probe.bind(("", 7400 + 250 * domain))
            return domain
    raise AssertionError
