"""The scene: what an image shows beyond an image that was taken some way back (docs/belief.md).

The belief compares each hypothesis with the clutter that the last image a whole scene back predicts. It is near enough
to show the same, and far enough that parallax tells landmarks of known distance from clutter of unknown distance.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from localiser.filter.motion_hypotheses import Jump, log_carried
from localiser.geometry import Array, Increment
from localiser.motion import MotionModel, covariance_of
from localiser.observation import SEEN_AGAIN, EarlierFrame, EdgeObservation, Sighting, scene_clutter

SCENE_M, SCENE_RAD = 0.3, np.radians(12.0)
APART = 0.05  # scenes between the images that are kept, so that a robot that stands still keeps few
WITH_OLDER = 2  # images a scene back that are compared with: an edge that the last of them missed is in the one before
WHOLLY_NEW = 4.0  # log-ratio of having been carried from which on the images before are of another scene
USUAL_MEMORY = 0.95  # part of the usual fraction that an image leaves


@dataclass(frozen=True, slots=True, eq=False)
class SeenImage:
    """An image, and how the robot had moved until it, from where the scene began."""

    sighting: Sighting
    moved: Increment


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
                log_ratio, log_fit, fraction = log_carried(continuing, usual)
                usual = USUAL_MEMORY * usual + (1.0 - USUAL_MEMORY) * fraction
            novelty = increment.path_m / SCENE_M + increment.turned_rad / SCENE_RAD
            jump = Jump(float(min(novelty, 1.0)), log_ratio, float(increment.path_m), log_fit)
        if len(images) > 1 and away[-2] < APART:
            images = images[:-1]
        if jump.log_ratio > WHOLLY_NEW:
            images = ()
        here = (SeenImage(sighting, now),) if len(sighting.edges) else ()
        return Scene((*images, *here), usual, now), density, jump
