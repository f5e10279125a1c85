"""The posterior Cramér-Rao bound, against closed forms and against an estimator that attains it."""

import numpy as np
import pytest
from efficiency import bearing_information, efficiency, information, posterior_bound

from localiser import geometry
from localiser.camera import Camera, Mount
from localiser.edges import CommonError, Edges
from localiser.geometry import Array

TILT = np.radians(20)
CAMERA = Camera(640, 480, 554, 554, 319.5, 239.5, Mount(TILT, 0.8, yaw_rad=0.1, right_m=0.05, back_m=-0.15))


def linear_kalman(prior: Array, transition: Array, noise: Array, jacobian: Array, sigma: Array) -> Array:
    """Covariances of the textbook Kalman filter with its gain, scalar measurement by scalar measurement."""
    cov, result = prior, []
    for t in range(len(jacobian)):
        if t:
            cov = transition[t - 1] @ cov @ transition[t - 1].T + noise[t - 1]
        for row, s in zip(jacobian[t], sigma[t], strict=True):
            gain = cov @ row / (row @ cov @ row + s**2)
            cov = (np.eye(3) - np.outer(gain, row)) @ cov
        result.append(cov)
    return np.array(result)


def random_system(seed: int, steps: int = 25, measurements: int = 4) -> tuple[Array, Array, Array, Array, Array]:
    rng = np.random.default_rng(seed)
    transition = np.eye(3) + 0.2 * rng.normal(size=(steps - 1, 3, 3))
    root = 0.1 * rng.normal(size=(steps - 1, 3, 3))
    prior_root = rng.normal(size=(3, 3))
    jacobian, sigma = rng.normal(size=(steps, measurements, 3)), rng.uniform(0.05, 0.5, (steps, measurements))
    return prior_root @ prior_root.T, transition, root @ root.transpose(0, 2, 1), jacobian, sigma


@pytest.mark.parametrize("seed", range(5))
def test_bound_of_a_linear_system_is_the_kalman_filter(seed: int) -> None:
    prior, transition, noise, jacobian, sigma = random_system(seed)
    gained = np.array([information(h, s) for h, s in zip(jacobian, sigma, strict=True)])
    expected = linear_kalman(prior, transition, noise, jacobian, sigma)
    np.testing.assert_allclose(posterior_bound(prior, transition, noise, gained), expected, rtol=1e-8, atol=1e-12)


def test_no_motion_noise_no_measurement_and_a_known_start() -> None:
    """Singular everywhere: the bound stays finite, symmetric and not negative."""
    still, nothing = np.tile(np.eye(3), (3, 1, 1)), np.zeros((4, 3, 3))
    prior = np.diag([0.01, 0.04, 0.0])
    np.testing.assert_allclose(posterior_bound(prior, still, nothing[1:], nothing), np.tile(prior, (4, 1, 1)))
    certain = posterior_bound(np.zeros((3, 3)), still, nothing[1:], np.tile(np.eye(3) * 1e9, (4, 1, 1)))
    np.testing.assert_array_equal(certain, 0)
    one_direction = np.diag([1e12, 0.0, 0.0])
    bound = posterior_bound(prior, still, nothing[1:], np.tile(one_direction, (4, 1, 1)))
    np.testing.assert_allclose(np.linalg.eigvalsh(bound[-1]), [0, 2.5e-13, 0.04], atol=1e-15)


def edges_of(pose: Array, points: Array, **changes: Array) -> Edges:
    camera_pose = CAMERA.pose_in_map(pose)
    seen = geometry.robot_from_map(camera_pose, points)
    b = np.arctan2(seen[:, 0], -seen[:, 1])
    count = len(points)
    from_lean, from_line = CAMERA.bearing_jacobians(b, np.zeros(count))
    common = CommonError(("tilt", "roll"), np.diag([0.01**2, 0.01**2]), from_lean, from_line)
    columns = {
        "bearing": b,
        "bearing_sigma": np.full(count, 0.001),
        "lean": geometry.lean_from_bearing(b, TILT),
        "lean_sigma": np.full(count, 0.004),
        "landmark_id": np.arange(count),
        "common": common,
        **changes,
    }
    return Edges.from_columns(**columns)  # type: ignore[arg-type]


POSE = np.array([0.2, 0.3, 0.1])
POINTS = np.array([[-1.0, -4.0], [0.5, -3.0], [1.5, -5.0], [0.0, -6.0]])


def test_slope_tells_less_than_line_by_their_sigmas() -> None:
    edges = edges_of(POSE, POINTS)
    per_lean = geometry.bearing_per_lean(edges.bearing, TILT)
    step = 1e-6 * np.eye(3)
    jacobian = (
        np.stack([edges_of(POSE + d, POINTS).bearing - edges_of(POSE - d, POINTS).bearing for d in step], -1) / 2e-6
    )
    slope = bearing_information(POSE, CAMERA, POINTS, edges, "slope")
    np.testing.assert_allclose(slope, jacobian.T @ np.diag((0.004 * per_lean) ** -2) @ jacobian, rtol=1e-6)
    line = bearing_information(POSE, CAMERA, POINTS, edges, "line")
    np.testing.assert_allclose(line, jacobian.T @ jacobian / 0.001**2, rtol=1e-6)


def test_clutter_tells_nothing() -> None:
    known = edges_of(POSE, POINTS[:3])
    ids = np.array([0, 1, 2, -1])
    with_clutter = edges_of(POSE, POINTS, landmark_id=ids)
    np.testing.assert_allclose(
        bearing_information(POSE, CAMERA, POINTS, with_clutter, "line"),
        bearing_information(POSE, CAMERA, POINTS[:3], known, "line"),
    )
    assert not bearing_information(POSE, CAMERA, POINTS, Edges.none(), "slope").any()


# -- RMSE over the bound, with its bootstrap interval -----------------------------------------------------------------


def rayleigh(rng: np.random.Generator, seeds: int, bound_m: np.ndarray, factor: float = 1.0) -> np.ndarray:
    """Errors of an estimator whose RMS distance is `factor` times the bound; one draw a seed, so fully correlated."""
    return factor * bound_m * np.hypot(*rng.standard_normal((2, seeds, 1))) / np.sqrt(2)


def test_interval_covers_the_truth_as_often_as_it_says() -> None:
    """Frames of one run are as correlated as can be: an interval from single frames would be far too narrow."""
    rng, bound_m = np.random.default_rng(1), np.linspace(0.02, 0.1, 30)
    results = [efficiency(rayleigh(rng, 60, bound_m, 1.2), bound_m, rng, resamples=500) for _ in range(200)]
    assert 0.88 <= np.mean([r.low <= 1.2 <= r.high for r in results]) <= 0.98
    assert all(r.low < r.value < r.high for r in results)


def test_bounds_may_differ_between_seeds() -> None:
    rng = np.random.default_rng(2)
    bound_m = rng.uniform(0.01, 0.1, (300, 20))
    result = efficiency(bound_m.copy(), bound_m, rng)
    assert result.value == result.low == result.high == pytest.approx(1.0)


def test_a_run_that_broke_off_is_not_averaged_away() -> None:
    with pytest.raises(ValueError, match="finite"):
        efficiency(np.array([[0.1, np.nan]]), np.ones(2), np.random.default_rng(0))
