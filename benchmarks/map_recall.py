"""How many of the edges that the rendered house shows well are on the map that is built of its images.

python benchmarks/map_recall.py LOG             # a folder with edges_exact.csv and visible.csv; poses are the true ones

An edge is shown well by 20 images with 60 px of it, across which grey values step by 8, from directions 6° apart. Where
a landmark of the truth stands for several edges, the nearest of them counts.
"""

from __future__ import annotations

import argparse
from collections import defaultdict
from collections.abc import Iterable
from pathlib import Path

import numpy as np
from edge_data import HouseView, house_views

from localiser.config import read_config
from localiser.geometry import Array, wrap_angle
from localiser.mapping import build_map, cache_folder
from localiser.storage import open_log

IMAGES, PARALLAX_RAD, NEAR_M = 20, np.deg2rad(6.0), 0.05


def shown_well(views: Iterable[HouseView]) -> tuple[list[Array], Array]:
    """Return the exact edges (K, 2) of each landmark that is shown well, and all edges (P, 2) that are in view."""
    edges: dict[str, Array] = {}
    seen_from: dict[str, list[Array]] = defaultdict(list)
    for view in views:
        for index, plain in enumerate(view.is_plain):
            edges[view.name[index]] = view.points[view.landmark == index]
            if plain:
                seen_from[view.name[index]].append(view.pose[:2])
    well = [edges[name] for name, places in seen_from.items() if is_well(edges[name], np.array(places))]
    return well, np.concatenate(list(edges.values()))


def is_well(edges: Array, places: Array) -> bool:
    """Whether edges (K, 2) of one landmark were seen from enough places (T, 2), in directions far enough apart."""
    if len(edges) == 0 or len(places) < IMAGES:
        return False
    right, back = (places - edges.mean(axis=0)).T
    direction = np.arctan2(right, back)
    return bool(np.ptp(wrap_angle(direction - direction[0])) >= PARALLAX_RAD)


def nearest(points: Array, others: Array) -> Array:
    """Return how far (K,) each of points (K, 2) is from the nearest of others (M, 2)."""
    return np.linalg.norm(points[:, None] - others[None], axis=-1).min(axis=1)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("log", type=Path)
    log = open_log(parser.parse_args().log)
    made = build_map(log, "truth", read_config(None, [], log.settings), cache=cache_folder()).landmark_map.points
    well, edges = shown_well(house_views(log.path))
    off = np.array([nearest(each, made).min() for each in well])
    print(
        "| log | shown well | found within 0.05 m | median m | worst m | landmarks built | of them true within 0.05 m |"
    )
    print(
        f"| {log.name} | {len(well)} | {(off <= NEAR_M).mean():.3f} | {np.median(off):.4f} | {off.max():.3f} | "
        f"{len(made)} | {(nearest(made, edges) <= NEAR_M).mean():.3f} |"
    )
