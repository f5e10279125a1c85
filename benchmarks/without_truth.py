"""A log replayed with and without its truth: every figure that both runs know must be the same.

    python benchmarks/without_truth.py ../shared/data/house --start 3.1,-0.9,96.1

Both runs begin at the same stated start. The log without truth is the same folder without its line `groundtruth:`.
Prints the figures that differ, those that only the truth tells, and where the two reports are; ends with 1 when a
figure differs. The fingerprint `inputs` differs rightly, because the truth is a part of the log.
"""

from __future__ import annotations

import argparse
import json
import shutil
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from localiser.evaluate import flat_figures, is_time
from localiser.storage import find_run

ROOT = Path(__file__).resolve().parent.parent
OF_THE_TRUTH = {"inputs"}


def replayed(log: Path, out: Path, start: str, seed: int) -> dict[str, Any]:
    """Return the figures of a run, by their names, and say where its report is."""
    command = [sys.executable, "-m", "localiser", "replay", str(log), "--start", start, "--seed", str(seed)]
    subprocess.run([*command, "--no-rrd", "--quiet", "--out", str(out)], check=True, cwd=ROOT)
    (runs,) = out.iterdir()
    folder = find_run(runs)
    print(f"{folder / 'report.html'}", flush=True)
    return flat_figures(json.loads((folder / "metrics.json").read_text(encoding="utf-8")))


def without_truth(log: Path, folder: Path) -> Path:
    """Copy a log folder without its truth."""
    shutil.copytree(log, folder, ignore=shutil.ignore_patterns("groundtruth*", "edges_exact*", "visible*"))
    lines = (folder / "log.yaml").read_text(encoding="utf-8").splitlines(keepends=True)
    kept = (line for line in lines if not line.startswith("groundtruth:"))
    (folder / "log.yaml").write_text("".join(kept), encoding="utf-8")
    return folder


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("log", type=Path, help="log folder with truth")
    parser.add_argument("--start", required=True, help="x,z,heading_deg of both runs")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, default=Path("results/without_truth"))
    options = parser.parse_args()
    out = options.out.absolute()
    known = replayed(options.log.absolute(), out / "known", options.start, options.seed)
    with TemporaryDirectory() as name:
        log = without_truth(options.log, Path(name) / options.log.name)
        unknown = replayed(log, out / "unknown", options.start, options.seed)
    told = {name for name, value in unknown.items() if value is not None and not is_time(name)}
    differ = {name for name in told - OF_THE_TRUTH if known.get(name) != unknown[name]}
    print(f"{len(told)} figures without truth, of which {len(differ)} differ")
    for name in sorted(differ):
        print(f"  {name}: {known.get(name)} with truth, {unknown[name]} without")
    more = sorted(name for name, value in known.items() if value is not None and name not in told and not is_time(name))
    print(f"Only with truth: {', '.join(more)}")
    raise SystemExit(bool(differ))


if __name__ == "__main__":
    main()
