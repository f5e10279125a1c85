"""Hours of tracking on the right map, in simulated buildings: how often does the pose jump to another place?

    python benchmarks/hours.py --hours 2 --seed 100          five kinds of buildings; ten hours take twenty minutes

Each hour is another building, camera and robot. A takeover is false where the pose is wrong after it.
"""

from __future__ import annotations

import argparse
import os
import sys
from pathlib import Path

os.environ.update(dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "NUMBA_NUM_THREADS"), "1"))
sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from board.run import run
from board.worlds import hours_of

KINDS = ("floor", "corridors", "chairs", "shelves", "crowd")


def main() -> None:
    """Print a line for each hour."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--hours", type=int, default=2, help="of each kind of building (default: 2)")
    parser.add_argument("--seed", type=int, default=100, help="of the first building of each kind (default: 100)")
    parser.add_argument("--minutes", type=float, default=60.0, help="of each drive (default: 60)")
    arguments = parser.parse_args()
    columns = "{:<16}{:>8}{:>11}{:>11}{:>13}{:>10}{:>11}{:>7}"
    print(columns.format("building", "images", "right", "sure", "sure, wrong", "warned", "takeovers", "false"))
    for kind in KINDS:
        for seed in range(arguments.seed, arguments.seed + arguments.hours):
            record = run(hours_of(kind, seed, arguments.minutes), seed)
            shares = record.right, record.sure, record.sure & ~record.right, record.warned
            percent = [f"{100 * share.mean():.3f} %" for share in shares]
            counts = int(record.took_over.sum()), int((record.took_over & ~record.right).sum())
            print(columns.format(f"{kind} {seed}", len(record.right), *percent, *counts), flush=True)


if __name__ == "__main__":
    main()
