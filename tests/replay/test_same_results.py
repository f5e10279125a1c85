"""What a run locates does not depend on by how many threads its particles are weighed."""

from __future__ import annotations

import numpy as np
import pytest

from localiser.camera import Camera, Mount
from localiser.edges import Edges
from localiser.filter import Event, FilterState, Located, Mcl, MclParameters, Odometry, Sighting, Start, step
from localiser.geometry import Trajectory, arc_motion, compose
from localiser.landmarks import LandmarkMap, sight
from localiser.observation import EdgeObservation, ObservationParameters, likelihood

SECOND = 1_000_000_000
CAMERA = Camera(640, 480, 554.0, 554.0, 319.5, 239.5, Mount(np.radians(20), 0.9))
SIGMA_RAD = np.radians(0.3)
PRIOR = np.diag([0.2, 0.2, 0.05]) ** 2


def drive(images: int) -> tuple[LandmarkMap, list[Event]]:
    """A curve among 40 landmarks, five images a second, wheels off by a tenth, a third of the edges false."""
    rng = np.random.default_rng(4)
    landmark_map = LandmarkMap.from_points(rng.uniform(-6, 6, (40, 2)))
    pose, wheels = np.zeros(3), np.zeros(3)
    events: list[Event] = [Start(0, pose, PRIOR), Odometry(0, wheels)]
    for k in range(1, images + 1):
        pose = compose(pose, arc_motion(np.array([0.0, -0.1]), 0.05, 1.0))
        wheels = compose(wheels, arc_motion(np.array([0.0, -0.11]), 0.045, 1.0))
        bearing = np.arctan(sight(CAMERA, pose[None], landmark_map).tangent)
        bearing = np.append(bearing + rng.normal(0, SIGMA_RAD, len(bearing)), rng.uniform(-0.5, 0.5, 5))
        nothing = np.full(len(bearing), np.nan)
        edges = Edges.from_columns(bearing, np.full(len(bearing), SIGMA_RAD), nothing, nothing)
        events += [Odometry(k * SECOND // 5, wheels), Sighting(k * SECOND // 5, edges)]
    return landmark_map, events


def run(observation: EdgeObservation, images: int, particles: int, seed: int) -> list[Located]:
    landmark_map, events = drive(images)
    mcl = Mcl(landmark_map, observation, MclParameters(particles=particles, start_particles=particles))
    rng, state = np.random.default_rng(seed), FilterState()
    return [located for event in events for located in step(mcl, state, event, rng)]


def trajectory(found: list[Located]) -> Trajectory:
    return Trajectory(np.array([one.t_ns for one in found]), np.array([one.estimate.pose for one in found]))


def test_one_or_two_threads_give_the_same_bytes_of_trajectory(monkeypatch: pytest.MonkeyPatch) -> None:
    pools: list[int] = []
    pool = likelihood.ThreadPoolExecutor
    monkeypatch.setattr(likelihood, "ThreadPoolExecutor", lambda workers: pools.append(workers) or pool(workers))
    one, two = (
        trajectory(run(EdgeObservation(CAMERA, ObservationParameters(threads=threads)), 8, 10_000, 0))
        for threads in (1, 2)
    )
    assert pools and set(pools) == {2}, "the work was shared"
    assert len(one) == 8
    assert one.poses.tobytes() == two.poses.tobytes()
