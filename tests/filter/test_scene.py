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
        scene, _, jump = scene.followed(OBSERVATION, MotionParameters(), image([-0.2, 0.0, 0.3]), increment)
        novelties.append(jump.novelty)
    return scene, novelties


@pytest.mark.parametrize("step_m", [0.0, 1e-4, 1e-3, 0.02])
def test_few_images_are_kept_however_slowly_the_robot_moves(step_m: float) -> None:
    scene, _ = driven(step_m, 500)
    assert len(scene.images) <= 2 / APART + 3
    if step_m * 500 > 2 * SCENE_M:
        assert SCENE_M <= (scene.moved.path_m - scene.images[0].moved.path_m) < SCENE_M * (1 + 3 * APART)


def test_an_image_is_as_new_as_the_way_is_long() -> None:
    _, novelties = driven(0.06, 10)
    assert novelties[0] == 1.0
    np.testing.assert_allclose(novelties[1:], 0.06 / SCENE_M)


@pytest.mark.parametrize(
    ("bearings", "least", "most"),
    [
        ([-0.2, 0.0, 0.3], 0.0, 3e-5),  # all continue
        ([], 3e-4, 3e-4),  # dark: what remains is the chance of being led astray
        ([0.12], 3e-4, 0.01),  # one new edge is hardly evidence
        ([-0.2, 0.0, 0.3, 0.12, 0.45], 1e-5, 5e-4),  # two come into view
        ([-0.5, -0.4, 0.12, 0.2, 0.45], 0.01, 0.2),
        ([-0.5, -0.45, -0.4, -0.35, -0.3, 0.12, 0.15, 0.2, 0.4, 0.45], 0.1, 0.6),
        ([*np.linspace(-0.6, -0.25, 15), *np.linspace(0.05, 0.25, 10), *np.linspace(0.35, 0.6, 15)], 0.5, 1.0),
    ],
)
def test_a_robot_was_carried_where_many_edges_continue_none(bearings: list[float], least: float, most: float) -> None:
    scene, _ = driven(0.06, 10)
    whole_scene = Increment.from_mean(np.array([0.0, -SCENE_M, 0.0]))
    found = scene.followed(OBSERVATION, MotionParameters(), image(bearings), whole_scene)[2]
    assert least * 0.999 <= found.carried(3e-4) <= most * 1.001
