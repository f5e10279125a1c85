"""Judge all edge detectors on the same images in one run: recall, precision, bearing error, sigma honesty, time.

python benchmarks/edges.py                      simulated images, and the data sets where LOCALISER_DATA has them
python benchmarks/edges.py --scenes hard --count 100 --detector columns lsd
python benchmarks/edges.py --sweep --count 20   sizes, tilts, lenses, blur, noise, exposure, one at a time
python benchmarks/edges.py --light --detector columns     darker, brighter, noisier, blurred, one at a time
python benchmarks/edges.py --reference ENV      EdgeDrawing as well, by opencv-contrib in an environment at ENV
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
from edge_drawing import EdgeDrawing
from edge_light import LIGHTS, photographed, rendered_anew
from edge_mount import MountScore
from edge_scenes import DIFFICULTIES, SWEEP, Difficulty, Scene, simulated
from edge_score import Score, robust_std
from rich.console import Console
from rich.table import Table

from localiser.camera import Camera
from localiser.edges import DETECTORS, EdgeParameters, find_edges
from localiser.edges.line_detectors import LSD_SIGMA_PX, on_ideal_image

WORLDS = Path(__file__).resolve().parents[1] / "configs" / "worlds"
REFERENCE = "EdgeDrawing"
RAW_LSD = "lsd-raw"
"""LSD as OpenCV returns it, offset and all; only when asked for."""
COLUMNS = ("recall", "missed", "precision", "|error| °", "bias °", "error/σ std (robust)", "lean error/σ")


def judge(scenes: Iterable[Scene], detectors: list[str], threads: list[int], reference: EdgeDrawing | None) -> dict:
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
                scores[name].seconds.setdefault(count, []).append(_seconds(search, count, reference))
            scores[name].add(scene, search())
    return scores


def _seconds(search: partial, threads: int, reference: EdgeDrawing | None) -> float:
    """Return the time of one search, without what it takes to ask another process."""
    cv2.setNumThreads(threads)
    if reference is not None:
        reference.threads, reference.overhead_s = threads, 0.0
    start = time.perf_counter()
    search()
    seconds = time.perf_counter() - start
    return seconds - (reference.overhead_s if reference is not None else 0.0)


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
    if options.sweep:
        return {kind: simulated(difficulty, options.count, options.seed) for kind, difficulty in SWEEP.items()}
    if options.light:
        return light_scenes_of(options)
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


def light_scenes_of(options: argparse.Namespace) -> dict[str, Iterable[Scene]]:
    """Return simulated images and those of the house in each light; counted is what a matched filter finds."""
    quiet = Difficulty(noise_sigma=1.0)
    kinds: dict[str, Iterable[Scene]] = {
        f"simulated, {name}": rendered_anew(quiet, light, options.count, options.seed) for name, light in LIGHTS.items()
    }
    if (folder := options.data / "house").is_dir():
        for name, light in LIGHTS.items():
            kinds[f"house, {name}"] = photographed(house(folder, options.every), light, options.seed)
    return kinds


def _raw_lsd_lines(image: np.ndarray) -> np.ndarray:
    found = cv2.createLineSegmentDetector().detect(image)[0]
    return np.zeros((0, 4)) if found is None else found.reshape(-1, 4).astype(np.float64)


def main() -> None:
    options = arguments()
    reference = EdgeDrawing(options.reference) if options.reference else None
    detectors = list(options.detector)
    DETECTORS[RAW_LSD] = lambda image, camera, _: on_ideal_image(image, camera, _raw_lsd_lines, LSD_SIGMA_PX)
    if reference:
        DETECTORS[REFERENCE] = lambda image, camera, _: on_ideal_image(image, camera, reference.lines, 0.35)
        detectors.append(REFERENCE)
    timed = [cell for count in options.threads for cell in (f"ms, {count} thread{'s'[: count > 1]}", "/ LSD")]
    table = Table("images", "detector", *COLUMNS, *timed, title="Vertical edges of at least 60 px")
    kinds = scenes_of(options)
    if missing := set(options.scenes or []) - set(kinds):
        raise SystemExit(f"--scenes: {', '.join(sorted(missing))}: not in LOCALISER_DATA; here are {', '.join(kinds)}")
    for kind in options.scenes or kinds:
        scores = judge(kinds[kind], detectors, options.threads, reference)
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
    parser.add_argument("--sweep", action="store_true", help="simulated images with one thing changed at a time")
    parser.add_argument("--light", action="store_true", help="images in other light; counted are edges of SNR ≥ 8")
    parser.add_argument("--detector", nargs="+", default=sorted(DETECTORS), choices=[*sorted(DETECTORS), RAW_LSD])
    parser.add_argument("--reference", type=Path, help="environment with opencv-contrib; made when there is none")
    parser.add_argument("--count", type=int, default=60, help="simulated images of each class")
    parser.add_argument("--every", type=int, default=1, help="take every n-th image of a drive")
    parser.add_argument("--seed", type=int, default=0, help="of the simulated images")
    parser.add_argument("--threads", type=int, nargs="+", default=[1, 2], help="of OpenCV, the same for all detectors")
    parser.add_argument("--data", type=Path, default=Path(os.environ.get("LOCALISER_DATA", default_data)))
    return parser.parse_args()


if __name__ == "__main__":
    main()
