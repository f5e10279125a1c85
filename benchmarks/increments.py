"""How well two images tell how the robot moved: rotation and translation errors over rendered pairs, sigma honesty.

    python benchmarks/increments.py [--pairs 200] [--seed 7]

Half of the pairs are seen in each of the two worlds that ship. A third of them only drives, a third only turns, the
rest goes along an arc. Nothing is known of the motion but that 0.2 s passed. Beside these pairs come half as many of a
robot that sidles besides, by 20 mm (1 sigma), as one that steers does not. A figure of honesty is the
standard deviation of error over sigma (1 is honest), and the mean and median of eᵀ C⁻¹ e (3 and 2.4 for three honest
Gaussians).
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from itertools import chain
from pathlib import Path

import numpy as np
import yaml

from localiser import geometry
from localiser.edges import EdgeParameters, find_edges
from localiser.geometry import Array, Increment
from localiser.simulate import Scene, render, scene_of, truth_of, world_of
from localiser.simulate.solids import clearance_m
from localiser.visual_odometry import Odometer, VisualOdometryParameters

WORLDS = Path(__file__).resolve().parent.parent / "configs" / "worlds"
SECONDS = 0.2
STEERED = ("drive", "turn", "arc")


def motion_of(kind: str, rng: np.random.Generator) -> Array:
    """Return a motion (3,) of this kind, as a robot makes one in a fifth of a second."""
    forward, turn = rng.uniform(-0.05, 0.15), np.radians(rng.uniform(-12.0, 12.0))
    if kind == "drive":
        return np.array([0.0, -forward, 0.0])
    if kind == "turn":
        return np.array([0.0, 0.0, turn])
    sideways = rng.normal(0.0, 0.02) if kind == "sidle" else 0.0
    return geometry.arc_motion(np.array([sideways, -forward]), turn, 1.0)


def is_clear(scene: Scene, poses: Array) -> bool:
    """Whether robot and camera stand clear of everything."""
    height_m = scene.camera.mount.height_m
    points = np.concatenate([poses, scene.camera.pose_in_map(poses)])[:, :2]
    return bool(clearance_m(scene.structure.solids, points, height_m).min() > 0.15)


def followed_pairs(
    scene: Scene, kinds: Sequence[str], count: int, rng: np.random.Generator
) -> Iterator[tuple[str, Array, Increment]]:
    """Yield kind, true motion (3,) and what was found, for pairs of images taken beside the world's drive."""
    path = truth_of(scene.world.drive).poses
    vision, unknown = (
        Odometer(scene.camera, VisualOdometryParameters(source="vision")),
        Increment.from_mean(np.zeros(3)),
    )
    done = 0
    while done < count:
        kind = kinds[done % len(kinds)]
        first = path[rng.integers(len(path))] + rng.normal(0.0, [0.1, 0.1, 0.3])
        motion = motion_of(kind, rng)
        poses = np.stack([first, geometry.compose(first, motion)])
        if not is_clear(scene, poses):
            continue
        frames = [find_edges(render(scene, pose, rng), scene.camera, EdgeParameters()) for pose in poses]
        found, _ = vision.increment(unknown, np.eye(3), frames[0], frames[1], SECONDS)
        yield kind, motion, found
        done += 1


def row(name: str, errors: Array, covs: Array) -> str:
    """Return one line of the table for errors (P, 3) with covariances (P, 3, 3)."""
    turn = np.degrees(np.abs(errors[:, 2]))
    way = 1e3 * np.hypot(errors[:, 0], errors[:, 1])
    honest = (errors / np.sqrt(np.diagonal(covs, axis1=1, axis2=2))).std(axis=0)
    nees = np.einsum("pi,pi->p", errors, np.linalg.solve(covs, errors[..., None])[..., 0])
    figures = [*np.percentile(turn, [50, 95]), *np.percentile(way, [50, 95]), *honest, nees.mean(), np.median(nees)]
    return f"| {name:9s} | {len(errors):5d} | " + " | ".join(f"{figure:8.3f}" for figure in figures) + " |"


def main() -> None:
    """Print the table."""
    arguments = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    arguments.add_argument("--pairs", type=int, default=200)
    arguments.add_argument("--seed", type=int, default=7)
    chosen = arguments.parse_args()
    rng = np.random.default_rng(chosen.seed)
    found: list[tuple[str, str, Array, Array]] = []
    for world in ("corridor", "office"):
        scene = scene_of(world_of(yaml.safe_load((WORLDS / f"{world}.yaml").read_text())))
        steered = followed_pairs(scene, STEERED, chosen.pairs // 2, rng)
        sidled = followed_pairs(scene, ("sidle",), chosen.pairs // 4, rng)
        for kind, motion, increment in chain(steered, sidled):
            error = increment.mean - motion
            error[2] = geometry.wrap_angle(error[2])
            found.append((world if kind in STEERED else "", kind, error, increment.cov))
    heads = ["turn 50 %°", "95 %°", "way 50 % mm", "95 % mm", "z right", "z back", "z turn", "NEES", "median"]
    print("| pairs     |     n | " + " | ".join(heads) + " |")
    print("|---" * (len(heads) + 2) + "|")
    for name in ("corridor", "office", *STEERED, "all", "sidle"):
        chosen_rows = [entry for entry in found if name in (entry[0], entry[1]) or (name == "all" and entry[0])]
        print(row(name, np.array([entry[2] for entry in chosen_rows]), np.array([entry[3] for entry in chosen_rows])))


if __name__ == "__main__":
    main()
