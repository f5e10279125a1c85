"""The belief: a right place is not left for one that looks the same and has nothing to hide."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from simulated_edges import EdgeNoise, simulated_edges

from localiser import Localiser, LocatedFrame, read_config
from localiser.camera import Camera, Mount
from localiser.filter.belief import Belief
from localiser.geometry import Trajectory
from localiser.landmarks import LandmarkMap
from localiser.relocalisation import Candidates

CAMERA = Camera(640, 480, 554.0, 554.0, 319.5, 239.5, Mount(np.radians(20), 0.9))
STEP_M, STEP_NS, IMAGES = 0.1, 200_000_000, 60
START = np.diag([0.1, 0.1, np.radians(3.0)]) ** 2


@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (1, 2))])
def test_hidden_landmarks_do_not_speak_for_a_place_that_has_none(seed: int) -> None:
    """A robot drives down a corridor with rooms behind its walls; at its copy, 40 m away, there are none.

    Both explain all that is seen. What the copy gains while nobody knows what is hidden, is soon over.
    """
    rng = np.random.default_rng(seed)
    shown = np.stack([np.tile([-1.0, 1.0], 8) + rng.normal(0, 0.1, 16), -rng.uniform(2, 12, 16)], axis=-1)
    side = np.tile([-1.0, 1.0], 12)
    hidden = np.stack([side * rng.uniform(1.3, 5.0, 24), -rng.uniform(2, 14, 24)], axis=-1)
    points = np.concatenate([shown, hidden, np.add(shown, [40.0, 0.0])])
    landmark_map = LandmarkMap.from_points(points, bottom_m=np.zeros(len(points)), top_m=np.full(len(points), 2.0))
    poses = np.stack([np.zeros(IMAGES), -STEP_M * np.arange(IMAGES), np.zeros(IMAGES)], axis=-1)
    truth = Trajectory(STEP_NS * np.arange(1, IMAGES + 1), poses)
    visible = np.tile(np.arange(len(points)) < len(shown), (IMAGES, 1))
    noise = EdgeNoise(detection_probability=0.85, clutter_per_frame=3.0)
    images = simulated_edges(landmark_map, CAMERA, truth, rng, noise=noise, visible=visible)
    robot = Localiser(landmark_map, CAMERA, read_config(None, ["observation.kind=line"]), seed)
    robot.start(poses[0], START, 0)
    assert robot.state.particles is not None
    there = replace(robot.state.particles, columns=robot.state.particles.columns.copy())
    there.columns[0] += 40.0
    robot.state.belief = Belief(0.99, 0.01, 0.0, 0.0, candidates=Candidates.unknown(there))
    robot.odometry(0, poses[0])
    for t_ns, pose, edges in zip(truth.t_ns, poses, images, strict=True):
        robot.edges(int(t_ns), edges)
        for frame in robot.odometry(int(t_ns), pose):
            assert np.hypot(*(frame.located.estimate.pose - pose)[:2]) < 0.5
    assert frame.located.p_correct > 0.9


def drive_with_a_wrong_map(seed: int, most_edges: int, images: int = 100) -> list[LocatedFrame]:
    """Return what a robot says in a corridor 2 m wide with the map of one 3 m wide."""
    rng = np.random.default_rng(seed)
    here, other = (
        np.stack([np.tile([-width / 2, width / 2], 16) + rng.normal(0, 0.1, 32), -rng.uniform(1, 24, 32)], axis=-1)
        for width in (2.0, 3.0)
    )
    maps = [LandmarkMap.from_points(one, bottom_m=np.zeros(32), top_m=np.full(32, 2.0)) for one in (here, other)]
    poses = np.stack([np.zeros(images), -STEP_M * np.arange(images), np.zeros(images)], axis=-1)
    truth = Trajectory(STEP_NS * np.arange(1, images + 1), poses)
    seen = simulated_edges(maps[0], CAMERA, truth, rng, noise=EdgeNoise(clutter_per_frame=3.0))
    robot = Localiser(maps[1], CAMERA, read_config(None, ["observation.kind=line"]), 0)
    robot.start(poses[0], START, 0)
    robot.odometry(0, poses[0])
    frames = []
    for t_ns, pose, edges in zip(truth.t_ns, poses, seen, strict=True):
        robot.edges(int(t_ns), edges.take(np.arange(len(edges)) < most_edges))
        frames += robot.odometry(int(t_ns), pose)
    return frames


@pytest.mark.slow
@pytest.mark.parametrize("most", [4, 100])
def test_a_map_is_said_not_to_fit_by_images_with_enough_edges_alone(most: int) -> None:
    """Where a robot sees few edges, they may be anything."""
    located = [frame.located for frame in drive_with_a_wrong_map(0, most)]
    assert located[-1].p_correct < 0.2
    assert (located[-1].warning == "this map does not fit") == (most > 4)
