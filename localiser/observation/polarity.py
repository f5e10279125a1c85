"""Polarity: which side of an edge is lighter, and how well that agrees with the landmark.

Clutter has both polarities equally often. An edge of a landmark has the landmark's polarity with probability `SAME`;
different light, or another wall behind a corner, can reverse it. So the likelihood of a pair of edge and landmark is
multiplied by p(polarity | landmark) / ½, which is

    1 + polarity_e · (2 SAME - 1) polarity_l

and 1 where either is unknown (0).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from localiser.geometry import Array

SAME = 0.9  # measured: see docs/notes/observation.md


def mean_polarity(landmark: NDArray[np.int8]) -> Array:
    """Return (2 SAME - 1) polarity_l (L,): the mean polarity of the edges of landmarks with these polarities (L,)."""
    return np.asarray((2.0 * SAME - 1.0) * landmark)
