"""Digests of what the program writes, compared with those of a baseline that is committed: has any byte changed?

python benchmarks/baseline.py --check                    two minutes; ends with 1 when a digest differs
python benchmarks/baseline.py --check --only corridor    the cases whose names begin so
python benchmarks/baseline.py --write                    after a change that changes bytes on purpose

Logs are cut short. Data that do not ship are found through LOCALISER_DATA; cases that need them are skipped where they
are absent, and the summary says so. Bytes can only be equal on the same processor with the same libraries: elsewhere a
digest that differs is told, but is no loss.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import platform
import sys
from collections.abc import Callable, Mapping
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import partial
from importlib.metadata import version
from multiprocessing import get_context
from pathlib import Path
from tempfile import TemporaryDirectory

import short_logs
from program import ROOT, begin_process, prepare_environment, run
from short_logs import CORRIDOR

FILE = Path(__file__).with_name("baseline.json")
FORMAT = "localiser-baseline/2"
LIBRARIES = ("numpy", "scipy", "numba", "opencv-python-headless", "filterpy")
MRCLAM_SECONDS = 240.0
Source = Callable[[Path], Path | str]
"""Makes the log in a folder that does not exist yet, and returns what the program is to open."""


@dataclass(frozen=True, slots=True)
class Case:
    """Something that the program writes. digest: returns its digest, in any process. needs: data without which not."""

    digest: Callable[[], str]
    needs: Path | None = None


def cases_of(data: Path) -> dict[str, Case]:
    """Return all cases by name. data: folder of the logs that do not ship."""
    house = partial(short_logs.first_images, data / "house", count=120)
    shop = partial(short_logs.first_images, data / "bookstore", count=60)
    robots = {robot: partial(mrclam, data / "mrclam", robot) for robot in (1, 2, 3)}
    truth, slope, known = ("--start", "truth"), ("--observation", "slope"), ("--set", "observation.association=known")
    replays: dict[str, tuple[Source, tuple[str, ...], Path | None]] = {
        "corridor line seed 0": (whole, (), None),
        "corridor line seed 1": (whole, ("--seed", "1"), None),
        "corridor slope": (whole, slope, None),
        "corridor vision": (shown(60), ("--odometry", "vision"), None),
        "corridor lsd": (shown(40), ("--set", "edges.detector=lsd"), None),
        "posts known line": (short_logs.posts, known, None),
        "posts known slope": (short_logs.posts, (*known, *slope), None),
        "posts unknown line": (short_logs.posts, (), None),
        "house line": (house, truth, data / "house"),
        "house slope": (house, (*truth, *slope), data / "house"),
        "house global line": (house, ("--start", "global"), data / "house"),
        "bookstore line": (shop, truth, data / "bookstore"),
        **{f"mrclam {robot} line": (source, truth, data / "mrclam") for robot, source in robots.items()},
        "mrclam 1 known line": (robots[1], (*truth, *known), data / "mrclam"),
    }
    maps: dict[str, tuple[Source, str, Path | None]] = {
        "map truth": (whole, "truth", None),
        "map slam": (whole, "slam", None),
        "map odometry": (shown(60), "odometry", None),
        "map mrclam truth": (robots[1], "truth", data / "mrclam"),
    }
    return {
        **{name: Case(partial(trajectory, log, options), needs) for name, (log, options, needs) in replays.items()},
        **{name: Case(partial(landmark_map, log, poses), needs) for name, (log, poses, needs) in maps.items()},
        "simulated log": Case(simulated),
        "detectors": Case(detectors),
    }


def whole(folder: Path) -> Path:
    """Return the log that ships, as it is."""
    return CORRIDOR


def shown(count: int) -> Source:
    """Return what makes a log of the first images of the log that ships."""
    return partial(short_logs.first_images, CORRIDOR, count=count)


def mrclam(source: Path, robot: int, folder: Path) -> str:
    """Return the first minutes of a robot of MRCLAM."""
    return f"{short_logs.first_seconds(source, folder, robot, MRCLAM_SECONDS)}:{robot}"


def trajectory(source: Source, options: tuple[str, ...]) -> str:
    """Return the digest of trajectory.csv."""
    with TemporaryDirectory() as name:
        folder = Path(name)
        log, out = source(folder / "log"), folder / "out"
        options = options if "--seed" in options else (*options, "--seed", "0")
        run("replay", log, "--quiet", "--no-rrd", "--out", out, *options, cache=folder / "cache")
        (written,) = out.glob("*/1/trajectory.csv")
        return digest_of(written)


def landmark_map(source: Source, poses: str) -> str:
    """Return the digest of a map that is built."""
    with TemporaryDirectory() as name:
        folder = Path(name)
        log, built = source(folder / "log"), folder / "map.yaml"
        run("map", "build", log, "--poses", poses, "-o", built, "--quiet", cache=folder / "cache")
        return digest_of(built)


def simulated() -> str:
    """Return the digest of a short simulated log, with all its files."""
    with TemporaryDirectory() as name:
        folder = Path(name)
        short = folder / "short.yaml"
        short.write_text(short_logs.short_world(), encoding="utf-8")
        run("simulate", short, "-o", folder / "log", "--quiet", cache=folder / "cache")
        return digest_of(*sorted(path for path in (folder / "log").rglob("*") if path.is_file()))


def detectors() -> str:
    """Return the digest of the edges that each detector finds in some images."""
    with TemporaryDirectory() as name:
        folder = Path(name)
        log = short_logs.first_images(CORRIDOR, folder / "log", 8)
        for detector in ("columns", "lsd", "hough"):
            options = ("--detector", detector, "--no-pictures", "--quiet", "--out", folder / detector)
            run("edges", log, *options, cache=folder / "cache")
        return digest_of(*sorted(folder.glob("*/edges.csv")))


def digest_of(*paths: Path) -> str:
    """Return the digest of files, by name and content."""
    digest = hashlib.sha256()
    for path in paths:
        digest.update(path.name.encode() + b"\0" + path.read_bytes())
    return digest.hexdigest()


def measured(cases: Mapping[str, Case], jobs: int) -> dict[str, str]:
    """Return the digest of every case, or what went wrong, of as many processes as `jobs`."""
    prepare_environment()
    found = {}
    with ProcessPoolExecutor(jobs, mp_context=get_context("spawn"), initializer=begin_process) as pool:
        for name, waiting in {name: pool.submit(case.digest) for name, case in cases.items()}.items():
            error = waiting.exception()
            found[name] = f"{type(error).__name__}: {error}" if error else waiting.result()
    return found


def machine() -> dict[str, str]:
    """Return what bytes depend on beside the source: processor and libraries."""
    import llvmlite.binding

    processor = f"{platform.machine()} {llvmlite.binding.get_host_cpu_name()}"
    libraries = {name: version(name) for name in LIBRARIES}
    return {"processor": processor, "python": platform.python_version(), **libraries}


def differing(before: Mapping[str, str], now: Mapping[str, str], asked: Mapping[str, Case]) -> list[str]:
    """Return a line for each case that was asked for and is not as before."""
    lines = []
    for name, case in asked.items():
        if case.needs is not None and not case.needs.exists():
            continue
        if now.get(name) != before.get(name):
            lines.append(f"{name}: expected {before.get(name, 'nothing')}, found {now.get(name, 'nothing')}")
    return lines + [f"{name}: no longer measured" for name in before if name not in asked]


def main() -> int:
    """Check or write; return the exit code."""
    options = arguments()
    cases = cases_of(options.data)
    asked = {name: case for name, case in cases.items() if name.startswith(tuple(options.only.split(",")))}
    if not asked:
        raise SystemExit(f"--only: expected the beginning of one of {', '.join(cases)}; found {options.only}")
    there = {name: case for name, case in asked.items() if case.needs is None or case.needs.exists()}
    kept = json.loads(FILE.read_text(encoding="utf-8"))
    if options.write:
        digests = kept["digests"] | measured(there, options.jobs)
        content = {"format": FORMAT, "machine": machine(), "digests": {name: digests[name] for name in cases}}
        FILE.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
        print(f"{len(there)} digests written to {FILE.relative_to(ROOT)}")
        return 0
    before = {name: digest for name, digest in kept["digests"].items() if name in asked or name not in cases}
    lines = differing(before, measured(there, options.jobs), asked)
    elsewhere = kept["machine"] != machine()
    print("\n".join(lines + ["another processor, or other libraries: digests may differ"] * elsewhere))
    print(f"{len(lines)} digests differ, {len(there) - len(lines)} do not, {len(asked) - len(there)} have no data here")
    return int(bool(lines) and not elsewhere)


def arguments() -> argparse.Namespace:
    """Return what was asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    what = parser.add_mutually_exclusive_group(required=True)
    what.add_argument("--check", action="store_true", help="compare with the baseline")
    what.add_argument("--write", action="store_true", help="make the baseline")
    parser.add_argument("--only", metavar="NAME[,NAME]", default="", help="cases whose names begin so (default: all)")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1, help="processes (default: one a core)")
    default_data = ROOT.parent / "shared" / "data"
    parser.add_argument("--data", type=Path, default=Path(os.environ.get("LOCALISER_DATA", default_data)))
    return parser.parse_args()


if __name__ == "__main__":
    sys.exit(main())
