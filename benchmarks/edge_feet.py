"""How often lower ends of edges stand on the floor when that is said to be so likely, and their range's sigma.

python benchmarks/edge_feet.py          furnished rooms, the worlds that ship, and in LOCALISER_DATA, where they are,
                                        the rendered house
python benchmarks/edge_feet.py --fit    find the numbers of the probability anew: of other rooms and drives
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
from edge_rooms import room_views
from rich.console import Console
from rich.table import Table

from localiser.camera import Camera
from localiser.edges import Edges, find_edges
from localiser.edges.find import grey_image
from localiser.edges.foot import FOOT_SIGMA_PX, LOG_ODDS, foot_evidence
from localiser.geometry import Array, robot_from_map
from localiser.simulate import simulated_log, world_of
from localiser.simulate.raycast import cast
from localiser.simulate.render import Scene as WorldScene
from localiser.simulate.solids import Solids

WORLDS = Path(__file__).resolve().parents[1] / "configs" / "worlds"
BINS = (0.0, 0.1, 0.3, 0.5, 0.7, 0.9, 1.0)
FITTED_ROOMS, JUDGED_ROOMS = range(60), range(1000, 1030)
ROOM_IMAGES = 6
_ROOMS_WEIGH = 2.0
"""As much as two of the other kinds of images: there are sixty different ones."""
_NEWTON_STEPS = 30
STANDS_PX = 3.0 * FOOT_SIGMA_PX
_ABOVE_END_PX = (6.0, 10.0, 14.0)
_BESIDE_PX = (-1.5, 1.5)


@dataclass(frozen=True, slots=True, eq=False)
class Feet:
    """Lower ends, F of them: probability (F,), and by how many pixels each lies below the foot of its surface (F,).

    evidence: (F, K) that the probability is made of.
    """

    probability: Array
    below_px: Array
    evidence: Array

    @property
    def stands(self) -> Array:
        """Whether each (F,) is the foot, within three sigmas; what is on no upright surface is none."""
        return np.abs(np.nan_to_num(self.below_px, nan=np.inf)) < STANDS_PX


def simulated_feet(world_file: Path, seed: int, every: int) -> Iterator[Feet]:
    """Yield the lower ends in images of a drive, against the surface that is hit just above each."""
    log = simulated_log(world_of(yaml.safe_load(world_file.read_text())), seed=seed)
    poses = log.drive.truth.sampled(log.drive.image_t_ns).poses
    for index in range(0, len(log), every):
        yield from _feet_of(log.image(index), log.camera, log.camera.pose_in_map(poses[index]), log.scene)


def room_feet(seeds: range) -> Iterator[Feet]:
    """Yield the lower ends in images of furnished rooms, one a seed."""
    for seed in seeds:
        for view in room_views(seed, ROOM_IMAGES):
            camera = view.scene.camera
            yield from _feet_of(view.image, camera, camera.pose_in_map(view.pose), view.scene)


def _feet_of(image: Array, camera: Camera, camera_pose: Array, scene: WorldScene) -> Iterator[Feet]:
    edges = _seen(find_edges(image, camera, with_probabilities=True))
    if len(edges):
        below_px = _below_foot_px(edges, camera, camera_pose, scene.structure.solids)
        yield Feet(edges.foot_probability, below_px, _evidence(edges, grey_image(image, camera), camera))


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
            yield Feet(edges.foot_probability[known], nearest[known], _evidence(edges, view.image, view.camera)[known])


def _evidence(edges: Edges, image: Array, camera: Camera) -> Array:
    """Return what the probability of each edge (E,) is made of, (E, K), in the order of `LOG_ODDS`."""
    return np.column_stack(list(foot_evidence(edges.ends_px[:, 0], edges.foot_range_m, image, camera).values()))


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


def fitted(kinds: list[tuple[float, list[Feet]]]) -> dict[str, float]:
    """Return the log odds of a logistic regression of kinds of images, each with how much it weighs in all."""
    evidence = np.concatenate([each.evidence for _, feet in kinds for each in feet])
    stands = np.concatenate([each.stands for _, feet in kinds for each in feet]).astype(np.float64)
    count = [sum(len(each.stands) for each in feet) for _, feet in kinds]
    weight = np.repeat([share / size for (share, _), size in zip(kinds, count, strict=True)], count) * len(stands)
    log_odds = np.zeros(evidence.shape[1])
    for _ in range(_NEWTON_STEPS):
        probability = 1 / (1 + np.exp(-evidence @ log_odds))
        information = (evidence * (weight * probability * (1 - probability))[:, None]).T @ evidence
        log_odds += np.linalg.solve(information, evidence.T @ (weight * (stands - probability)))
    return dict(zip(LOG_ODDS, log_odds.round(1).tolist(), strict=True))


def fit(house: Path, every: int) -> dict[str, float]:
    """Return the log odds of rooms and drives other than those that judge; the house only where it is there."""
    kinds = [(_ROOMS_WEIGH, list(room_feet(FITTED_ROOMS)))]
    kinds += [(1.0, list(simulated_feet(world, 0, every))) for world in sorted(WORLDS.glob("*.yaml"))]
    if house.is_dir():
        kinds.append((1.0, list(house_feet(house, every))))
    return fitted(kinds)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    default_data = Path(__file__).resolve().parents[2] / "shared" / "data"
    parser.add_argument("--fit", action="store_true", help="fit the log odds anew and print them")
    parser.add_argument("--every", type=int, default=2, help="take every n-th image of a drive")
    parser.add_argument("--seed", type=int, default=1, help="of the drives; 0 is what the probability was fitted to")
    parser.add_argument("--data", type=Path, default=Path(os.environ.get("LOCALISER_DATA", default_data)))
    options = parser.parse_args()
    if options.fit:
        print(fit(options.data / "house", options.every))
        return
    table = Table("images", "ends", "on the floor", "error / σ", *(f"{low}–{high}" for low, high in pairwise(BINS)))
    table.add_row("furnished rooms", *row_of(list(room_feet(JUDGED_ROOMS))))
    for world in sorted(WORLDS.glob("*.yaml")):
        table.add_row(world.stem, *row_of(list(simulated_feet(world, options.seed, options.every))))
    if (options.data / "house").is_dir():
        table.add_row("house", *row_of(list(house_feet(options.data / "house", options.every))))
    Console(width=170).print(table)


if __name__ == "__main__":
    main()
