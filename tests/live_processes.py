"""Real processes for the tests of the live mode: a robot's stand-in, and live runs whose lines are read."""

from __future__ import annotations

import json
import os
import resource
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from queue import Empty, Queue
from threading import Thread
from typing import Any

PATIENCE_S = 90.0
"""For what takes seconds: a machine that is busy must not fail a test."""

SETTINGS = ("--set", "mcl.start_particles=1000", "--set", "mcl.particles=500", "--set", "search.particles_most=3000")
_ENVIRONMENT = {**os.environ, "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "PYTHONUNBUFFERED": "1"}


class Program:
    """A process of the program. lines: what it wrote on standard output; said: on standard error."""

    def __init__(self, *arguments: object, largest_file: int | None = None) -> None:
        command = [sys.executable, "-m", "localiser", *map(str, arguments)]
        self.process = subprocess.Popen(
            command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=_ENVIRONMENT
        )
        if largest_file is not None:  # what would be more fails, as on a full disk
            resource.prlimit(self.process.pid, resource.RLIMIT_FSIZE, (largest_file, largest_file))
        self._queue: Queue[str] = Queue()
        self.said: list[str] = []
        for stream, take in ((self.process.stdout, self._queue.put), (self.process.stderr, self.said.append)):
            Thread(target=lambda stream=stream, take=take: [take(line) for line in stream], daemon=True).start()

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
def program(*arguments: object, largest_file: int | None = None) -> Iterator[Program]:
    """Run a process of the program, and end it whatever happens."""
    running = Program(*arguments, largest_file=largest_file)
    try:
        yield running
    finally:
        if running.process.poll() is None:
            running.process.send_signal(signal.SIGCONT)
            running.process.kill()
            running.process.wait()


def free_endpoint() -> str:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return f"tcp/127.0.0.1:{probe.getsockname()[1]}"
