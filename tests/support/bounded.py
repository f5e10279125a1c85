"""Python code in a process of its own, which may take only so much more memory, and time beside what it has taken."""

import math
import os
import resource
import subprocess
import sys
from pathlib import Path

from attack import processor_s

MORE_MB, TIMES = 300, 3  # the processor's time in all is a multiple of that of the start, on any machine
_PRELUDE = """
def begin():
    print("ready", flush=True)
    input()
"""
_FEW_THREADS = {"MALLOC_ARENA_MAX": "1", "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "NUMBA_NUM_THREADS": "1"}


def bounded(code: str, *arguments: object) -> str:
    """Run code whose limits hold from where it calls `begin()`; returns what it wrote on standard output since.

    Whoever takes more is refused memory, or killed (Linux).
    """
    command, pipe = [sys.executable, "-c", _PRELUDE + code, *map(str, arguments)], subprocess.PIPE
    environment = os.environ | _FEW_THREADS | {"PYTHONPATH": os.pathsep.join(sys.path)}
    with subprocess.Popen(command, stdin=pipe, stdout=pipe, stderr=pipe, text=True, env=environment) as child:
        if child.stdout.readline() == "ready\n":
            pages = int(Path(f"/proc/{child.pid}/statm").read_text().split()[0])
            memory = pages * resource.getpagesize() + MORE_MB * 2**20
            seconds = math.ceil(TIMES * processor_s(child.pid))
            resource.prlimit(child.pid, resource.RLIMIT_AS, (memory, memory))
            resource.prlimit(child.pid, resource.RLIMIT_CPU, (seconds, seconds))
        said, errors = child.communicate("\n")
    assert child.returncode == 0, f"ended with {child.returncode}: {said}{errors[-3000:]}"
    return said
