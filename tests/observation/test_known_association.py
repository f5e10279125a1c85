"""Edges that say which landmark they belong to: the density by hand, and what it is worth."""

from dataclasses import replace

import numpy as np
import pytest

from localiser import geometry, particles
from localiser.camera import Camera, Mount
from localiser.edges import Edges, complete
from localiser.geometry import Array
from localiser.landmarks import LandmarkMap
from localiser.observation import EdgeObservation, ObservationParameters, Sighting
from localiser.observation.inlier_rate import INLIER_RATES
from localiser.particles import POSE, Particles

CAMERA = Camera(640, 480, 554.0, 554.0, 319.5, 239.5, Mount(np.radians(20), 0.9, back_m=-0.1))
POINTS = np.array([[-1.2, -4.0], [-1.0, -4.1], [0.5, -4.5], [1.3, -5.0]])
MAP = LandmarkMap.from_points(POINTS)
SIGMA = np.radians(0.5)


def bearings(pose: Array, points: Array) -> Array:
    x, z = geometry.robot_from_map(CAMERA.pose_in_map(pose), points).T
    return np.arctan2(x, -z)


def edges_at(pose: Array, landmark: list[int], seen: Array | None = None) -> Edges:
    bearing = bearings(pose, POINTS[landmark] if seen is None else seen)
    nothing = np.full(len(bearing), np.nan)
    columns = complete(bearing, np.full(len(bearing), SIGMA), nothing, nothing, CAMERA.mount.tilt_rad)
    return Edges.from_columns(*columns, landmark_id=np.array(landmark))


def observation(kind: str = "line") -> EdgeObservation:
    return EdgeObservation(CAMERA, ObservationParameters(kind=kind, association="known"))  # type: ignore[arg-type]


def cloud(*poses: Array) -> Particles:
    return Particles(POSE, np.array(poses).T.copy(), np.zeros(len(poses)))


@pytest.mark.parametrize("kind", ["line", "slope"])
def test_density_is_that_of_the_named_landmark_or_clutter(kind: str) -> None:
    truth, other = np.array([0.1, 0.0, 0.02]), np.array([0.12, 0.05, 0.025])
    edges = edges_at(truth, [0, 3])
    found = observation(kind).by_rate(cloud(truth, other), Sighting(0, edges), MAP)
    s = np.sin(CAMERA.mount.tilt_rad)
    measured = edges.bearing if kind == "line" else edges.lean
    sigma = edges.bearing_sigma if kind == "line" else edges.lean_sigma
    span = observation(kind).frame(edges).span_rad
    for column, pose in enumerate((truth, other)):
        bearing = bearings(pose, POINTS[[0, 3]])
        distance = np.hypot(*(POINTS[[0, 3]] - CAMERA.pose_in_map(pose)[:2]).T)
        predicted, slope = (bearing, 1.0) if kind == "line" else (np.arctan(s * np.tan(bearing)), None)
        if slope is None:
            step = 1e-6
            slope = (np.arctan(s * np.tan(bearing + step)) - np.arctan(s * np.tan(bearing - step))) / (2 * step)
        var = sigma**2 + (slope * 0.006 / distance) ** 2
        density = np.exp(-0.5 * (measured - predicted) ** 2 / var) / np.sqrt(2 * np.pi * var)
        expected = [np.log((1 - w) + w * density * span).sum() for w in INLIER_RATES]
        np.testing.assert_allclose(found[:, column], expected, rtol=1e-6, atol=1e-6)


def test_a_neighbour_that_would_fit_better_does_not_count() -> None:
    """Landmarks 0 and 1 stand 0.22 m apart: a pose from where 1 is seen where 0 was is no better for it."""
    truth = np.array([0.0, 0.0, 0.0])
    shifted = np.array([*(POINTS[1] - POINTS[0]), 0.0])
    edges = edges_at(truth, [0])
    known, unknown = (
        one.log_likelihood(cloud(truth, shifted), Sighting(0, edges), MAP)
        for one in (observation(), EdgeObservation(CAMERA, ObservationParameters()))
    )
    assert known[0] - known[1] > 2.0
    assert abs(unknown[0] - unknown[1]) < 0.5


def test_edges_of_no_landmark_and_landmarks_behind_tell_nothing() -> None:
    truth = np.array([0.0, 0.0, 0.0])
    clutter = edges_at(truth, [-1, -1], seen=np.array([[0.3, -3.0], [-0.4, -2.0]]))
    np.testing.assert_array_equal(observation().by_rate(cloud(truth), Sighting(0, clutter), MAP), 0.0)
    away = np.array([0.0, -8.0, 0.0])  # all landmarks behind: each edge can only be clutter
    found = observation().by_rate(cloud(away), Sighting(0, edges_at(truth, [0, 2])), MAP)[:, 0]
    np.testing.assert_allclose(found, 2 * np.log1p(-INLIER_RATES))


def test_the_cameras_own_yaw_counts() -> None:
    truth, yaw = np.array([0.0, 0.0, 0.1]), 0.03
    edges = edges_at(truth + np.array([0, 0, yaw]), [0, 2, 3])
    edges = replace(edges, bearing=bearings(truth, POINTS[[0, 2, 3]]) + yaw)
    with_yaw = Particles((*POSE, "camera_yaw"), np.array([[*truth, yaw]]).T, np.zeros(1))
    right, wrong = (observation().log_likelihood(one, Sighting(0, edges), MAP)[0] for one in (with_yaw, cloud(truth)))
    assert right > wrong + 10


def test_matches_are_those_that_the_edges_name() -> None:
    truth = np.array([0.0, 0.0, 0.0])
    edges = edges_at(truth, [2, -1, 0], seen=POINTS[[2, 1, 0]])
    matches = observation().associate(truth, Sighting(0, edges), MAP).matches()
    np.testing.assert_array_equal(matches.landmark, [2, -1, 0])
    np.testing.assert_allclose(matches.residual, [0, np.nan, 0], atol=2e-8)  # of the loop's arctangent
    assert matches.visible.all()


def test_a_pose_is_found_among_lookalikes() -> None:
    truth = np.array([0.2, -0.3, 0.05])
    rng = np.random.default_rng(0)
    start = particles.from_gaussian(truth + np.array([0.2, -0.1, 0.05]), np.diag([0.3, 0.3, 0.1]) ** 2, 20_000, rng)
    log_likelihood = observation().log_likelihood(start, Sighting(0, edges_at(truth, [0, 1, 2, 3])), MAP)
    found = replace(start, log_weight=log_likelihood).estimate
    error = found.pose - truth
    assert (np.abs(error) < 3 * np.sqrt(np.diag(found.pose_cov))).all()
