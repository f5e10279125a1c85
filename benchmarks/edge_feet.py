"""How often lower ends of edges stand on the floor when that is said to be so likely, and their range's sigma.

python benchmarks/edge_feet.py          the worlds that ship, and the rendered house where LOCALISER_DATA has it
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
import yaml
from edge_data import house_views
from rich.console import Console
from rich.table import Table

from localiser.camera import Camera
from localiser.edges import Edges, find_edges
from localiser.edges.foot import FOOT_SIGMA_PX
from localiser.geometry import Array, robot_from_map
from localiser.simulate import simulated_log, world_of
from localiser.simulate.raycast import cast
from localiser.simulate.solids import Solids

WORLDS = Path(__file__).resolve().parents[1] / "configs" / "worlds"
BINS = (0.0, 0.1, 0.3, 0.5, 0.7, 0.9, 1.0)
STANDS_PX = 3.0 * FOOT_SIGMA_PX
_ABOVE_END_PX = (6.0, 10.0, 14.0)
_BESIDE_PX = (-1.5, 1.5)


@dataclass(frozen=True, slots=True, eq=False)
class Feet:
    """Lower ends, F of them: probability (F,), and by how many pixels each lies below the foot of its surface (F,)."""

    probability: Array
    below_px: Array

    @property
    def stands(self) -> Array:
        """Whether each (F,) is the foot, within three sigmas; what is on no upright surface is none."""
        return np.abs(np.nan_to_num(self.below_px, nan=np.inf)) < STANDS_PX


def simulated_feet(world_file: Path, seed: int, every: int) -> Iterator[Feet]:
    """Yield the lower ends in images of a drive, against the surface that is hit just above each."""
    log = simulated_log(world_of(yaml.safe_load(world_file.read_text())), seed=seed)
    poses = log.drive.truth.sampled(log.drive.image_t_ns).poses
    for index in range(0, len(log), every):
        edges = _seen(find_edges(log.image(index), log.camera, with_probabilities=True))
        if len(edges):
            pose = log.camera.pose_in_map(poses[index])
            yield Feet(edges.foot_probability, _below_foot_px(edges, log.camera, pose, log.scene.structure.solids))


def house_feet(folder: Path, every: int) -> Iterator[Feet]:
    """Yield the lower ends in a rendered log, of edges at the bearing of a landmark: of others nothing is known."""
    for view in house_views(folder, every):
        edges = _seen(find_edges(view.image, view.camera, with_probabilities=True))
        right, back = robot_from_map(view.camera.pose_in_map(view.pose), view.points).T
        bearing = np.arctan2(right, -back)
        foot_px = view.camera.project_level(
            np.stack([right, np.full_like(right, -view.camera.mount.height_m), back], -1)
        )
        apart = (
            np.abs(edges.bearing[:, None] - bearing) > np.maximum(4 * edges.bearing_sigma, np.deg2rad(0.08))[:, None]
        )
        lower, upper = np.moveaxis(edges.ends_px[..., 1], -1, 0)
        shown = view.ends_px[view.landmark, :, 1]
        common = np.minimum(lower[:, None], shown[:, 0]) - np.maximum(upper[:, None], shown[:, 1])
        apart |= common < 0.3 * (lower - upper)[:, None]
        below = np.where(apart, np.inf, lower[:, None] - foot_px[:, 1])
        if below.size:
            nearest = np.take_along_axis(below, np.abs(below).argmin(axis=1)[:, None], axis=1)[:, 0]
            known = np.isfinite(nearest)
            yield Feet(edges.foot_probability[known], nearest[known])


def _seen(edges: Edges) -> Edges:
    return edges.take(np.isfinite(edges.foot_range_m))


def _below_foot_px(edges: Edges, camera: Camera, camera_pose: Array, solids: Solids) -> Array:
    """Return by how many rows (E,) edges end below the foot of the upright surface that they are on; nan for none.

    The surface is hit a few pixels above the end; of what lies left and right of the edge the nearer is its own.
    """
    tilt, tangent = camera.mount.tilt_rad, np.tan(edges.bearing)
    end_e = camera.upright_from_pixels(edges.ends_px[:, 0])[:, 1]
    ahead = np.full((len(_ABOVE_END_PX), len(_BESIDE_PX), len(edges)), np.inf)
    for row, above_px in enumerate(_ABOVE_END_PX):
        e = end_e + np.minimum(above_px, 0.4 * edges.length_px) / camera.focal_px
        for side, beside_px in enumerate(_BESIDE_PX):
            a = tangent * (np.cos(tilt) + e * np.sin(tilt)) + beside_px / camera.focal_px
            rays = camera.level_rays(camera.pixels_from_upright(np.stack([a, e], axis=-1)))
            ahead[row, side] = _upright_surface(solids, camera_pose, rays / -rays[:, 2:], camera.mount.height_m)
    nearest = np.median(ahead.min(axis=1), axis=0)
    known = np.isfinite(nearest)
    foot = np.stack([tangent * nearest, np.full(len(edges), -camera.mount.height_m), -nearest], axis=-1)
    below = np.full(len(edges), np.nan)
    below[known] = edges.ends_px[known, 0, 1] - camera.project_level(foot[known])[:, 1]
    return below


def _upright_surface(solids: Solids, camera_pose: Array, rays: Array, height_m: float) -> Array:
    """Return how far ahead (R,) rays (R, 3), one unit ahead, hit an upright face; inf for tops, undersides, floor."""
    up = rays[:, 1]
    hits = cast(solids, camera_pose, rays[:, 0])
    bottom, top = ((height - height_m)[:, None] for height in (solids.bottom_m, solids.top_m))
    with np.errstate(all="ignore"):
        at_entry = up * hits.entry
        face = np.where((at_entry >= bottom) & (at_entry <= top), hits.entry, np.inf)
        level = np.where(up < 0, top / up, bottom / up)
        level = np.where((level > hits.entry) & (level < hits.leave), level, np.inf)
        floor = np.where(up < 0, -height_m / up, np.inf)
    first_face = face.min(axis=0)
    return np.where(first_face <= np.minimum(level.min(axis=0), floor), first_face, np.inf)


def row_of(feet: list[Feet]) -> list[str]:
    """Return the cells of a table's row: number, share on the floor, error / sigma, and the share in each bin."""
    probability = np.concatenate([each.probability for each in feet])
    below_px, stands = (np.concatenate([getattr(each, name) for each in feet]) for name in ("below_px", "stands"))
    cells = [str(len(stands)), f"{stands.mean():.2f}", f"{np.std(below_px[stands]) / FOOT_SIGMA_PX:.2f}"]
    for low, high in pairwise(BINS):
        inside = (probability >= low) & (probability < high)
        share = f"{probability[inside].mean():.2f} → {stands[inside].mean():.2f}" if inside.any() else "–"
        cells.append(f"{share} ({inside.sum()})")
    return cells


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    default_data = Path(__file__).resolve().parents[2] / "shared" / "data"
    parser.add_argument("--every", type=int, default=2, help="take every n-th image")
    parser.add_argument("--seed", type=int, default=1, help="of the drives; 0 is what the probability was fitted to")
    parser.add_argument("--data", type=Path, default=Path(os.environ.get("LOCALISER_DATA", default_data)))
    options = parser.parse_args()
    table = Table("images", "ends", "on the floor", "error / σ", *(f"{low}–{high}" for low, high in pairwise(BINS)))
    for world in sorted(WORLDS.glob("*.yaml")):
        table.add_row(world.stem, *row_of(list(simulated_feet(world, options.seed, options.every))))
    if (options.data / "house").is_dir():
        table.add_row("house", *row_of(list(house_feet(options.data / "house", options.every))))
    Console(width=170).print(table)


if __name__ == "__main__":
    main()
