"""A hall of dense racks: most of their uprights, 5 cm wide, are in view at once.

Each upright shows two edges 5 cm apart. Boxes on the boards show edges that are on no map.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import yaml

ROOT = Path(__file__).resolve().parents[2]
UPRIGHT_M, BAY_M, DEPTH_M, TOP_M = 0.05, 0.9, 0.8, 2.2
RACKS_X = (-3.9, -1.3, 0.5, 3.1)  # left sides of four rows of racks
NEAR_Z, BAYS = -1.5, 9


def world_of(seed: int) -> dict[str, object]:
    """Return a hall with four rows of racks as a world's file has it; boxes, colours and light are drawn."""
    world = yaml.safe_load((ROOT / "configs" / "worlds" / "corridor.yaml").read_text(encoding="utf-8"))
    rng = np.random.default_rng([seed, 40])
    materials = {
        "wall": {"texture": "plaster", "colour": [205, 204, 198], "contrast": 0.4},
        "steel": {"texture": "plain", "colour": [40, 70, 130]},
        "board": {"texture": "wood", "colour": [186, 152, 110], "contrast": 0.4},
        "floor": {"texture": "plaster", "colour": [150, 150, 148], "contrast": 0.6},
        "ceiling": {"texture": "plain", "colour": [215, 215, 215]},
    }
    for number in range(6):
        colour = rng.integers(60, 220, 3).tolist()
        materials[f"box{number}"] = {"texture": "wallpaper", "colour": colour, "size_m": 0.2, "contrast": 0.3}
    posts, furniture = [], []
    for left in RACKS_X:
        for bay in range(BAYS + 1):
            for x in (left, left + DEPTH_M):
                z = NEAR_Z - bay * BAY_M
                posts.append({"x": x, "z": z, "width_m": UPRIGHT_M, "top_m": TOP_M, "material": "steel"})
        for bay in range(BAYS):
            middle = {"x": left + DEPTH_M / 2, "z": NEAR_Z - (bay + 0.5) * BAY_M}
            for height in (0.35, 1.05, 1.75):
                size = {"width_m": DEPTH_M - UPRIGHT_M, "depth_m": BAY_M - UPRIGHT_M}
                levels = {"bottom_m": height, "top_m": height + 0.03, "material": "board"}
                furniture.append(middle | size | levels)
                if rng.random() < 0.6:
                    box = {
                        "x": middle["x"] + rng.uniform(-0.15, 0.15),
                        "z": middle["z"] + rng.uniform(-0.2, 0.2),
                        "width_m": rng.uniform(0.25, 0.4),
                        "depth_m": rng.uniform(0.2, 0.35),
                        "rotation_deg": rng.uniform(-12.0, 12.0),
                        "bottom_m": height + 0.03,
                        "top_m": height + 0.03 + rng.uniform(0.15, 0.4),
                    }
                    one = {name: round(float(value), 3) for name, value in box.items()}
                    furniture.append(one | {"material": f"box{rng.integers(6)}"})
    corners = [(-4.8, 1.5), (-4.8, -12.5), (4.8, -12.5), (4.8, 1.5)]
    walls = [
        {"from": list(one), "to": list(two), "material": "wall"}
        for one, two in zip(corners, [*corners[1:], corners[0]], strict=True)
    ]
    way = [(-2.05, -0.2), (-2.05, -10.6), (2.05, -10.9), (2.05, -0.2)]
    path = [{"to": list(way[0]), "pause_s": 0.4}]
    path += [{"to": list(point), "corner_radius_m": 0.4} for point in way[1:-1]] + [{"to": list(way[-1])}]
    return world | {
        "name": "racks",
        "materials": materials,
        "floor": {"material": "floor"},
        "ceiling": {"material": "ceiling"},
        "light": {"ambient": 0.7, "directional": 0.25, "from_deg": round(float(rng.uniform(0, 360)), 1)},
        "walls": walls,
        "posts": posts,
        "furniture": furniture,
        "drive": world["drive"] | {"path": path},
    }
