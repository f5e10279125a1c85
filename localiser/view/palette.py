"""The colours (red, green, blue, alpha) of everything in the view, for a dark background."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from localiser.geometry import Array

Colour = tuple[int, int, int, int]

UNSEEN: Colour = (150, 164, 184, 255)
VISIBLE: Colour = (77, 163, 255, 255)
MATCHED: Colour = (84, 219, 124, 255)
UNMATCHED: Colour = (255, 112, 82, 255)
REJECTED: Colour = (170, 170, 170, 110)
JOIN: Colour = (255, 236, 110, 255)
SIGHT: Colour = (84, 219, 124, 90)

ESTIMATE: Colour = (255, 183, 43, 255)
PLACE: Colour = (196, 132, 255, 255)
TRUTH: Colour = (240, 244, 248, 255)
TRUTH_AHEAD: Colour = (240, 244, 248, 110)
ODOMETRY: Colour = (255, 105, 190, 255)
NOT_FOUND: Colour = (255, 183, 43, 70)
FRUSTUM: Colour = (200, 208, 218, 255)

STAGES: tuple[Colour, ...] = (VISIBLE, ESTIMATE, MATCHED, ODOMETRY, UNMATCHED, TRUTH)

# From the weightless to the heaviest particle.
_WEIGHTS = np.array([(126, 96, 214), (206, 84, 196), (255, 128, 96), (255, 220, 110)], dtype=np.float64)


def of_weights(weight: Array) -> NDArray[np.uint8]:
    """Return colours (N, 3) of weights (N,) relative to the largest, by their square root so that light ones differ."""
    level = np.sqrt(weight / weight.max(initial=np.finfo(float).tiny))
    steps = np.linspace(0.0, 1.0, len(_WEIGHTS))
    return np.stack([np.interp(level, steps, channel) for channel in _WEIGHTS.T], axis=-1).astype(np.uint8)
