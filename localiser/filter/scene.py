"""The scene: what an image shows beyond an image that was taken some way back.

Consecutive images show nearly the same edges. A wrong place that fits one of them by chance therefore fits the next
ones too. So the belief counts an image by the novelty of its scene, and compares each hypothesis with the clutter that
an earlier image predicts. The earlier image is the last one that was taken a whole scene back, 0.3 m or 12°: near
enough to show the same things, and far enough that the parallax of a landmark of known distance tells it from clutter
of unknown distance.

Edges that the image before does not explain are new, however little the wheels have turned: the robot was carried.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from localiser.geometry import Array, Increment
from localiser.motion import MotionModel, covariance_of
from localiser.observation import PredictsScenes, Sighting

SCENE_M, SCENE_RAD = 0.3, np.radians(12.0)
APART = 0.05  # scenes between the images that are kept, so that a robot that stands still keeps few
CONTINUED = 0.6  # how many edges at least continue those of the image before, unless the robot was carried


@dataclass(frozen=True, slots=True, eq=False)
class SeenImage:
    """An image and how the robot has moved since."""

    sighting: Sighting
    since: Increment


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """Images from the last one that is a whole scene back until now, oldest first."""

    images: tuple[SeenImage, ...] = ()

    def followed(
        self, observation: PredictsScenes, motion: MotionModel, sighting: Sighting, increment: Increment
    ) -> tuple[Scene, Array, float]:
        """Return the scene with an image, the density of clutter at its edges (E,), and its novelty, 0 … 1.

        increment: the motion since the last image.
        """
        images = tuple(SeenImage(one.sighting, one.since.then(increment)) for one in self.images)
        back = [index for index, one in enumerate(images) if _scenes(one.since) >= 1.0]
        images = images[back[-1] if back else 0 :]

        def clutter(one: SeenImage | None) -> tuple[Array, float]:
            since = increment if one is None else one.since
            turn_var = float(covariance_of(motion, since)[2, 2])
            before = None if one is None else one.sighting
            return observation.scene_clutter(sighting, before, since, turn_var)

        density, continued = clutter(images[0] if images else None)
        novelty = 1.0
        if images:
            continued = continued if len(images) == 1 else clutter(images[-1])[1]
            novelty = min(max(_scenes(increment), 1.0 - continued / CONTINUED), 1.0)
        if len(images) > 1 and _scenes(images[-2].since) < APART:
            images = images[:-1]
        here = SeenImage(sighting, Increment.from_mean(np.zeros(3)))
        return Scene((*images, here)), density, novelty


def _scenes(increment: Increment) -> float:
    return float(increment.path_m / SCENE_M + increment.turned_rad / SCENE_RAD)
