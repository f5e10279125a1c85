"""The detection rate: how many edges a landmark in view shows on average.

The belief compares places by it, and not by the inlier rate: what a place explains must not depend on how few landmarks
are in view from it. Most landmarks of an empty corridor are seen, most of a furnished room are hidden, and a door jamb
can show as two or three edges. So every image has its own rate, whose distribution is learnt as that of the inlier rate
is. No rate is above 1.3: a place that explains the edges only if every landmark shows many of them explains nothing.
"""

from __future__ import annotations

import numpy as np

from localiser.geometry import Array
from localiser.observation.inlier_rate import InlierRate

DETECTION_RATES: Array = np.array([0.02, 0.06, 0.15, 0.35, 0.7, 1.3])


class DetectionRate(InlierRate):
    """The distribution of an image's detection rate. count (K,): how many images had each of `DETECTION_RATES`."""

    @property
    def mean(self) -> float:
        """The detection rate expected of the next image."""
        return float(self.probability @ DETECTION_RATES)
