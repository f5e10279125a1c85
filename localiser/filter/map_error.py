"""How far landmarks stand from where the map has them, learnt while driving (docs/filter.md).

A plan may be off by centimetres, a map that was surveyed by nothing. So all sigmas of the map are taken to be `scale`
times as large as stated. A map may be good in one part and poor in another, so now and then the scale changes to any
other (a hidden Markov model). The error of a landmark is the same in every image that shows it, so errors of edges
repeat along a path that is longer by the factor `decorrelation`.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from localiser.geometry import Array

SCALES: Array = 2.0 ** np.arange(-1.0, 4.5, 0.5)  # of sigmas of 6 mm: 3 mm to 0.1 m
SCALE_CHANGES = 0.003  # the rate, for each independent image, at which what comes into view was mapped in another way
REPEATED = 0.5  # what an image counts for: half of its landmarks were seen before, with the same errors
_PRIOR: Array = np.exp(-0.5 * np.log2(SCALES) ** 2)  # a factor of two, 1 sigma
_PRIOR /= _PRIOR.sum()


@dataclass(frozen=True, slots=True, eq=False)
class MapError:
    """The scale of the map's sigmas. probability: (K,) of each of `SCALES`. novelty: of images not yet learnt from."""

    probability: Array = field(default_factory=_PRIOR.copy)
    novelty: float = 0.0

    @property
    def scale(self) -> float:
        """The scale that is expected: the geometric mean."""
        return float(np.exp(self.probability @ np.log(SCALES)))

    @property
    def decorrelation(self) -> float:
        """By how much longer errors of edges repeat than they do with a map as good as stated; 1 with a better one."""
        return max(self.scale, 1.0)

    def after(self, by_scale: Array) -> MapError:
        """Return what is known after an image with log p(edges | scale) (K,)."""
        changed = 1.0 - np.exp(-SCALE_CHANGES * self.novelty)
        predicted = (1.0 - changed) * self.probability + changed * _PRIOR
        joint = predicted * np.exp(REPEATED * self.novelty * (by_scale - by_scale.max()))
        return MapError(joint / joint.sum())
