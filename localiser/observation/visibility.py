"""Visibility: which landmarks in view of the tracked place are not hidden.

The map has no walls, so it cannot tell which landmarks are hidden. But one that is hidden in an image is hidden in the
next one too. Every landmark is visible or hidden, and each image is evidence of it: a visible one is matched by an edge
in 0.85 of the images, a hidden one by chance in 0.1. Within a scene, a landmark changes with a probability of 0.1.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from localiser.geometry import Array
from localiser.observation.sighting import Matches

USUAL = 0.5  # how often a landmark in view is visible, where no image has told of it
CHANGES = 0.1  # within a scene, from visible to hidden, and back
FOUND, BY_CHANCE = 0.85, 0.1  # how often an image has an edge that is matched to a visible and to a hidden landmark
_SEEN, _MISSED = float(np.log(FOUND / BY_CHANCE)), float(np.log((1 - FOUND) / (1 - BY_CHANCE)))
_TELLS = 0.02  # by how much a probability differs from the usual one where it is kept


@dataclass(frozen=True, slots=True, eq=False)
class Visibility:
    """What images told of M landmarks. landmark: (M,) indices, ascending. probability: (M,) of being visible."""

    landmark: NDArray[np.int64] = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    probability: Array = field(default_factory=lambda: np.zeros(0))

    def of_all(self, landmarks: int) -> Array:
        """Return the probability (L,) with which each landmark of the map is visible."""
        result = np.full(landmarks, USUAL)
        result[self.landmark] = self.probability
        return result

    def after(self, matches: Matches, novelty: float) -> Visibility:
        """Return what is known after an image.

        matches: of its edges, as seen from the tracked place. novelty: of the scene, 0 … 1; an image that shows hardly
        anything new is hardly any evidence.
        """
        before = self.of_all(len(matches.visible))
        before += (1.0 - np.exp(-2.0 * CHANGES * novelty)) * (USUAL - before)
        is_matched = np.zeros(len(before), dtype=bool)
        is_matched[matches.landmark[matches.landmark >= 0]] = True
        log_ratio = np.where(matches.visible, np.where(is_matched, _SEEN, _MISSED), 0.0)
        odds = before / (1.0 - before) * np.exp(novelty * log_ratio)
        after = odds / (1.0 + odds)
        landmark = np.flatnonzero(np.abs(after - USUAL) > _TELLS)
        return Visibility(landmark, after[landmark])
