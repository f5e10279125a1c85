"""What a rolling shutter and compression cost, each by itself: one drive, replayed.

The robot zigzags down the corridor of `configs/worlds/corridor.yaml`. It turns at 1 rad/s in every bend, and on the
spot at its end. Each camera sees the same drive with the same errors of the wheels; the map is that of the world.

python benchmarks/cameras.py
python benchmarks/cameras.py --only plain "rolling, stated" --seeds 0-1
python benchmarks/cameras.py --edges    # of single images, against those of a camera that takes all rows at once
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from localiser import replay_log
from localiser.edges import Edges, find_edges
from localiser.geometry import Array, Trajectory, Twist, arc_motion, compose
from localiser.simulate import expose, scene_of, world_of
from localiser.storage import simulate_log

WORLD = Path(__file__).resolve().parents[1] / "configs" / "worlds" / "corridor.yaml"
READOUT_US = 30_000.0
ROWS = 480
BENDS = [(-0.3, -0.9), (0.3, -2.5), (-0.3, -4.1), (0.3, -5.7), (-0.2, -7.3)]
DRIVE = {
    "path": [
        {"to": [0.1, 0.7], "pause_s": 0.4},
        *({"to": list(bend), "corner_radius_m": 0.5} for bend in BENDS),
        {"to": [0.0, -9.0]},
    ],
    "turn_deg_s": 57.3,
    "end_turn_deg": -180.0,
}
PLACES = [np.array([0.1, 0.3, 0.1]), np.array([0.1, -3.0, -0.2]), np.array([-0.2, -6.0, 0.3])]
MOTIONS = [(1.0, 0.5), (1.0, 0.0), (0.0, 0.5)]
"""Turn rate (rad/s) and speed (m/s) while a single image is taken, at each place."""
MIDDLE_NS = 100_000_000
SAME_RAD, SAME_LENGTH = 0.02, 0.3
FIGURES = {
    "position RMSE (mm)": ("position_rmse_m", 1e3, ".1f"),
    "heading RMSE (°)": ("heading_rmse_deg", 1.0, ".2f"),
    "NEES": ("nees_mean", 1.0, ".2f"),
    "sure and wrong (%)": ("confidence.sure_and_wrong", 100.0, ".1f"),
    "sure (%)": ("confidence.sure", 100.0, ".0f"),
    "edges": ("edges_per_frame", 1.0, ".1f"),
}
MORE_IS_BETTER = ("sure (%)", "edges")


def shutter(*, stated: bool, stamp_row: float = 0.0) -> dict[str, Any]:
    """Return what a world file says of a shutter that takes 30 ms from the first row to the last."""
    return {"row_time_us": READOUT_US / (ROWS - 1), "stamp_row": stamp_row, "stated": stated}


def worlds() -> dict[str, dict[str, Any]]:
    """Return the world of each camera, by name."""
    plain = yaml.safe_load(WORLD.read_text())
    plain["drive"] |= DRIVE
    rolling = {name: {"rolling_shutter": spec} for name, spec in _shutters().items()}
    return {
        "plain": plain,
        **{name: _with(plain, camera=camera) for name, camera in rolling.items()},
        "JPEG 50": _with(plain, image={"jpeg_quality": 50}),
    }


def _shutters() -> dict[str, dict[str, Any]]:
    return {
        "rolling, stated": shutter(stated=True),
        "rolling, not stated": shutter(stated=False),
        "rolling, stamped in the middle, stated": shutter(stated=True, stamp_row=(ROWS - 1) / 2),
        "rolling, stamped in the middle, not stated": shutter(stated=False, stamp_row=(ROWS - 1) / 2),
    }


def _with(world: Mapping[str, Any], **changes: Mapping[str, Any]) -> dict[str, Any]:
    """Return a world with some values of its sections changed."""
    return {**world, **{section: {**world[section], **values} for section, values in changes.items()}}


def figures_of(world: Mapping[str, Any], seeds: range) -> Array:
    """Return the figures (seeds, figures) of a drive that is replayed with each seed."""
    log = simulate_log(world_of(dict(world)), 0)
    return np.array([_figures(replay_log(log, seed=seed).metrics) for seed in seeds])


def _figures(metrics: Mapping[str, Any]) -> list[float]:
    found = []
    for path, scale, _ in FIGURES.values():
        value: Any = metrics
        for key in path.split("."):
            value = value[key]
        found.append(scale * float(value))
    return found


def _cell(values: Array, figure: str, form: str) -> str:
    """Return median and worst of a figure's values (seeds,)."""
    worst = values.min() if figure in MORE_IS_BETTER else values.max()
    return f"{np.median(values):{form}} ({worst:{form}})"


def print_edges() -> None:
    """Print how edges of a rolling shutter differ from those of a camera that takes all rows at once, at three places.

    The motion is told exactly, with a sigma of 5 % of the turn rate. Edges are paired by bearing,
    polarity and length; medians are of absolute differences.
    """
    rolling = scene_of(world_of(_with(worlds()["plain"], camera={"rolling_shutter": shutter(stated=True)})))
    at_once = replace(rolling, camera=replace(rolling.camera, shutter=None))
    parts = ("", ", not corrected")
    heads = ["motion", "edges", *(f"{what}{part}" for part in parts for what in ("found", "lean off", "bearing off"))]
    print("| " + " | ".join(heads) + " |")
    print("|---" * 8 + "|", flush=True)
    for turn_rad_s, speed_m_s in MOTIONS:
        twist = Twist(0.0, -speed_m_s, turn_rad_s, 0.05 * turn_rad_s)
        count, corrected, wrong = 0, [], []
        for place in PLACES:
            path = _arc(place, twist)
            images = [expose(one, path, MIDDLE_NS, np.random.default_rng(0)) for one in (rolling, at_once)]
            expected = find_edges(images[1], at_once.camera)
            count += len(expected)
            corrected.append(_off_deg(find_edges(images[0], rolling.camera, twist=twist), expected))
            wrong.append(_off_deg(find_edges(images[0], at_once.camera), expected))
        cells = [f"{turn_rad_s:g} rad/s, {speed_m_s:g} m/s", str(count)]
        for off in (np.concatenate(corrected), np.concatenate(wrong)):
            lean, bearing = np.median(np.abs(off), axis=0)
            cells += [str(len(off)), f"{lean:.2f}°", f"{bearing:.3f}°"]
        print("| " + " | ".join(cells) + " |", flush=True)


def _arc(place: Array, twist: Twist) -> Trajectory:
    """Return the path of constant twist that is at a place (3,) in its middle."""
    t_ns = np.arange(0, 2 * MIDDLE_NS + 1, 1_000_000)
    velocity, since_s = np.array([twist.right_m_s, twist.backward_m_s]), (t_ns - MIDDLE_NS) / 1e9
    return Trajectory(t_ns, np.array([compose(place, arc_motion(velocity, twist.turn_rad_s * s, s)) for s in since_s]))


def _off_deg(found: Edges, expected: Edges) -> Array:
    """Return lean and bearing (P, 2), in degrees, of edges that are found less those of the expected ones."""
    apart = np.abs(found.bearing[:, None] - expected.bearing)
    apart[found.polarity[:, None] != expected.polarity] = np.inf
    apart[np.abs(np.log(found.length_px[:, None] / expected.length_px)) > SAME_LENGTH] = np.inf
    nearest = apart.argmin(axis=1)
    is_same = apart.min(axis=1) < SAME_RAD
    pairs = [(found.lean, expected.lean), (found.bearing, expected.bearing)]
    return np.rad2deg(np.stack([(one - other[nearest])[is_same] for one, other in pairs], axis=-1))


def main() -> None:
    """Print a table, row by row: the median over the seeds, and the worst in brackets."""
    known = worlds()
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", default="0-4", help="first and last")
    parser.add_argument("--only", nargs="*", default=list(known), choices=list(known), metavar="CAMERA")
    parser.add_argument("--edges", action="store_true", help="compare the edges of single images instead")
    options = parser.parse_args()
    if options.edges:
        print_edges()
        return
    first, last = map(int, options.seeds.split("-"))
    print("| camera | " + " | ".join(FIGURES) + " |")
    print("|---" * (len(FIGURES) + 1) + "|", flush=True)
    for name in options.only:
        each = figures_of(known[name], range(first, last + 1))
        cells = [
            _cell(column, name, form) for column, (name, (_, _, form)) in zip(each.T, FIGURES.items(), strict=True)
        ]
        print(f"| {name} | " + " | ".join(cells) + " |", flush=True)


if __name__ == "__main__":
    main()
