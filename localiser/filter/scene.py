"""The scene: what an image shows beyond an image that was taken some way back (docs/belief.md).

The belief compares each hypothesis with the clutter that an earlier image predicts: the last one that was taken a whole
scene back, near enough to show the same things, and far enough that the parallax of a landmark of known distance tells
it from clutter of unknown distance. When hardly any edge continues one of the image before, the robot was carried.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from localiser.geometry import Array, Increment
from localiser.motion import MotionModel, covariance_of
from localiser.observation import SEEN_AGAIN, EarlierFrame, EdgeObservation, Sighting, scene_clutter

SCENE_M, SCENE_RAD = 0.3, np.radians(12.0)
APART = 0.05  # scenes between the images that are kept, so that a robot that stands still keeps few
WITH_OLDER = 2  # images a scene back that are compared with: an edge that the last of them missed is in the one before
WHOLLY_NEW = 4.0  # log-ratio of having been carried from which on the images before are of another scene
# The fraction of edges that continue one of the image before is beta distributed: its mean after a robot was carried,
# and a + b, as edges of one object come and go together.
CARRIED, CONCENTRATION = 0.2, 6.0
FRACTIONS: Array = np.linspace(0.01, 0.99, 50)
USUAL_MEMORY = 0.95  # part of the usual fraction that an image leaves


@dataclass(frozen=True, slots=True, eq=False)
class SeenImage:
    """An image, and how the robot had moved until it, from where the scene began."""

    sighting: Sighting
    moved: Increment


@dataclass(frozen=True, slots=True)
class Jump:
    """How new an image is, and whether the robot was carried since the last one.

    novelty: of the scene, 0 … 1, by the way. log_ratio: log p(edges | carried) / p(edges | not carried).
    path_m: driven since the last image. log_fit: log p(edges | last image, motion), over that of new edges.
    """

    novelty: float
    log_ratio: float = 0.0
    path_m: float = 0.0
    log_fit: float = 0.0

    def carried(self, chance: float) -> float:
        """Return the probability of having been carried, whose prior `chance` is that between two scenes."""
        share = 1.0 if self.log_ratio > 0.0 else self.novelty
        odds = share * chance / (1.0 - chance) * np.exp(min(self.log_ratio, 100.0))
        return float(odds / (1.0 + odds))


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """Images from those that are a whole scene back until now, oldest first.

    usual: fraction of the edges that continue one of the image before, in the images of late. moved: until the last
    image, from where the scene began.
    """

    images: tuple[SeenImage, ...] = ()
    usual: float = SEEN_AGAIN
    moved: Increment = field(default_factory=lambda: Increment.from_mean(np.zeros(3)))

    def followed(
        self, observation: EdgeObservation, motion: MotionModel, sighting: Sighting, increment: Increment
    ) -> tuple[Scene, Array, Jump]:
        """Return the scene with an image, the density of clutter at its edges (E,), and how new it is.

        increment: the motion since the last image.
        """
        now, usual, jump = self.moved.then(increment), self.usual, Jump(1.0)
        ways = [(now.path_m - one.moved.path_m, now.turned_rad - one.moved.turned_rad) for one in self.images]
        away = [m / SCENE_M + rad / SCENE_RAD for m, rad in ways]  # scenes
        back = sum(scenes >= 1.0 for scenes in away)  # how many are a scene back
        first = max(back - WITH_OLDER, 0)
        images, away = self.images[first:], away[first:]
        frame = observation.frame(sighting.edges)

        def before(image: SeenImage) -> EarlierFrame:
            since = now.since(image.moved)
            turn_var = float(covariance_of(motion, since)[2, 2])
            return EarlierFrame.of(observation.frame(image.sighting.edges), frame, since, turn_var)

        density, _ = scene_clutter(frame, [before(one) for one in images[: max(back - first, 1)][::-1]])
        if images:
            log_ratio, log_fit = 0.0, 0.0
            if len(sighting.edges):
                _, continuing = scene_clutter(frame, [before(images[-1])])
                log_ratio, log_fit, fraction = _log_carried(continuing, usual)
                usual = USUAL_MEMORY * usual + (1.0 - USUAL_MEMORY) * fraction
            novelty = increment.path_m / SCENE_M + increment.turned_rad / SCENE_RAD
            jump = Jump(float(min(novelty, 1.0)), log_ratio, float(increment.path_m), log_fit)
        if len(images) > 1 and away[-2] < APART:
            images = images[:-1]
        if jump.log_ratio > WHOLLY_NEW:
            images = ()
        here = (SeenImage(sighting, now),) if len(sighting.edges) else ()
        return Scene((*images, *here), usual, now), density, jump


def _log_carried(continuing: Array, usual: float) -> tuple[float, float, float]:
    """Return log p(edges | carried) / p(edges | not carried), that of the latter, and the fraction that continue.

    continuing: (E,) how much likelier an edge is if it continues one. usual: which fraction f does, of a robot that was
    not carried. At ½ and below, edges come and go so often that they tell nothing.
    """
    by_fraction = np.log1p(FRACTIONS * (continuing[:, None] - 1.0)).sum(axis=0)
    mean = np.array([[CARRIED], [max(usual, 0.5)]])  # of f; its beta densities but for a constant that both share
    density = (CONCENTRATION * mean - 1.0) * np.log(FRACTIONS)
    density += (CONCENTRATION * (1.0 - mean) - 1.0) * np.log1p(-FRACTIONS)
    carried, stayed = by_fraction + (density - np.logaddexp.reduce(density, axis=1, keepdims=True))
    weight, log_fit = np.exp(stayed - stayed.max()), float(np.logaddexp.reduce(stayed))
    return float(np.logaddexp.reduce(carried)) - log_fit, log_fit, float(weight @ FRACTIONS / weight.sum())
