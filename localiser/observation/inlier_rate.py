"""The inlier rate: the fraction of edges that belong to landmarks of the map, learnt while driving.

Empty corridors and full bookshelves differ in it, so every image has its own. How often each rate occurs is learnt as
the proportions of a mixture with a Dirichlet prior. The belief compares places by the detection rate: how many edges a
landmark in view shows on average (docs/observation.md). Each place learns its own (`relocalisation.Candidates`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from localiser.geometry import Array

# Jeffreys' prior of a rate is even in φ = asin √w; the midpoints of K even intervals of φ carry equal weights.
DETECTION_RATES: Array = np.array([0.02, 0.06, 0.15, 0.35, 0.7, 1.3])
_NODES = len(DETECTION_RATES)
INLIER_RATES: Array = np.sin((np.arange(_NODES) + 0.5) * np.pi / (2 * _NODES)) ** 2
UNKNOWN_RATE: Array = np.full(_NODES, 1.0 / _NODES)  # probability of each of these before any image
PRIOR_FRAMES = 12.0  # how many frames the prior counts for: a few images alike are no reason to be sure of the next
_PRIOR = np.full(_NODES, PRIOR_FRAMES / _NODES)

MEMORY_FRAMES = 30.0  # independent frames after which another part of the building is in view, with clutter of its own
_PART = 4096  # particles at a time: what is worked out of them stays in the second cache


@dataclass(frozen=True, slots=True, eq=False)
class InlierRate:
    """The distribution of a frame's inlier rate. count (K,): how many frames had each of `INLIER_RATES`."""

    count: Array

    @classmethod
    def unknown(cls) -> Self:
        """Return Jeffreys' prior."""
        return cls(_PRIOR)

    @property
    def probability(self) -> Array:
        """The probability (K,) of each of `INLIER_RATES` in the next frame."""
        return np.asarray(self.count / self.count.sum())

    @property
    def mean(self) -> float:
        """The inlier rate expected of the next frame."""
        return float(self.probability @ INLIER_RATES)

    def after(self, independent_frames: float) -> Self:
        """Return the distribution after moving on: what was counted long ago is forgotten."""
        return replace(self, count=_PRIOR + np.exp(-independent_frames / MEMORY_FRAMES) * (self.count - _PRIOR))

    def log_mean(self, by_rate: Array) -> Array:
        """Return log p(edges | pose) (N,), the rates integrated out of `by_rate` (K, N)."""
        log_probability, begins = np.log(self.probability)[:, None], range(0, max(by_rate.shape[1], 1), _PART)
        return np.concatenate([log_sum_of_rates(by_rate[:, k : k + _PART] + log_probability) for k in begins])

    def given(self, by_rate: Array, weight: Array, independent_frames: float) -> Self:
        """Return the distribution after a frame with log p(edges | pose, w_k) (K, N) and particles of weight (N,).

        The weights are those after the same edges. A frame that is only partly new counts for that part.
        """
        joint = by_rate + np.log(self.probability)[:, None]
        responsibility = np.exp(joint - log_sum_of_rates(joint)) @ weight
        return replace(self, count=self.count + independent_frames * responsibility)


def log_sum_of_rates(joint: Array) -> Array:
    """Return log Σ_k exp(joint) (N,) of joint (K, N), a few rates: much faster than `np.logaddexp.reduce`."""
    top = joint.max(axis=0)
    top = np.where(np.isfinite(top), top, 0.0)
    with np.errstate(divide="ignore"):  # a particle that every rate rules out
        return np.asarray(top + np.log(np.exp(joint - top).sum(axis=0)))
