"""What a run learnt of its wheels and its camera, as texts with sigmas."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

# Name in `biases`: how it reads, unit, and what the value is multiplied by for it.
LEARNT = {
    "distance_scale": ("distance", "%", 100.0),
    "turn_scale": ("turn", "%", 100.0),
    "veer": ("veer", "°/m", 57.29577951308232),
    "camera_yaw": ("camera yaw", "°", 57.29577951308232),
    "delay": ("delay", "ms", 1000.0),
}


def learnt_constants(figures: Mapping[str, Any]) -> list[str]:
    """Return a text for each constant error that the run has learnt, and for tilt and roll by the edges."""
    texts = []
    for name, learnt in (figures.get("biases") or {}).items():
        label, unit, per = LEARNT.get(name, (name.replace("_", " "), "", 1.0))
        space = "" if unit.startswith("°") else " "
        texts.append(f"{label} {per * learnt['value']:+.2f} ± {per * learnt['sigma']:.2f}{space}{unit}".rstrip())
    for name in ("tilt", "roll"):
        if figures.get(f"{name}_found_deg") is not None:
            found, sigma = figures[f"{name}_found_deg"], figures[f"{name}_found_sigma_deg"]
            texts.append(f"{name} {found:.3f} ± {sigma:.3f}°")
    return texts
