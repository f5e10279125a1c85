"""How many instructions an image takes: figures that depend neither on other work on the machine nor on its speed.

    edges   finding the vertical edges of an image
    whole   that, and the filter's step

valgrind counts them along the first images of the log that ships, by the difference between a longer and a shorter
replay. Everything is compiled for x86-64-v2: vectors of 128 bits and no fused multiplication, as valgrind runs those in
software, a thousand times as slowly. So a processor with wider vectors takes fewer. Loops are compiled before, outside
valgrind, and loaded from the disk.

python benchmarks/instructions.py                # needs Debian's package `valgrind`; five minutes
"""

from __future__ import annotations

import argparse
import os
import re
import subprocess
import sys
from itertools import islice

import cv2
from figures.program import KEPT, ONE_THREAD, ROOT

from localiser.config import read_config
from localiser.filter import Odometry
from localiser.localiser import Localiser
from localiser.storage import ImageEvent, open_log

FIRST, LAST = 5, 25
"""Images of the shorter and of the longer replay."""
CONFIGURATIONS = {"default": None, "small": ROOT / "configs" / "small.yaml"}
_COUNT = ["valgrind", "--tool=cachegrind", "--cache-sim=no", "--cachegrind-out-file=/dev/null"]
_PLAIN = {  # no library and no loop uses more than x86-64-v2 has
    "NUMBA_CPU_NAME": "x86-64-v2",
    "NUMBA_CPU_FEATURES": "",
    "NPY_DISABLE_CPU_FEATURES": "X86_V3 X86_V4 AVX512_ICL AVX512_SPR",
    "OPENCV_CPU_DISABLE": "AVX,FP16,AVX2,FMA3",
    "OPENBLAS_CORETYPE": "Nehalem",
    "GLIBC_TUNABLES": "glibc.cpu.hwcaps=-AVX2,-FMA,-AVX",
}


def millions(configuration: str, seed: int = 0) -> dict[str, float]:
    """Return the millions of instructions that an image takes; seed: of Python's hashes, which cause the only noise."""
    replayed([], configuration, seed, LAST, "whole")  # compiles
    counted = {
        what: [_counted(configuration, seed, images, what) for images in (FIRST, LAST)] for what in ("edges", "whole")
    }
    return {what: (last - first) / (LAST - FIRST) / 1e6 for what, (first, last) in counted.items()}


def _counted(configuration: str, seed: int, images: int, what: str) -> int:
    told = replayed(_COUNT, configuration, seed, images, what)
    found = re.search(r"I +refs: +([\d,]+)", told)
    if found is None:
        raise RuntimeError(f"expected a count of instructions, found {told[-300:]!r}")
    return int(found[1].replace(",", ""))


def replayed(around: list[str], configuration: str, seed: int, images: int, what: str) -> str:
    """Return what a process that replays so many images says on standard error."""
    paths = os.pathsep.join([str(ROOT), str(ROOT / "benchmarks")])
    own = {"PYTHONPATH": paths, "PYTHONHASHSEED": str(seed), "LOCALISER_CACHE": str(KEPT / "instructions")}
    words = [*around, sys.executable, __file__, "--replay", configuration, str(images), what]
    environment = os.environ | own | _PLAIN | dict.fromkeys(ONE_THREAD, "1")
    done = subprocess.run(words, env=environment, capture_output=True, text=True, check=False)
    if done.returncode:
        raise RuntimeError(f"{' '.join(words)}: {done.stderr[-2000:]}")
    return done.stderr


def replay(configuration: str, images: int, what: str) -> None:
    """Find the edges of the first images, and locate them if `what` says so.

    It begins with as many particles as are tracked: the start does not count, and valgrind is slow.
    """
    cv2.setNumThreads(1)
    log = open_log(ROOT / "logs" / "corridor")
    settings = ["mcl.start_particles=2000"]
    localiser = Localiser(
        log.landmark_map, log.camera, read_config(CONFIGURATIONS[configuration], settings, log.settings)
    )
    localiser.start(log.start.mean, log.start.cov, log.start.t_ns)
    last_ns = [frame.t_ns for frame in islice(log.frames, images)][-1]
    for event in log.events(anywhere=True):
        if event.t_ns > last_ns:
            break
        if isinstance(event, ImageEvent):
            found = localiser.measure(event.load())
            if what == "whole":
                localiser.edges(event.t_ns, found)
        elif isinstance(event, Odometry) and what == "whole":
            localiser.odometry(event.t_ns, event.pose)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--replay", nargs=3, metavar=("CONFIGURATION", "IMAGES", "WHAT"), help="what is counted")
    parser.add_argument("--seeds", type=int, default=1)
    options = parser.parse_args()
    if options.replay:
        configuration, images, what = options.replay
        replay(configuration, int(images), what)
        return
    print("| configuration | seed | edges, millions | whole, millions |\n|---|---|---|---|")
    for configuration in CONFIGURATIONS:
        for seed in range(options.seeds):
            found = millions(configuration, seed)
            print(f"| {configuration} | {seed} | {found['edges']:.2f} | {found['whole']:.2f} |", flush=True)


if __name__ == "__main__":
    main()
