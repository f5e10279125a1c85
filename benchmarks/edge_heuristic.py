"""The paper's heuristics against the test of verticality, on the same lines; and how surely edges are vertical.

All lines of a general detector (LSD) are judged by

- steepest: none leans further than a vertical edge in a corner of the image would, nor to the other side ([Taylor06]
  section 2.1: the steepest slope; it leans outwards);
- growing: of those, the most (by length) whose lean never falls from left to right, within a pixel at each end: slopes
  lie further and further from vertical the further they are from the centre;
- test: `vertical_segments`, the free slope against the one that the position predicts, each with its sigma.

Recall is of true edges that should be found; precision of lines of which it is known what they are: in simulated images
all, in photographs those that are labelled, as vertical or as another line; in the house, where only landmarks are
known, it is a lower bound.

    python benchmarks/edge_heuristic.py --every 8
"""

from __future__ import annotations

import argparse
import csv
import os
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
from edge_data import house, york_urban
from edge_scenes import DIFFICULTIES, Scene, simulated
from edge_score import COVERED_SHARE, NEAR_PX, distances, undistorted
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table

from localiser import geometry
from localiser.camera import Camera
from localiser.edges import EdgeParameters, find_edges
from localiser.edges.find import grey_image
from localiser.edges.line_detectors import lsd
from localiser.edges.segments import Segments
from localiser.edges.vertical import vertical_segments
from localiser.geometry import Array

Mask = NDArray[np.bool_]
Judge = Callable[[Segments, Camera], Mask]
PARAMETERS = EdgeParameters()
BINS = (0.0, 0.3, 0.5, 0.7, 0.9, 0.97, 1.0)
SLANTED = 20


def steepest_lean(camera: Camera) -> float:
    """Return how far (rad) a vertical edge in a corner of the image leans, the furthest of all."""
    u, v = np.meshgrid([0.0, camera.width - 1], [0.0, camera.height - 1])
    a, e = np.moveaxis(camera.upright_from_pixels(np.stack([u, v], axis=-1)), -1, 0)
    tilt = camera.mount.tilt_rad
    return float(np.abs(geometry.lean_from_bearing(geometry.bearing_of_image_point(a, e, tilt), tilt)).max())


def measured(segments: Segments, camera: Camera) -> tuple[Array, Array, Array]:
    """Return lean (S,) of segments, what a pixel at each end adds to it, and how far right of the centre they are."""
    ideal = camera.undistorted()
    a, e = np.moveaxis(ideal.upright_from_pixels(segments.ends_px), -1, 0)
    length_px = np.hypot(a[:, 1] - a[:, 0], e[:, 1] - e[:, 0]) * camera.focal_px
    return np.arctan2(a[:, 1] - a[:, 0], e[:, 1] - e[:, 0]), 2.0 / length_px, a.mean(axis=1)


def by_steepest(segments: Segments, camera: Camera) -> Mask:
    """Return (S,) which segments lean outwards, and no further than any vertical edge does."""
    lean, pixel, right = measured(segments, camera)
    outwards = lean * np.sign(right) * np.sign(camera.mount.tilt_rad)
    return (outwards >= -pixel) & (outwards <= steepest_lean(camera) + pixel)


def by_growing(segments: Segments, camera: Camera) -> Mask:
    """Return (S,) the longest of what `by_steepest` accepts, in px, whose lean never falls from left to right."""
    lean, pixel, right = measured(segments, camera)
    chosen = np.flatnonzero(by_steepest(segments, camera))
    chosen = chosen[np.argsort(right[chosen], kind="stable")]
    up = lean[chosen] * np.sign(camera.mount.tilt_rad)
    weight = 2.0 / pixel[chosen]
    best, before = weight.copy(), np.full(len(chosen), -1)
    for i in range(len(chosen)):
        can = np.flatnonzero(up[:i] - pixel[chosen[:i]] <= up[i] + pixel[chosen[i]])
        if len(can):
            before[i] = can[np.argmax(best[can])]
            best[i] += best[before[i]]
    keep = np.zeros(len(segments), dtype=bool)
    at = int(np.argmax(best)) if len(best) else -1
    while at >= 0:
        keep[chosen[at]] = True
        at = int(before[at])
    return keep


def by_test(segments: Segments, camera: Camera) -> Mask:
    """Return (S,) which segments meet the nadir point within what noise allows."""
    sigma = PARAMETERS.mount_sigma_rad
    plumb = float(np.deg2rad(PARAMETERS.plumb_sigma_deg))
    return vertical_segments(segments, camera, sigma, plumb, PARAMETERS.gate_sigma)[0]


JUDGES: dict[str, Judge] = {"steepest": by_steepest, "growing": by_growing, "test": by_test}


class Count:
    """What one judge did on the images of one kind."""

    def __init__(self) -> None:
        self.found = self.counted = self.true = self.known = self.accepted = self.images = 0

    def add(self, scene: Scene, others_px: Array | None, accepted: Segments) -> None:
        """Count the lines of one image; others_px: (O, 2, 2) lines that are not vertical, None: all but true ones."""
        truth = undistorted(scene.truth_px, scene.camera)
        is_true = along(accepted.ends_px, truth)
        other = ~is_true if others_px is None else along(accepted.ends_px, others_px) & ~is_true
        far = distances(truth, accepted.ends_px)
        found = scene.counted & ((far <= NEAR_PX).any(axis=2).mean(axis=1) >= COVERED_SHARE * scene.share)
        self.found, self.counted = self.found + int(found.sum()), self.counted + int(scene.counted.sum())
        self.true, self.known = self.true + int(is_true.sum()), self.known + int((is_true | other).sum())
        self.accepted, self.images = self.accepted + len(accepted), self.images + 1

    def cells(self) -> list[str]:
        """Return recall, precision and accepted lines an image."""
        return [
            f"{self.found / max(self.counted, 1):.3f}",
            f"{self.true / max(self.known, 1):.3f}",
            f"{self.accepted / max(self.images, 1):.1f}",
        ]


def along(ends_px: Array, others_px: Array) -> Mask:
    """Return (E,) whether half of a segment or more lies within 2.5 px of any other."""
    if len(ends_px) == 0 or len(others_px) == 0:
        return np.zeros(len(ends_px), dtype=bool)
    return np.asarray((distances(ends_px, others_px) <= NEAR_PX).any(axis=2).mean(axis=1) >= COVERED_SHARE)


def kinds_of(options: argparse.Namespace) -> dict[str, Iterable[tuple[Scene, Array | None]]]:
    """Return scenes of each kind with the lines in them that are not vertical, undistorted; None: all others."""
    kinds: dict[str, Iterable[tuple[Scene, Array | None]]] = {}
    for name, difficulty in DIFFICULTIES.items():
        slanted = replace(difficulty, slanted=SLANTED)
        kinds[name] = ((scene, None) for scene in simulated(slanted, options.count, options.seed))
    if (options.data / "house").is_dir():
        kinds["house"] = ((scene, None) for scene in house(options.data / "house", options.every))
    if (options.data / "york_urban").is_dir():
        kinds["york_urban"] = _labelled(options.data / "york_urban")
    return kinds


def _labelled(folder: Path) -> Iterator[tuple[Scene, Array]]:
    others = defaultdict(list)
    with (folder / "labelled_lines.csv").open() as file:
        for row in csv.DictReader(file):
            if row["is_vertical"] != "1":
                others[row["image"]].append([float(row[key]) for key in ("x1", "y1", "x2", "y2")])
    with (folder / "images.csv").open() as file:
        names = [row["image"] for row in csv.DictReader(file)]
    for name, scene in zip(names, york_urban(folder), strict=True):
        yield scene, undistorted(np.array(others[name]).reshape(-1, 2, 2), scene.camera)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    default_data = Path(__file__).resolve().parents[2] / "shared" / "data"
    parser.add_argument("--scenes", nargs="+", help="kinds of images (default: all that are there)")
    parser.add_argument("--count", type=int, default=30, help="simulated images of each class")
    parser.add_argument("--every", type=int, default=4, help="take every n-th image of the house")
    parser.add_argument("--seed", type=int, default=0, help="of the simulated images")
    parser.add_argument("--data", type=Path, default=Path(os.environ.get("LOCALISER_DATA", default_data)))
    options = parser.parse_args()
    judged = Table("images", "judge", "recall", "precision", "accepted an image")
    sure = Table("images", "edges", "said → is", *(f"{low}–{high}" for low, high in pairwise(BINS)))
    kinds = kinds_of(options)
    for kind in options.scenes or kinds:
        counts = {name: Count() for name in JUDGES}
        said: list[Array] = []
        true: list[Mask] = []
        for scene, others_px in kinds[kind]:
            segments = lsd(grey_image(scene.image, scene.camera), scene.camera)
            long = np.linalg.norm(segments.ends_px[:, 1] - segments.ends_px[:, 0], axis=1) >= PARAMETERS.min_length_px
            segments = segments.take(long)
            for name, judge in JUDGES.items():
                counts[name].add(scene, others_px, segments.take(judge(segments, scene.camera)))
            edges = find_edges(scene.image, scene.camera, PARAMETERS, with_probabilities=True)
            ends = undistorted(edges.ends_px, scene.camera)
            is_true = along(ends, undistorted(scene.truth_px, scene.camera))
            known = is_true | (True if others_px is None else along(ends, others_px))
            said.append(edges.vertical_probability[known])
            true.append(is_true[known])
        for name, count in counts.items():
            judged.add_row(kind, name, *count.cells())
        judged.add_section()
        sure.add_row(kind, *said_and_is(np.concatenate(said), np.concatenate(true)))
    console = Console(width=150)
    console.print(judged)
    console.print(sure)


def said_and_is(said: Array, true: Mask) -> list[str]:
    """Return the number of edges, then the mean probability and the share of true ones, in all and in each bin."""
    cells = [str(len(said)), f"{said.mean():.2f} → {true.mean():.2f}"]
    for low, high in pairwise(BINS):
        inside = (said >= low) & ((said < high) | (high == 1.0))
        share = f"{said[inside].mean():.2f} → {true[inside].mean():.2f}" if inside.any() else "–"
        cells.append(f"{share} ({inside.sum()})")
    return cells


if __name__ == "__main__":
    main()
