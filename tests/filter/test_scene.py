"""The scene: how much of it is new, and how many images of it are kept."""

from __future__ import annotations

import numpy as np
import pytest
from proposal_room import CAMERA

from localiser.edges import Edges
from localiser.filter.scene import APART, SCENE_M, Scene
from localiser.geometry import Increment
from localiser.motion import MotionParameters
from localiser.observation import EdgeObservation, ObservationParameters, Sighting

OBSERVATION = EdgeObservation(CAMERA, ObservationParameters())


def image(bearings: list[float], t_ns: int = 0) -> Sighting:
    angle = np.array(bearings)
    return Sighting(t_ns, Edges.from_columns(angle, np.full(len(angle), 0.002), angle, np.full(len(angle), 0.002)))


def driven(step_m: float, images: int) -> tuple[Scene, list[float]]:
    """Return the scene after so many images of the same edges, and the novelty of each."""
    scene, novelties = Scene(), []
    for index in range(images):
        increment = Increment.from_mean([0.0, -step_m if index else 0.0, 0.0])
        scene, _, novelty = scene.followed(OBSERVATION, MotionParameters(), image([-0.2, 0.0, 0.3]), increment)
        novelties.append(novelty)
    return scene, novelties


@pytest.mark.parametrize("step_m", [0.0, 1e-4, 1e-3, 0.02])
def test_few_images_are_kept_however_slowly_the_robot_moves(step_m: float) -> None:
    scene, _ = driven(step_m, 500)
    assert len(scene.images) <= 2 / APART + 3
    if step_m * 500 > 2 * SCENE_M:
        assert SCENE_M <= scene.images[0].since.path_m < SCENE_M * (1 + 2 * APART)


def test_an_image_is_as_new_as_the_way_is_long_and_wholly_new_where_nothing_continues() -> None:
    scene, novelties = driven(0.06, 10)
    assert novelties[0] == 1.0
    np.testing.assert_allclose(novelties[1:], 0.06 / SCENE_M)
    elsewhere = image([-0.5, 0.12, 0.45])
    still = Increment.from_mean(np.zeros(3))
    assert scene.followed(OBSERVATION, MotionParameters(), elsewhere, still)[2] > 0.9
