"""The scene: what an image shows beyond an image that was taken some way back.

Consecutive images show nearly the same edges. A wrong place that fits one of them by chance therefore fits the next
ones too. So the belief counts an image by the novelty of its scene, and compares each hypothesis with the clutter that
an earlier image predicts. The earlier image is the last one that was taken a whole scene back, 0.3 m or 12°: near
enough to show the same things, and far enough that the parallax of a landmark of known distance tells it from clutter
of unknown distance.

When hardly any edge continues one of the image before, the robot was carried, however little its wheels have turned.
Then the image is wholly new.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import lgamma

import numpy as np

from localiser.geometry import Array, Increment
from localiser.motion import MotionModel, covariance_of
from localiser.observation import EarlierImage, PredictsScenes, Sighting

SCENE_M, SCENE_RAD = 0.3, np.radians(12.0)
APART = 0.05  # scenes between the images that are kept, so that a robot that stands still keeps few
WITH_OLDER = 2  # images a scene back that are compared with: an edge that the last of them missed is in the one before
CONTINUED, EDGES = 0.8, 30.0  # fraction of the edges that continue one of the image before, as if seen in so many edges
CONCENTRATION = 6.0  # a + b of the beta distribution of that fraction: edges of one object come and go together
WHOLLY_NEW = 6.0  # log-ratio of having been carried from which on the images before are of another scene
MEMORY = 0.98  # part of what is known of the fraction that an image leaves


@dataclass(frozen=True, slots=True, eq=False)
class SeenImage:
    """An image and how the robot has moved since."""

    sighting: Sighting
    since: Increment

    def before(self, motion: MotionModel) -> EarlierImage:
        """Return it as an observation takes it."""
        return EarlierImage(self.sighting, self.since, float(covariance_of(motion, self.since)[2, 2]))


@dataclass(frozen=True, slots=True)
class Jump:
    """How new an image is, and whether the robot was carried since the last one.

    novelty: of the scene, 0 … 1, by the way. log_ratio: log p(edges that continue | carried) / p(… | not carried).
    """

    novelty: float
    log_ratio: float = 0.0

    def carried(self, chance: float) -> float:
        """Return the probability of having been carried, whose prior `chance` is that between two scenes."""
        odds = chance / (1.0 - chance) * np.exp(min(self.log_ratio, 100.0))
        return float(max(self.novelty * chance, odds / (1.0 + odds) if self.log_ratio > 0 else 0.0))


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """Images from those that are a whole scene back until now, oldest first.

    edges, continued: how many edges there were, and how many of them continued one of the image before; old ones fade.
    """

    images: tuple[SeenImage, ...] = ()
    edges: float = EDGES
    continued: float = CONTINUED * EDGES

    def followed(
        self, observation: PredictsScenes, motion: MotionModel, sighting: Sighting, increment: Increment
    ) -> tuple[Scene, Array, Jump]:
        """Return the scene with an image, the density of clutter at its edges (E,), and how new it is.

        increment: the motion since the last image.
        """
        images = tuple(SeenImage(one.sighting, one.since.then(increment)) for one in self.images)
        back = sum(_scenes(one.since) >= 1.0 for one in images)  # how many are a scene back
        images = images[max(back - WITH_OLDER, 0) :]

        def clutter(chosen: Sequence[SeenImage]) -> tuple[Array, float]:
            return observation.scene_clutter(sighting, [one.before(motion) for one in chosen])

        reference = min(back, WITH_OLDER)
        density, _ = clutter(images[max(reference, 1) - 1 :: -1] if images else [])
        jump, edges, continued = Jump(1.0), self.edges, self.continued
        if images:
            log_ratio, count = 0.0, len(sighting.edges)
            if count:
                again = clutter(images[-1:])[1] * count
                log_ratio = _log_carried(count, again, continued / edges)
                edges, continued = MEMORY * edges + count, MEMORY * continued + again
            jump = Jump(min(_scenes(increment), 1.0), log_ratio)
        if len(images) > 1 and _scenes(images[-2].since) < APART:
            images = images[:-1]
        if jump.log_ratio > WHOLLY_NEW:
            images = ()
        here = (SeenImage(sighting, Increment.from_mean(np.zeros(3))),) if len(sighting.edges) else ()
        return Scene((*images, *here), edges, continued), density, jump


def _log_carried(edges: int, continued: float, usual: float) -> float:
    """Return log p(n of E edges continue | carried) / p(n of E | not carried), both beta-binomial.

    usual: fraction that continues when the robot was not carried; afterwards as many do not. At ½ and below, edges come
    and go so often that they tell nothing.
    """
    a = CONCENTRATION * max(usual, 0.5)
    b = CONCENTRATION - a
    log_after = lgamma(continued + b) + lgamma(edges - continued + a)
    return log_after - lgamma(continued + a) - lgamma(edges - continued + b)


def _scenes(increment: Increment) -> float:
    return float(increment.path_m / SCENE_M + increment.turned_rad / SCENE_RAD)
