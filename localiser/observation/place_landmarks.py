"""The landmarks of the tracked place: which are hidden, and whether those beside the robot are there.

Visibility: the map has no walls, so it cannot tell which landmarks are hidden. But one that is hidden in an image is
hidden in the next one too. Every landmark is visible or hidden, and each image is evidence of it: a visible one is
matched by an edge in 0.85 of the images, a hidden one by chance in 0.1. Within a scene, a landmark changes with a
probability of 0.1.

Near landmarks: whether those that should be seen beside the robot are there.

The likelihood compares edges with the clutter that earlier images predict. In a building of the same kind, as on
another floor, edges that match by chance keep matching, and the likelihood takes each image for new evidence. So this
test asks a question that it does not: of the landmarks near the tracked place, how many does any edge match?

A landmark is tested in an image that has it in view within 3.5 m of the robot, unless a matched landmark within 30° of
it is nearer by 0.15 m: that one may be on a wall. It counts once, however many images show it:

    log odds = Σ_l w_l (f_l log(p / q) + (1 - f_l) log((1 - p) / (1 - q))),   w_l = 1 - exp(-scenes)

f_l is the part of its scenes in which it was matched, p and q are how often that is so on a map of the building and on
another one. Scenes fade by a factor of e within 60, so a landmark that was seen for ten is half forgotten after some 50
m. On a map of the building a place that is tracked is hardly ever wrong, so odds against one still count when another
one is tracked in its stead, and fade as scenes do.

Of a building of which n floors are mapped there may be one more, whose walls are those of the others. A place that was
found on one of n maps has odds of n to it, until landmarks beside the robot tell.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from localiser.geometry import Array, wrap_angle
from localiser.observation.sighting import Matches

USUAL = 0.5  # how often a landmark in view is visible, where no image has told of it
VISIBILITY_CHANGES = 0.1  # within a scene, from visible to hidden, and back
FOUND, FOUND_HIDDEN = 0.85, 0.1  # how often an image has an edge that is matched to a visible and to a hidden landmark
_SEEN, _MISSED = float(np.log(FOUND / FOUND_HIDDEN)), float(np.log((1 - FOUND) / (1 - FOUND_HIDDEN)))
_TELLS = 0.02  # by how much a probability differs from the usual one where it is kept

NEAR_M = 3.5
BEFORE_M, BESIDE_RAD = 0.15, np.radians(30.0)  # a landmark that is nearer than another and beside it
FEWEST_EDGES = 5  # of an image that tells: fewer may all be of anything
MATCHED, BY_CHANCE = 0.45, 0.25  # how often a near landmark is, on a map of the building and on another one
NEAR_MEMORY_SCENES = 60.0
ANOTHER = 0.01  # odds that a map which is believed is of another building
UNLIKELY = 0.3  # below this probability the map is said not to fit
_FORGOTTEN = 1e-4  # scenes that are not kept


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
        before += (1.0 - np.exp(-2.0 * VISIBILITY_CHANGES * novelty)) * (USUAL - before)
        is_matched = np.zeros(len(before), dtype=bool)
        is_matched[matches.landmark[matches.landmark >= 0]] = True
        log_ratio = np.where(matches.visible, np.where(is_matched, _SEEN, _MISSED), 0.0)
        odds = before / (1.0 - before) * np.exp(novelty * log_ratio)
        after = odds / (1.0 + odds)
        landmark = np.flatnonzero(np.abs(after - USUAL) > _TELLS)
        return Visibility(landmark, after[landmark])


@dataclass(frozen=True, slots=True, eq=False)
class NearLandmarks:
    """What images showed of M near landmarks.

    landmark: (M,) indices, ascending. scenes: (M,) in which it was tested. matched: (M,) in which an edge matched it.
    before: log-odds that places which were tracked before left, at most 0. maps: among which the place was found; 1
    where it was stated.
    """

    landmark: NDArray[np.int64] = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    scenes: Array = field(default_factory=lambda: np.zeros(0))
    matched: Array = field(default_factory=lambda: np.zeros(0))
    before: float = 0.0
    maps: int = 1

    @property
    def log_odds(self) -> float:
        """The log-odds of a map of this building to another one, by these landmarks alone."""
        part, weight = self.matched / self.scenes, 1.0 - np.exp(-self.scenes)
        each = part * np.log(MATCHED / BY_CHANCE) + (1.0 - part) * np.log((1.0 - MATCHED) / (1.0 - BY_CHANCE))
        return self.before + float(weight @ each)

    @property
    def probability(self) -> float:
        """The probability that the map which is believed is that of the place, not of another building or floor.

        Of one map it is 1 where nothing speaks against it.
        """
        if self.maps > 1:
            return float(1.0 / (1.0 + np.exp(-self.log_odds) / self.maps))
        return float((1.0 + ANOTHER) / (1.0 + ANOTHER * np.exp(max(-self.log_odds, 0.0))))

    @property
    def are_missing(self) -> bool:
        """Whether so few are there that this is no map of what is seen from the tracked place."""
        return self.probability < UNLIKELY

    def elsewhere(self, maps: int) -> NearLandmarks:
        """Return what is known when another place is tracked, which was found among so many maps."""
        return NearLandmarks(before=min(self.log_odds, 0.0), maps=maps)

    def after(self, matches: Matches, points: Array, pose: Array, novelty: float) -> NearLandmarks:
        """Return what is known after an image.

        matches: of its edges, seen from the tracked `pose` (3,). points: (L, 2) of all landmarks. novelty: of the
        scene, 0 … 1.
        """
        scenes, matched = np.zeros(len(points)), np.zeros(len(points))
        kept = np.exp(-novelty / NEAR_MEMORY_SCENES)
        scenes[self.landmark], matched[self.landmark] = kept * self.scenes, kept * self.matched
        if len(matches.landmark) >= FEWEST_EDGES:
            tested, is_matched = near_landmarks(matches, points, pose)
            scenes[tested] += novelty
            matched[tested] += novelty * is_matched
        landmark = np.flatnonzero(scenes > _FORGOTTEN)
        return NearLandmarks(landmark, scenes[landmark], matched[landmark], kept * self.before, self.maps)


def near_landmarks(matches: Matches, points: Array, pose: Array) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """Return which landmarks (K,) an image tests, seen from the robot's pose (3,), and which of them an edge matches.

    points: (L, 2) of all landmarks. The robot stands for its camera, which is hardly farther away than 0.3 m.
    """
    visible = np.flatnonzero(matches.visible)
    range_m = np.hypot(*(points[visible] - pose[:2]).T)
    near, range_m = visible[range_m < NEAR_M], range_m[range_m < NEAR_M]
    direction = np.arctan2(*(points[near] - pose[:2]).T)
    is_matched = np.isin(near, matches.landmark)
    beside = np.abs(wrap_angle(direction[:, None] - direction[is_matched])) < BESIDE_RAD
    is_before = range_m[is_matched] < range_m[:, None] - BEFORE_M
    in_front = ~(beside & is_before).any(axis=1)
    return near[in_front], is_matched[in_front]
