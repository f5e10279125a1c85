"""Judge all edge detectors on the same images in one run: recall, precision, bearing error, sigma honesty, time.

python benchmarks/edges.py                      simulated images, and the data sets where LOCALISER_DATA has them
python benchmarks/edges.py --scenes hard --count 100 --detector columns
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Iterable
from pathlib import Path

import cv2
import numpy as np
from edge_scenes import DIFFICULTIES, Scene, distance_px, house, rendered, simulated, york_urban
from rich.console import Console
from rich.table import Table

from localiser.camera import Camera
from localiser.edges import DETECTORS, EdgeParameters, Edges, find_edges
from localiser.geometry import Array

NEAR_PX = 2.5
COVERED_SHARE = 0.5
WORLDS = Path(__file__).resolve().parents[1] / "configs" / "worlds"


def covered(ends_px: Array, by_px: Array) -> Array:
    """Return the share (A, B) of each segment (A, 2, 2) that lies within 2.5 px of segments (B, 2, 2)."""
    along = np.linspace(0, 1, 41)[None, :, None]
    points = ends_px[:, :1] * (1 - along) + ends_px[:, 1:] * along
    return distance_px(points, by_px) <= NEAR_PX


class Score:
    """What one detector did on the images of one kind."""

    def __init__(self) -> None:
        self.found = self.counted = self.true = self.reported = 0
        self.error_rad: list[float] = []
        self.normalised: list[float] = []
        self.lean_normalised: list[float] = []
        self.seconds: list[float] = []

    def add(self, scene: Scene, edges: Edges, seconds: float) -> None:
        """Match the edges of one image to the truth."""
        self.seconds.append(seconds)
        truth, measured = undistorted(scene.truth_px, scene.camera), undistorted(edges.ends_px, scene.camera)
        near = covered(truth, measured)
        found = scene.counted & (near.any(axis=2).mean(axis=1) >= COVERED_SHARE)
        self.found, self.counted = self.found + found.sum(), self.counted + scene.counted.sum()
        self.true += (covered(measured, truth).any(axis=2).mean(axis=1) >= COVERED_SHARE).sum()
        self.reported += len(edges)
        bearing, lean = scene.camera.bearing_of_segments(scene.truth_px), scene.camera.lean_of_segments(scene.truth_px)
        for index in np.flatnonzero(found & scene.alone):
            match = int(np.argmax(near[index].mean(axis=0)))
            error = edges.bearing[match] - bearing[index]
            self.error_rad.append(error)
            self.normalised.append(error / edges.bearing_sigma[match])
            self.lean_normalised.append((edges.lean[match] - lean[index]) / edges.lean_sigma[match])

    def row(self) -> list[str]:
        """Return the cells of this detector's row."""
        error = np.rad2deg(self.error_rad)
        return [
            f"{self.found / max(self.counted, 1):.3f}",
            f"{self.counted - self.found}/{self.counted}",
            f"{self.true / max(self.reported, 1):.3f}",
            f"{np.median(np.abs(error)):.4f}",
            f"{np.median(error):+.4f}",
            f"{np.std(self.normalised):.2f} ({robust_std(self.normalised):.2f})",
            f"{np.std(self.lean_normalised):.2f} ({robust_std(self.lean_normalised):.2f})",
            f"{1e3 * np.median(self.seconds):.1f}",
        ]


COLUMNS = ("recall", "missed", "precision", "|error| °", "bias °", "error/σ std (robust)", "lean error/σ", "ms")


def undistorted(ends_px: Array, camera: Camera) -> Array:
    """Return segments (E, 2, 2) where lines are straight."""
    return camera.undistorted().pixels_from_image(camera.image_from_pixels(ends_px))


def robust_std(values: list[float]) -> float:
    return 1.4826 * float(np.median(np.abs(values - np.median(values)))) if values else float("nan")


def judge(scenes: Iterable[Scene], detectors: list[str]) -> dict[str, Score]:
    """Return the score of each detector; what a detector caches for a camera is not part of its time."""
    scores = {name: Score() for name in detectors}
    known: Camera | None = None
    for scene in scenes:
        new, known = scene.camera is not known, scene.camera
        for name in detectors:
            parameters = EdgeParameters(detector=name)
            if new:
                find_edges(scene.image, scene.camera, parameters)
            start = time.perf_counter()
            edges = find_edges(scene.image, scene.camera, parameters)
            scores[name].add(scene, edges, time.perf_counter() - start)
    return scores


def main() -> None:
    options = arguments()
    cv2.setNumThreads(options.threads)
    scenes: dict[str, Iterable[Scene]] = {kind: simulated(kind, options.count, options.seed) for kind in DIFFICULTIES}
    for world in sorted(WORLDS.glob("*.yaml")):
        scenes[world.stem] = rendered(world, options.every)
    if (options.data / "house").is_dir():
        scenes["house"] = house(options.data / "house", options.every)
    if (options.data / "york_urban").is_dir():
        scenes["york_urban"] = york_urban(options.data / "york_urban")
    table = Table("images", "detector", *COLUMNS, title="Vertical edges of at least 60 px")
    for kind in options.scenes or scenes:
        for name, score in judge(scenes[kind], options.detector).items():
            table.add_row(kind, name, *score.row())
        table.add_section()
    Console(width=150).print(table)


def arguments() -> argparse.Namespace:
    default_data = Path(__file__).resolve().parents[2] / "shared" / "data"
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenes", nargs="+", help="kinds of images (default: all that are there)")
    parser.add_argument("--detector", nargs="+", default=sorted(DETECTORS), choices=sorted(DETECTORS))
    parser.add_argument("--count", type=int, default=60, help="simulated images of each class")
    parser.add_argument("--every", type=int, default=10, help="take every n-th image of a drive")
    parser.add_argument("--seed", type=int, default=0, help="of the simulated images")
    parser.add_argument("--threads", type=int, default=1, help="of OpenCV, the same for all detectors")
    parser.add_argument("--data", type=Path, default=Path(os.environ.get("LOCALISER_DATA", default_data)))
    return parser.parse_args()


if __name__ == "__main__":
    main()
