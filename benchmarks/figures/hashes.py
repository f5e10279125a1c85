"""Digests of what the program writes, per log, observation and seed: equal as long as no byte of it has changed.

Logs are cut short, so that all of it takes two minutes.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

from figures import inputs
from figures.inputs import CORRIDOR
from figures.measures import Measure
from figures.program import run
from figures.tasks import Task, Values

Source = Callable[[Path], Path | str]
"""Makes the log in a folder that does not exist yet, and returns what the program is to open."""
MRCLAM_SECONDS = 240.0
MEASURES = {name: Measure("change") for name in ("trajectory", "map", "files", "edges")}


def tasks(data: Path) -> list[Task]:
    """Return what is measured. data: folder of the logs that do not ship."""
    alone = [Task("hashes", "simulated log", 0, simulated), Task("hashes", "detectors", 0, detectors)]
    return [*_replays(data), *_maps(data), *alone]


def _replays(data: Path) -> list[Task]:
    house = partial(inputs.first_images, data / "house")
    shop = partial(inputs.first_images, data / "bookstore")
    shown = partial(inputs.first_images, CORRIDOR)
    truth, slope, known = ("--start", "truth"), ("--observation", "slope"), ("--set", "observation.association=known")
    cases: list[tuple[str, tuple[int, ...], Source, tuple[str, ...], Path | None]] = [
        ("corridor line", (0, 1), whole, (), None),
        ("corridor slope", (0,), whole, slope, None),
        ("corridor vision", (0,), partial(shown, count=60), ("--odometry", "vision"), None),
        ("corridor both", (0,), partial(shown, count=60), ("--odometry", "both"), None),
        ("corridor lsd", (0,), partial(shown, count=40), ("--set", "edges.detector=lsd"), None),
        ("posts known line", (0,), inputs.posts, known, None),
        ("posts known slope", (0,), inputs.posts, (*known, *slope), None),
        ("posts unknown line", (0,), inputs.posts, (), None),
        ("house line", (0,), partial(house, count=120), truth, data / "house"),
        ("house slope", (0,), partial(house, count=120), (*truth, *slope), data / "house"),
        ("house global line", (0,), partial(house, count=120), ("--start", "global"), data / "house"),
        ("bookstore line", (0,), partial(shop, count=60), truth, data / "bookstore"),
    ]
    for robot in (1, 2, 3):
        cases.append((f"mrclam {robot} line", (0,), partial(mrclam, data / "mrclam", robot), truth, data / "mrclam"))
    cases.append(("mrclam 1 known line", (0,), partial(mrclam, data / "mrclam", 1), (*truth, *known), data / "mrclam"))
    return [
        Task("hashes", f"{case} seed {seed}", 0, partial(trajectory, source, (*options, "--seed", str(seed))), needs)
        for case, seeds, source, options, needs in cases
        for seed in seeds
    ]


def _maps(data: Path) -> list[Task]:
    built = {
        "map truth": (whole, "truth", None),
        "map slam": (whole, "slam", None),
        "map odometry": (partial(inputs.first_images, CORRIDOR, count=60), "odometry", None),
        "map mrclam truth": (partial(mrclam, data / "mrclam", 1), "truth", data / "mrclam"),
    }
    return [
        Task("hashes", case, 0, partial(landmark_map, source, poses), needs)
        for case, (source, poses, needs) in built.items()
    ]


def whole(folder: Path) -> Path:
    """Return the log that ships, as it is."""
    return CORRIDOR


def mrclam(source: Path, robot: int, folder: Path) -> str:
    """Return the first minutes of a robot of MRCLAM."""
    return f"{inputs.first_seconds(source, folder, robot, MRCLAM_SECONDS)}:{robot}"


# -- work -------------------------------------------------------------------------------------------------------------


def trajectory(source: Source, options: tuple[str, ...]) -> Values:
    """Return the digest of trajectory.csv."""
    with TemporaryDirectory() as name:
        folder = Path(name)
        log, out = source(folder / "log"), folder / "out"
        run("replay", log, "--quiet", "--no-rrd", "--out", out, *options, cache=folder / "cache")
        (written,) = out.glob("*/1/trajectory.csv")
        return {"trajectory": _digest(written)}


def landmark_map(source: Source, poses: str) -> Values:
    """Return the digest of a map that is built."""
    with TemporaryDirectory() as name:
        folder = Path(name)
        log, built = source(folder / "log"), folder / "map.yaml"
        run("map", "build", log, "--poses", poses, "-o", built, "--quiet", cache=folder / "cache")
        return {"map": _digest(built)}


def simulated() -> Values:
    """Return the digest of a short simulated log, with all its files."""
    with TemporaryDirectory() as name:
        folder = Path(name)
        short = folder / "short.yaml"
        short.write_text(inputs.short_world(), encoding="utf-8")
        run("simulate", short, "-o", folder / "log", "--quiet", cache=folder / "cache")
        return {"files": _digest(*sorted(path for path in (folder / "log").rglob("*") if path.is_file()))}


def detectors() -> Values:
    """Return the digest of the edges that each detector finds in some images."""
    with TemporaryDirectory() as name:
        folder = Path(name)
        log = inputs.first_images(CORRIDOR, folder / "log", 8)
        for detector in ("columns", "lsd", "hough"):
            options = ("--detector", detector, "--no-pictures", "--quiet", "--out", folder / detector)
            run("edges", log, *options, cache=folder / "cache")
        return {"edges": _digest(*sorted(folder.glob("*/edges.csv")))}


def _digest(*paths: Path) -> str:
    digest = hashlib.sha256()
    for path in paths:
        digest.update(path.name.encode() + b"\0" + path.read_bytes())
    return digest.hexdigest()
