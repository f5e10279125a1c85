"""An office of four floors: one plan, on each floor other furniture and other doors. Rendered, as `configs/worlds` are.

All maps are given (`Site`); truth is in the frame of all maps, so that the right place on a wrong floor is wrong.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from localiser import Trajectory, compose
from localiser.geometry import Array, between
from localiser.storage import Site

from board.run import Drive  # isort: skip

OFFICE = Path(__file__).resolve().parents[2] / "configs" / "worlds" / "office.yaml"
FLOORS = 4
GONE, MOVED_M = 0.35, 0.8  # share of the furniture that another floor does not have; how far the rest may stand off
FREE_M = 0.55  # between furniture and the robot's path
LIFT_S = 8.0  # in which the robot stands in the lift and no image comes
HZ = 2.5  # half of what the other drives have, as there are four to render
LATER = 12  # images from one begin of a drive, or one time of the lift, to the next


def world_of(floor: int) -> dict[str, Any]:
    """Return a floor as a world's file has it; the ground floor is the office as it ships."""
    world: dict[str, Any] = yaml.safe_load(OFFICE.read_text(encoding="utf-8"))
    world["name"], world["drive"]["image_hz"] = f"floor{floor}", HZ
    if floor == 0:
        return world
    rng = np.random.default_rng([floor, 60])
    path = np.array([point["to"] for point in world["drive"]["path"]])
    for kind in ("furniture", "posts"):
        kept, before, shift, stays = [], np.full(2, np.inf), np.zeros(2), True
        for thing in world[kind]:
            here = np.array([thing["x"], thing["z"]])
            if np.hypot(*(here - before)) > 1.2:  # the next piece of furniture, which has several parts
                shift, stays = rng.uniform(-MOVED_M, MOVED_M, 2), bool(rng.random() > GONE)
            before = here
            size = 0.5 * np.hypot(thing["width_m"], thing.get("depth_m", thing["width_m"]))
            moved = np.clip(here + shift, [-4.7, -8.2], [4.7, -0.3])
            if _from_path_m(moved, path) > size + FREE_M:
                here = moved
            if stays:
                kept.append(thing | {"x": round(float(here[0]), 3), "z": round(float(here[1]), 3)})
        world[kind] = kept
    for wall in world["walls"]:
        for door in wall.get("doors", []):
            if (leaf := door.get("leaf")) and leaf.get("angle_deg"):
                leaf["angle_deg"] = round(float(rng.uniform(70.0, 130.0)), 1)
    return world


def _from_path_m(point: Array, path: Array) -> float:
    steps = np.linspace(0.0, 1.0, 50)[:, None, None]
    way = path[:-1] + steps * np.diff(path, axis=0)
    return float(np.hypot(*(way.reshape(-1, 2) - point).T).min())


@cache
def drives() -> tuple[Site, list[Drive]]:
    """Return all maps laid apart, and a drive on each floor along the same path."""
    from board.drives import drive_of

    found = [drive_of(f"floor{floor}") for floor in range(FLOORS)]
    maps = [replace(one.landmark_map, name=one.name) for one in found]
    return Site.beside(maps), found


def on(seed: int, *, mapped: bool = True) -> Drive:
    """Return a drive with the maps of all floors, or of all others; each seed takes the next floor, every fourth later.

    From one part of the path to the next are `LATER` images.
    """
    site, found = drives()
    drive, first = found[seed % FLOORS], LATER * (seed // FLOORS)
    if not mapped:
        site = Site.beside([one for one in site.maps if one.name != drive.name])
    truth = drive.truth[first:] + (site.origin(drive.name) if mapped else 0.0)
    return replace(drive, landmark_map=site, t_ns=drive.t_ns[first:], edges=drive.edges[first:], truth=truth)


def lift(seed: int) -> Drive:
    """Return a drive that goes on in the same place of the next floor, 8 s later; the wheels stood still meanwhile."""
    site, found = drives()
    one, two = found[seed % FLOORS], found[(seed + 1) % FLOORS]
    count = LATER * (4 + seed // FLOORS)
    wait_ns, at_ns = int(1e9 * LIFT_S), int(one.t_ns[count])
    before, after = one.odometry.t_ns <= at_ns, two.odometry.t_ns > at_ns
    last, here = one.odometry.poses[before][-1], two.odometry.at(at_ns)
    poses = np.concatenate(
        [one.odometry.poses[before], [last], compose(last, between(here, two.odometry.poses[after]))]
    )
    times = [one.odometry.t_ns[before], [at_ns + wait_ns], two.odometry.t_ns[after] + wait_ns]
    truths = [one.truth[:count] + site.origin(one.name), two.truth[count:] + site.origin(two.name)]
    return replace(
        one,
        landmark_map=site,
        odometry=Trajectory(np.concatenate(times), poses),
        t_ns=np.concatenate([one.t_ns[:count], two.t_ns[count:] + wait_ns]),
        edges=[*one.edges[:count], *two.edges[count:]],
        truth=np.concatenate(truths),
        carried=count,
    )
