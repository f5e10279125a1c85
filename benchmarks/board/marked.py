"""A shop of equal shelves, one AprilTag at the end of each: rendered, once for the map, and then as somebody left it.

Shelves stand in rows that look the same from every aisle, so that edges alone cannot tell one from the next.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import yaml

from board.floors import LATER, OFFICE
from board.run import Drive

AISLE_M, DEPTH_M, LENGTH_M, SHELVES = 2.4, 0.8, 3.6, 3
PAPER_M, BOTTOM_M = 0.4, 0.5  # of a marker with its white rim, hung below the height of the camera
MOVED_M = 2.0
HZ = 2.5


def world_of(change: str = "") -> dict[str, Any]:
    """Return the shop as a world's file has it.

    change: "moved": the second marker hangs 2 m off; "twice": the first has a copy at the far end; "bare": no
    marker hangs there; "mapping", "bare mapping": another drive, which the map is made from.
    """
    world: dict[str, Any] = yaml.safe_load(OFFICE.read_text(encoding="utf-8"))
    materials = {name: world["materials"][name] for name in ("wall", "shelf", "desk", "floor", "ceiling")}
    for number in range(SHELVES):
        colour = [235, 235, 235]
        materials[f"tag{number}"] = {"texture": "marker", "colour": colour, "size_m": PAPER_M, "number": number}
    width = (SHELVES + 1) * AISLE_M + SHELVES * DEPTH_M
    corners = [(0.0, 0.0), (width, 0.0), (width, -9.0), (0.0, -9.0)]
    walls: list[dict[str, Any]] = [
        {"from": list(one), "to": list(two), "material": "wall"}
        for one, two in zip(corners, [*corners[1:], corners[0]], strict=True)
    ]
    for number in range(SHELVES):
        left = AISLE_M + number * (AISLE_M + DEPTH_M)
        hung = [{"at_m": DEPTH_M / 2, "material": f"tag{number}"}]
        if "bare" in change or (change == "moved" and number == 1):
            hung = []
        size = {"width_m": PAPER_M, "bottom_m": BOTTOM_M, "top_m": BOTTOM_M + PAPER_M, "side": "left"}
        ends = {"to": [left, -3.0], "from": [left + DEPTH_M, -3.0], "height_m": 1.6, "material": "shelf"}
        walls.append(ends | {"thickness_m": 0.1, "posters": [one | size for one in hung]})
        for x in (left, left + DEPTH_M):
            side = {"from": [x, -3.0], "to": [x, -3.0 - LENGTH_M], "height_m": 1.6, "material": "shelf"}
            walls.append(side | {"thickness_m": 0.05})
    for shown, number, x in (("moved", 1, AISLE_M + 1.5 * (AISLE_M + DEPTH_M)), ("twice", 0, width - 1.2)):
        if change == shown:  # on a board of its own, between shelves
            board = {"to": [x, -3.0], "from": [x + 0.6, -3.0], "height_m": 1.1, "material": "desk", "thickness_m": 0.05}
            hung = [{"at_m": 0.3, "material": f"tag{number}", **size}]
            walls.append(board | {"posters": hung})
    # To and fro before the shelves, so that the camera looks at their ends again and again.
    near, far, step = (-1.9, -0.6, 1.5) if "mapping" not in change else (-1.7, -0.9, 1.3)
    way = [(0.8 + k * step, far if k % 2 == 0 else near) for k in range(int((width - 1.6) / step) + 1)]
    path = [{"to": [round(x, 3), z], "pause_s": 0.4} for x, z in way]
    camera = world["camera"] | {"width": 320, "height": 240, "focal_px": 277.0}
    return world | {
        "name": f"shop {change}".strip(),
        "materials": materials,
        "walls": walls,
        "posts": [],
        "furniture": [],
        "camera": camera,
        "drive": world["drive"] | {"path": path, "image_hz": HZ},
    }


def on(name: str, seed: int) -> Drive:
    """Return a drive through the shop on the map of its markers; another part of the path with each seed."""
    from board.drives import drive_of, map_of

    drive, first = drive_of(name), LATER * seed
    found = map_of("shop bare" if name == "shop bare" else "shop")
    return replace(
        drive, landmark_map=found, t_ns=drive.t_ns[first:], edges=drive.edges[first:], truth=drive.truth[first:]
    )
