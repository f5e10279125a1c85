"""The landmarks of the tracked place: which are hidden, and whether those beside the robot are there (docs/belief.md).

No landmark is tested behind a matched one within 30° that is nearer by 0.15 m: that one may be on a wall. On a map of
the building a place that is tracked is hardly ever wrong, so odds against one still count when another one is tracked
in its stead, and fade as scenes do.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from localiser.geometry import Array, wrap_angle
from localiser.observation.sighting import Matches

NEAR_M = 3.5
BEFORE_M, BESIDE_RAD = 0.15, np.radians(30.0)  # a landmark that is nearer than another and beside it
FEWEST_EDGES = 5  # of an image that tells: fewer may all be of anything
MATCHED, BY_CHANCE = (0.57, 0.78), (0.41, 1.37)  # a, b: on a map of the building, and on another one
# Within which scenes fade by a factor of e: elsewhere something else hides a landmark; those nearby tell of the map.
SEEN_SCENES, NEAR_SCENES = 8.0, 60.0
SAME_WALLS = 0.6  # log-odds, at most, of a landmark for one of several floors, whose walls may be the same
ANOTHER = 0.01  # odds that a map which is believed is of another building
_FORGOTTEN = 1e-4  # scenes that are not kept


@dataclass(frozen=True, eq=False)
class PlaceLandmarks:
    """What images showed of M landmarks.

    landmark: (M,) indices, ascending. seen: (M, 2) scenes that had it in view, in which an edge matched it and in which
    none did. near: (M, 2) those of them in which it was expected. before: log-odds that places which were tracked
    before left, at most 0. maps: among which the place was found; 1 where it was stated.
    """

    landmark: NDArray[np.int64] = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    seen: Array = field(default_factory=lambda: np.zeros((0, 2)))
    near: Array = field(default_factory=lambda: np.zeros((0, 2)))
    before: float = 0.0
    maps: int = 1

    def shown(self, landmarks: int) -> Array:
        """Return the part (L,) of the images that have a landmark in view in which an edge should match it."""
        scenes = np.tile(MATCHED, (landmarks, 1))
        scenes[self.landmark] += self.seen
        return np.asarray(scenes[:, 0] / scenes.sum(axis=1))

    @cached_property
    def log_odds(self) -> float:
        """The log-odds of a map of this building to another one, by the landmarks beside the robot alone."""
        from scipy.special import betaln

        here, another = (betaln(*(self.near + prior).T) - betaln(*prior) for prior in (MATCHED, BY_CHANCE))
        return self.before + float(np.minimum(here - another, SAME_WALLS if self.maps > 1 else np.inf).sum())

    @property
    def probability(self) -> float:
        """The probability that the map which is believed is that of the place, not of another building or floor.

        Of one map it is 1 where nothing speaks against it. Of n floors there may be one more, with the same walls.
        """
        if self.maps > 1:
            return float(1.0 / (1.0 + np.exp(-self.log_odds) / self.maps))
        return float((1.0 + ANOTHER) / (1.0 + ANOTHER * np.exp(max(-self.log_odds, 0.0))))

    def elsewhere(self, maps: int) -> PlaceLandmarks:
        """Return what is known when another place is tracked, which was found among so many maps."""
        return PlaceLandmarks(before=min(self.log_odds, 0.0), maps=maps)

    def after(self, matches: Matches, points: Array, pose: Array, novelty: float) -> PlaceLandmarks:
        """Return what is known after an image.

        matches: of its edges, seen from the tracked `pose` (3,). points: (L, 2) of all landmarks. novelty: of the
        scene, 0 … 1.
        """
        kept, near_kept = np.exp(-novelty / np.array([SEEN_SCENES, NEAR_SCENES]))
        scenes = np.zeros((len(points), 2, 2))
        scenes[self.landmark] = np.stack([kept * self.seen, near_kept * self.near], axis=1)
        if len(matches.landmark) >= FEWEST_EDGES:
            in_view = np.flatnonzero(matches.visible)
            near, is_matched = near_landmarks(matches, points, pose)
            scenes[in_view, 0, 1 - (in_view[:, None] == matches.landmark).any(axis=1)] += novelty
            scenes[near, 1, 1 - is_matched] += novelty
        landmark = np.flatnonzero(scenes.sum(axis=(1, 2)) > _FORGOTTEN)
        return PlaceLandmarks(landmark, scenes[landmark, 0], scenes[landmark, 1], near_kept * self.before, self.maps)


def near_landmarks(matches: Matches, points: Array, pose: Array) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """Return which landmarks (K,) an image tests, seen from the robot's pose (3,), and which of them an edge matches.

    points: (L, 2) of all landmarks. The robot stands for its camera, which is hardly farther away than 0.3 m.
    """
    visible = np.flatnonzero(matches.visible)
    range_m = np.hypot(*(points[visible] - pose[:2]).T)
    near, range_m = visible[range_m < NEAR_M], range_m[range_m < NEAR_M]
    direction = np.arctan2(*(points[near] - pose[:2]).T)
    is_matched = (near[:, None] == matches.landmark).any(axis=1)  # `np.isin` takes ten times as long for a few
    beside = np.abs(wrap_angle(direction[:, None] - direction[is_matched])) < BESIDE_RAD
    is_before = range_m[is_matched] < range_m[:, None] - BEFORE_M
    in_front = ~(beside & is_before).any(axis=1)
    return near[in_front], is_matched[in_front]
