"""Judge all edge detectors on the same images in one run: recall, precision, bearing error, sigma honesty, time.

python benchmarks/edges.py                      simulated images, and the data sets where LOCALISER_DATA has them
python benchmarks/edges.py --scenes hard --count 100 --detector columns lsd
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Iterable
from functools import partial
from pathlib import Path

import cv2
import numpy as np
from edge_data import house, rendered, york_urban
from edge_scenes import DIFFICULTIES, Scene, simulated
from edge_score import MountScore, Score, robust_std
from rich.console import Console
from rich.table import Table

from localiser.camera import Camera
from localiser.edges import DETECTORS, EdgeParameters, find_edges

WORLDS = Path(__file__).resolve().parents[1] / "configs" / "worlds"
COLUMNS = ("recall", "missed", "precision", "|error| °", "bias °", "error/σ std (robust)", "lean error/σ")


def judge(scenes: Iterable[Scene], detectors: list[str], threads: list[int]) -> dict[str, Score]:
    """Return the score of each detector; what a detector caches for a camera is not part of its time."""
    scores = {name: Score() for name in detectors}
    known: Camera | None = None
    for scene in scenes:
        new, known = scene.camera is not known, scene.camera
        for name in detectors:
            parameters = EdgeParameters(detector=name)  # type: ignore[arg-type]
            search = partial(find_edges, scene.image, scene.camera, parameters)
            if new:
                search()
            for count in threads:
                scores[name].seconds.setdefault(count, []).append(_seconds(search, count))
            scores[name].add(scene, search())
    return scores


def _seconds(search: partial, threads: int) -> float:
    """Return the time of one search."""
    cv2.setNumThreads(threads)
    start = time.perf_counter()
    search()
    return time.perf_counter() - start


def cells(score: Score, lsd: Score | None, threads: list[int]) -> list[str]:
    """Return the cells of a detector's row."""
    times = [f"{score.milliseconds(count):.1f}" for count in threads]
    ratios = [f"{score.time_over(lsd, count):.2f}" if lsd else "" for count in threads]
    return [
        f"{score.recall:.3f}",
        f"{score.missed}/{score.counted}",
        f"{score.precision:.3f}",
        f"{score.median_error_deg:.4f}",
        f"{score.bias_deg:+.4f}",
        f"{np.std(score.normalised):.2f} ({robust_std(score.normalised):.2f})",
        f"{np.std(score.lean_normalised):.2f} ({robust_std(score.lean_normalised):.2f})",
        *[cell for pair in zip(times, ratios, strict=True) for cell in pair],
    ]


def scenes_of(options: argparse.Namespace) -> dict[str, Iterable[Scene]]:
    """Return all kinds of images that are there, each as an iterator that makes them when asked."""
    kinds: dict[str, Iterable[Scene]] = {
        kind: simulated(difficulty, options.count, options.seed) for kind, difficulty in DIFFICULTIES.items()
    }
    for world in sorted(WORLDS.glob("*.yaml")):
        kinds[world.stem] = rendered(world, options.every)
    if (options.data / "house").is_dir():
        kinds["house"] = house(options.data / "house", options.every)
    if (options.data / "york_urban").is_dir():
        kinds["york_urban"] = york_urban(options.data / "york_urban")
    return kinds


def main() -> None:
    options = arguments()
    timed = [cell for count in options.threads for cell in (f"ms, {count} thread{'s'[: count > 1]}", "/ LSD")]
    table = Table("images", "detector", *COLUMNS, *timed, title="Vertical edges of at least 60 px")
    kinds = scenes_of(options)
    if missing := set(options.scenes or []) - set(kinds):
        raise SystemExit(f"--scenes: {', '.join(sorted(missing))}: not in LOCALISER_DATA; here are {', '.join(kinds)}")
    for kind in options.scenes or kinds:
        scores = judge(kinds[kind], list(options.detector), options.threads)
        for name, score in scores.items():
            table.add_row(kind, name, *cells(score, scores.get("lsd"), options.threads))
        table.add_section()
    console = Console(width=170)
    console.print(table)
    if "york_urban" in (options.scenes or kinds):
        console.print(MountScore.of(york_urban(options.data / "york_urban")).text())


def arguments() -> argparse.Namespace:
    default_data = Path(__file__).resolve().parents[2] / "shared" / "data"
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenes", nargs="+", help="kinds of images (default: all that are there)")
    parser.add_argument("--detector", nargs="+", default=sorted(DETECTORS), choices=sorted(DETECTORS))
    parser.add_argument("--count", type=int, default=60, help="simulated images of each class")
    parser.add_argument("--every", type=int, default=1, help="take every n-th image of a drive")
    parser.add_argument("--seed", type=int, default=0, help="of the simulated images")
    parser.add_argument("--threads", type=int, nargs="+", default=[1, 2], help="of OpenCV, the same for all detectors")
    parser.add_argument("--data", type=Path, default=Path(os.environ.get("LOCALISER_DATA", default_data)))
    return parser.parse_args()


if __name__ == "__main__":
    main()
