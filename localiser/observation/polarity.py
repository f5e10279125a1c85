"""Polarity: which side of an edge is the lighter one, and how well that agrees with the landmark's.

Clutter has either polarity as often as the other. An edge of a landmark has the landmark's own with probability
`SAME`: another light, or another wall behind a corner, turns it. So a pair of an edge and a landmark is likelier than
one of which that is not known by p(polarity | landmark) / ½, which is

    1 + polarity_e · (2 SAME - 1) polarity_l

and 1 where either is unknown (0).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from localiser.geometry import Array

SAME = 0.9  # measured: see docs/filter.md


def mean_polarity(landmark: NDArray[np.int8]) -> Array:
    """Return (2 SAME - 1) polarity_l (L,): the mean polarity of the edges of landmarks with these polarities (L,)."""
    return np.asarray((2.0 * SAME - 1.0) * landmark)
