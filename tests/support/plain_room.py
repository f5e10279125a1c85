"""A world file's content: a plain room of 8 m, as a base for tests of the renderer."""

from typing import Any

CORNERS = [[-4.0, 4.0], [-4.0, -4.0], [4.0, -4.0], [4.0, 4.0]]


def plain_room(**changes: Any) -> dict[str, Any]:
    """Return a dark room with a bright post in it, and a camera of 160×120 pixels; `changes` replace its sections."""
    return {
        "format": "localiser-world/1",
        "name": "room",
        "materials": {
            name: {"texture": "plain", "colour": [grey] * 3} for name, grey in (("dark", 60), ("light", 220))
        },
        "floor": {"material": "dark"},
        "ceiling": {"material": "dark"},
        "walls": [{"from": CORNERS[k - 1], "to": CORNERS[k], "material": "dark"} for k in range(4)],
        "posts": [{"x": 0.0, "z": -1.0, "width_m": 0.5, "rotation_deg": 20.0, "material": "light"}],
        "camera": camera_data(),
        "drive": {"path": [{"to": [0.0, 3.0]}, {"to": [0.0, 1.0]}]},
        "image": {"noise_sigma": 0.0, "colour": False},
    } | changes


def camera_data(mount: dict[str, Any] | None = None, **sections: Any) -> dict[str, Any]:
    """Return the camera of the room; mount: in place of its own. sections: others that it has, empty ones left out."""
    mount = mount or {"tilt_deg": 20.0, "height_m": 0.9}
    given = {name: section for name, section in sections.items() if section}
    return {"width": 160, "height": 120, "focal_px": 140.0, "mount": mount} | given
