"""The sparse grid filter of benchmarks/observable.py against the plain one, which is an oracle of its own."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from types import ModuleType

import numpy as np
import pytest
from folders import ROOT
from grid_filter import GridFilter, headings
from simulated_edges import EdgeNoise, simulated_edges

from localiser.camera import Camera, Mount
from localiser.edges import Edges
from localiser.geometry import Increment, Trajectory, between, compose, wrap_angle
from localiser.landmarks import LandmarkMap
from localiser.motion import MotionParameters
from localiser.observation import EdgeObservation, ObservationParameters

CAMERA = Camera(640, 480, 554.0, 554.0, 319.5, 239.5, Mount(np.deg2rad(20), 0.9))


@pytest.fixture(scope="module")
def observable() -> Iterator[ModuleType]:
    path = str(ROOT / "benchmarks")
    sys.path.insert(0, path)
    import observable as module

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "MOST_SPLIT", 8_000)  # enough for a small world
        yield module
    sys.path.remove(path)


@pytest.mark.slow  # quick: the other tests of this file
def test_motion_is_that_of_the_plain_grid(observable: ModuleType) -> None:
    """Three moves, each far smaller than a cell of the heading, from the same Gaussian: mean and covariance."""
    x, z, heading = np.linspace(-2, 2, 81), np.linspace(-2, 2, 81), headings(120)
    mean, cov = np.array([0.1, 0.3, 3.1]), np.diag([0.02, 0.03, 0.01])
    plain = GridFilter.gaussian(x, z, heading, mean, cov)
    width = np.array([0.05, 0.05, heading[1] - heading[0]])
    likely = plain.p.ravel() > 1e-9
    masses = observable.Masses(plain.poses[likely], np.log(plain.p.ravel()[likely]), width)
    noise = np.array([[4e-4, 1e-4, 2e-4], [1e-4, 9e-4, 1e-4], [2e-4, 1e-4, 3e-3]])
    for _ in range(3):
        increment = Increment.from_mean([0.01, -0.12, 0.02])
        plain, masses = plain.predict(increment, noise), masses.moved(increment, noise)
    mass = masses.mass
    error = masses.poses - plain.mean
    error[:, 2] = wrap_angle(error[:, 2])
    np.testing.assert_allclose(mass @ error, 0, atol=2e-3)
    np.testing.assert_allclose((error.T * mass) @ error, plain.cov, atol=6e-4)


def world(count: int, seed: int = 0) -> LandmarkMap:
    points = np.random.default_rng(seed).uniform([-2.5, -2.5], [2.5, 2.5], (count, 2))
    return LandmarkMap.from_points(points, bottom_m=np.zeros(count), top_m=np.full(count, 2.0))


def driven(landmark_map: LandmarkMap, frames: int) -> tuple[Trajectory, list[Edges]]:
    """A circle in the middle of the world, and edges with clutter."""
    poses = [np.array([0.3, 0.5, 0.4])]
    for _ in range(frames - 1):
        poses.append(compose(poses[-1], np.array([0.0, -0.08, np.deg2rad(6)])))
    truth = Trajectory(np.arange(frames) * 200_000_000, np.array(poses))
    noise = EdgeNoise(clutter_per_frame=1.0, detection_probability=0.8)
    return truth, simulated_edges(landmark_map, CAMERA, truth, np.random.default_rng(1), noise=noise)


def test_place_is_found_from_nothing(observable: ModuleType) -> None:
    landmark_map = world(25)
    truth, frames = driven(landmark_map, 12)
    odometry = Trajectory(truth.t_ns, between(np.array([7.0, -3.0, 1.0]), truth.poses))
    observation = EdgeObservation(CAMERA, ObservationParameters())
    *_, last = observable.beliefs(observation, landmark_map, odometry, frames, MotionParameters())
    assert last.near() > 0.9
    best = last.poses[last.log_mass.argmax()]
    assert np.hypot(*(best - truth.poses[-1])[:2]) < 0.15
    assert abs(wrap_angle(best[2] - truth.poses[-1, 2])) < np.deg2rad(4)


def test_two_places_that_look_alike_are_not_observable(observable: ModuleType) -> None:
    """The same landmarks twice, far apart: no edge can tell, and half of the mass stays at either."""
    once = world(25)
    apart = np.array([33.6, 0.0])  # farther than a landmark is seen; 140 of the coarsest cells
    twice = LandmarkMap.from_points(
        np.concatenate([once.points, once.points + apart]), bottom_m=np.zeros(50), top_m=np.full(50, 2.0)
    )
    truth, frames = driven(once, 12)
    observation = EdgeObservation(CAMERA, ObservationParameters())
    *_, last = observable.beliefs(observation, twice, truth, frames, MotionParameters())
    assert 0.4 < last.near() < 0.6
