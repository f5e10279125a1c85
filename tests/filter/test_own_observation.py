"""A filter with an observation and a motion model that it does not know: range and bearing to tags."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from localiser.filter import FilterState, Located, Mcl, MclParameters, Odometry, Sighting, Start, finish, step
from localiser.geometry import Array, Increment, compose, robot_from_map, wrap_angle
from localiser.landmarks import LandmarkMap
from localiser.motion import LinearisedMotion, MotionModel, MotionParameters
from localiser.observation import EdgeObservation, Observation
from localiser.particles import Particles

TAGS = LandmarkMap.from_points(np.array([[-2.0, -3.0], [2.5, -4.0], [0.5, -7.0], [-3.0, 1.0]]))
SIGMA_M, SIGMA_RAD = 0.1, 0.03
STEP = np.array([0.0, -0.2, 0.06])
SECOND = 1_000_000_000


@dataclass(frozen=True)
class RangeAndBearing:
    """The measurement is (K, 3): index of a tag, its range (m) and its bearing (rad) in the robot frame."""

    def log_likelihood(self, particles: Particles, sighting: Sighting, landmark_map: LandmarkMap) -> Array:
        assert sighting.measurement is not None
        tag, range_m, bearing = sighting.measurement.T
        seen = robot_from_map(particles.poses[:, None], landmark_map.points[tag.astype(int)])
        off_m = (np.hypot(seen[..., 0], seen[..., 1]) - range_m) / SIGMA_M
        off_rad = wrap_angle(np.arctan2(seen[..., 0], -seen[..., 1]) - bearing) / SIGMA_RAD
        return np.asarray(-0.5 * (off_m**2 + off_rad**2).sum(axis=1))


@dataclass(frozen=True)
class OdometryWithNoise:
    """A motion model that can predict and nothing else."""

    sigma: float = 0.02

    def predict(self, particles: Particles, increment: Increment, rng: np.random.Generator) -> Particles:
        moves = increment.mean + self.sigma * rng.standard_normal((len(particles), 3)) * [1.0, 1.0, 0.3]
        columns = particles.columns.copy()
        columns[:3] = compose(particles.poses, moves).T
        return Particles(particles.names, columns, particles.log_weight)


def drive(count: int) -> tuple[Array, list[Odometry | Sighting]]:
    """Return the true poses (T, 3), and the events of a drive."""
    rng, poses, events = np.random.default_rng(4), [np.array([0.2, 0.1, 0.05])], []
    for _ in range(count - 1):
        poses.append(compose(poses[-1], STEP))
    for number, pose in enumerate(poses):
        seen = robot_from_map(pose, TAGS.points)
        measured = np.stack([np.hypot(*seen.T), np.arctan2(seen[:, 0], -seen[:, 1])], axis=-1)
        measured += rng.standard_normal(measured.shape) * [SIGMA_M, SIGMA_RAD]
        events.append(Odometry(number * SECOND, compose(np.array([5.0, 6.0, 1.0]), pose)))
        events.append(Sighting(number * SECOND, measurement=np.column_stack([np.arange(len(TAGS)), measured])))
    return np.array(poses), events


def located(mcl: Mcl, events: list[Odometry | Sighting]) -> list[Located]:
    state, rng = FilterState(), np.random.default_rng(0)
    start = Start(0, np.zeros(3), np.diag([0.5, 0.5, 0.2]) ** 2)
    found = [each for event in [start, *events] for each in step(mcl, state, event, rng)]
    return found + list(finish(mcl, state, rng))


def test_an_observation_needs_a_log_likelihood_and_nothing_else() -> None:
    own = RangeAndBearing()
    assert isinstance(own, Observation)
    assert not isinstance(own, EdgeObservation)
    truth, events = drive(30)
    found = located(Mcl(TAGS, own, MclParameters(particles=1000)), events)
    error = np.array([one.estimate.pose for one in found]) - truth
    assert np.hypot(*error[5:, :2].T).max() < 0.15
    assert found[-1].reason == ""
    assert found[-1].matches.landmark.tolist() == []


def test_a_motion_model_needs_to_predict_and_nothing_else() -> None:
    own = OdometryWithNoise()
    assert isinstance(own, MotionModel) and not isinstance(own, LinearisedMotion)
    truth, events = drive(30)
    found = located(Mcl(TAGS, RangeAndBearing(), MclParameters(particles=1000), own), events)
    error = np.array([one.estimate.pose for one in found]) - truth
    assert np.hypot(*error[5:, :2].T).max() < 0.15
    assert found[-1].estimate.names == ("x", "z", "heading")


def test_the_motion_model_that_ships_runs_with_an_observation_that_it_does_not_know() -> None:
    truth, events = drive(10)
    model = MotionParameters()
    assert isinstance(model, MotionModel)
    found = located(Mcl(TAGS, RangeAndBearing(), MclParameters(particles=1000), model), events)
    assert np.hypot(*(found[-1].estimate.pose - truth[-1])[:2]) < 0.15
