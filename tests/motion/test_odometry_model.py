"""The motion model: what `predict` draws is what its docstring states, and what `linearised` says of it."""

import tracemalloc

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from localiser.geometry import Array, Increment, arc_motion, compose, wrap_angle
from localiser.motion import MotionParameters, covariance_of, linearised, noise_variances, up_of
from localiser.motion.inertial import GRAVITY_M_S2
from localiser.motion.odometry_model import SLIP
from localiser.particles import POSE, Particles

PARAMETERS = MotionParameters(alpha1=1.2e-3, alpha2=7e-4, alpha3=9e-4, alpha4=1e-4)
NO_NOISE = MotionParameters(0.0, 0.0, 0.0, 0.0)
COUNT = 200_000
START = np.array([1.0, -2.0, 0.7])
MOTIONS = {
    "ahead": [0.0, -0.5, 0.0],
    "back": [0.0, 0.4, 0.1],
    "arc": [-0.05, -0.4, 0.25],
    "sideways": [0.3, 0.0, 0.0],
    "turn on the spot": [0.0, 0.0, -1.2],
}


def at(pose: Array, count: int = COUNT) -> Particles:
    return Particles(POSE, np.tile(pose[:, None], (1, count)), np.zeros(count))


def moments(particles: Particles, centre: Array) -> tuple[Array, Array]:
    """Mean and covariance of the error about `centre`, headings wrapped."""
    error = particles.poses - centre
    error[:, 2] = wrap_angle(error[:, 2])
    return error.mean(axis=0), np.cov(error.T)


def assert_same_covariance(found: Array, expected: Array, slack: float) -> None:
    """Assert equality within 5 standard errors of a sample covariance, √((Σij² + Σii Σjj)/N), and what is not linear.

    That is `slack` of the scale, and, where the linear model has no noise at all, distance noise turned by turn noise.
    """
    scale = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
    turned = np.zeros((3, 3))
    turned[:2, :2] = 2 * expected[2, 2] * np.trace(expected[:2, :2])
    tolerance = 5 * np.sqrt((expected**2 + scale**2) / COUNT) + slack * scale + turned + 1e-14
    tolerance[2, :2] = tolerance[:2, 2] = tolerance[:2, 2] + 5 * np.sqrt(turned[0, 0] * expected[2, 2] / COUNT)
    assert (np.abs(found - expected) <= tolerance).all(), f"\n{found}\n{expected}\n{tolerance}"


@pytest.mark.parametrize("motion", MOTIONS.values(), ids=MOTIONS.keys())
@pytest.mark.parametrize("heading", [0.7, np.pi - 1e-3])
def test_mean_and_covariance_are_those_of_the_linearised_model(motion: list[float], heading: float) -> None:
    """5 standard errors; turn noise of 1 to 4 % of a radian bends the cloud by less than 1 % of its size."""
    start, increment = np.array([1.0, -2.0, heading]), Increment.from_mean(motion)
    after = PARAMETERS.predict(at(start), increment, np.random.default_rng(1))
    mean, cov = moments(after, compose(start, increment.mean))
    _, expected = linearised(start, increment, PARAMETERS)
    bend = np.trace(expected[2:, 2:]) * np.hypot(*motion[:2])
    assert (np.abs(mean) <= 5 * np.sqrt(np.diag(expected) / COUNT) + bend).all()
    assert_same_covariance(cov, expected, slack=0.01)
    assert (np.abs(after["heading"]) <= np.pi).all()


def test_variances_are_those_stated_per_metre_and_per_radian() -> None:
    increment = Increment(np.array([0.0, -1.0, 0.2]), np.zeros((3, 3)), path_m=3.0, turned_rad=0.5)
    distance, turn = noise_variances(increment, MotionParameters(0.1, 0.2, 0.3, 0.4))
    assert distance == pytest.approx(0.3 * 3.0 + 0.4 * 0.5) and turn == pytest.approx(0.1 * 0.5 + 0.2 * 3.0)


def test_a_robot_that_drives_straight_errs_along_its_way_and_sideways_by_half_its_turn() -> None:
    """By hand, 4 m ahead, facing map -z: var x = (4 m)² · half the turn, cov(x, heading) = -4 m · half the turn."""
    increment = Increment.from_mean([0.0, -4.0, 0.0])
    _, cov = linearised(np.zeros(3), increment, PARAMETERS)
    turn = 4 * PARAMETERS.alpha2
    slip = SLIP**2 * 4 * PARAMETERS.alpha3
    expected = [[16 * turn / 2 + slip, 0, -4 * turn / 2], [0, 4 * PARAMETERS.alpha3, 0], [-4 * turn / 2, 0, turn]]
    np.testing.assert_allclose(cov, expected, atol=1e-15)


@pytest.mark.parametrize("pieces", [2, 10, 100])
@pytest.mark.parametrize("turn", [0.0, 0.4])
def test_cutting_the_path_adds_up_to_the_same_variance_of_heading_and_distance(pieces: int, turn: float) -> None:
    """Exactly for heading; what it does to the position lies between the whole step's and the random walk's."""
    velocity = np.array([0.0, -2.0])
    whole = Increment.from_mean(arc_motion(velocity, turn, 1.0))
    piece = Increment.from_mean(arc_motion(velocity, turn / pieces, 1 / pieces))
    pose, cov = START.copy(), np.zeros((3, 3))
    for _ in range(pieces):
        transition, noise = linearised(pose, piece, PARAMETERS)
        cov = transition @ cov @ transition.T + noise
        pose = compose(pose, piece.mean)
    np.testing.assert_allclose(pose, compose(START, whole.mean), atol=1e-12)
    _, at_once = linearised(START, whole, PARAMETERS)
    # The chord of a 0.4 rad arc is 0.7 % shorter than the arc.
    assert cov[2, 2] == pytest.approx(at_once[2, 2], rel=0.007)
    along = np.array([-np.sin(START[2] + turn / 2), -np.cos(START[2] + turn / 2), 0.0])
    across = np.array([along[1], -along[0], 0.0])
    assert along @ cov @ along == pytest.approx(along @ at_once @ along, rel=0.03)
    assert across @ cov @ np.array([0, 0, 1.0]) == pytest.approx(across @ at_once @ np.array([0, 0, 1.0]), rel=0.03)
    # A heading error that is spread over the way swings the end by L²/3 of its variance, two halves by L²/2.
    ratio = (across @ cov @ across) / (across @ at_once @ across)
    assert ratio == pytest.approx(2 / 3 * (1 + 1 / (2 * pieces**2)), rel=0.05)


def test_a_robot_that_went_to_and_fro_has_noise() -> None:
    """The path counts, not where it ended; the noise of distance then acts straight ahead."""
    increment = Increment(np.zeros(3), np.zeros((3, 3)), path_m=2.0, turned_rad=0.0)
    _, cov = linearised(np.zeros(3), increment, PARAMETERS)
    distance = 2 * PARAMETERS.alpha3
    np.testing.assert_allclose(np.diag(cov), [SLIP**2 * distance, distance, 2 * PARAMETERS.alpha2], atol=1e-18)
    after = PARAMETERS.predict(at(np.zeros(3)), increment, np.random.default_rng(4))
    assert_same_covariance(moments(after, np.zeros(3))[1], cov, slack=0.01)


@settings(max_examples=200)
@given(st.floats(-2, 2), st.floats(-2, 2), st.floats(-3, 3), st.floats(-4, 4))
def test_without_noise_every_particle_is_moved_exactly(right: float, back: float, turn: float, heading: float) -> None:
    columns = np.array([[1.0, -3.0], [2.0, 0.5], [heading, 0.0]])
    particles = Particles(POSE, columns, np.log([0.25, 0.75]))
    increment = Increment.from_mean([right, back, turn])
    after = NO_NOISE.predict(particles, increment, np.random.default_rng(0))
    error = after.poses - compose(particles.poses, increment.mean)
    error[:, 2] = wrap_angle(error[:, 2])
    way_m = np.hypot(right, back)
    # The direction of a way shorter than a nanometre is not known: then the end is off by twice the way at most.
    np.testing.assert_allclose(error, 0, atol=1e-12 if way_m >= 1e-9 else 1e-12 + 2 * way_m)
    np.testing.assert_array_equal(after.log_weight, particles.log_weight)


def direction_of_travel(increment: Increment) -> float:
    step = PARAMETERS.expected_step(at(np.zeros(3), 1), increment)
    return float(np.arctan2(step.sin[0], step.cos[0]))


@settings(max_examples=100)
@given(st.floats(-1, 1), st.floats(-1, 1), st.floats(-2, 2))
def test_noise_of_driving_back_is_that_of_driving_forward(right: float, back: float, turn: float) -> None:
    there = Increment.from_mean([right, back, turn])
    here = Increment.from_mean([-right, -back, turn])
    assert noise_variances(there, PARAMETERS) == noise_variances(here, PARAMETERS)
    if np.hypot(right, back) > 1e-6:
        difference = direction_of_travel(there) - direction_of_travel(here)
        assert abs(np.sin(difference)) < 1e-9, "the same line"


@pytest.mark.parametrize(
    ("motion", "expected"),
    [([0, -1, 0], 0.0), ([0, 1, 0], 0.0), ([-1, -1, 0], np.pi / 4), ([1, -1, 0.3], -np.pi / 4), ([0, 0, 0.6], 0.3)],
)
def test_direction_of_travel_is_anticlockwise_from_straight_ahead(motion: list[float], expected: float) -> None:
    assert direction_of_travel(Increment.from_mean(motion)) == pytest.approx(expected)


def test_columns_that_are_no_biases_and_weights_stay_as_they_are() -> None:
    rng = np.random.default_rng(5)
    columns = rng.normal(size=(5, 40))
    particles = Particles((*POSE, "tilt", "scale"), columns.copy(), rng.normal(size=40), np.zeros((2, 2)))
    after = PARAMETERS.predict(particles, Increment.from_mean([0.1, -0.4, 0.2]), rng)
    np.testing.assert_array_equal(after.columns[3:], columns[3:])
    np.testing.assert_array_equal(after.log_weight, particles.log_weight)
    np.testing.assert_array_equal(particles.columns, columns, err_msg="the particles given are not changed")
    assert after.names == particles.names


def test_an_increment_that_knows_its_covariance_adds_it_in_the_robot_frame() -> None:
    """Correlated, singular (the robot cannot slip sideways), and turned into the map by the heading."""
    root = np.array([[0.0, 0.0], [0.03, 0.0], [0.01, 0.02]])
    increment = Increment.from_mean([0.0, -0.2, 0.0], root @ root.T)
    _, expected = linearised(START, increment, NO_NOISE)
    to_map = np.array([[np.cos(0.7), np.sin(0.7), 0], [-np.sin(0.7), np.cos(0.7), 0], [0, 0, 1]])
    np.testing.assert_allclose(expected, to_map @ root @ root.T @ to_map.T, atol=1e-18)
    after = NO_NOISE.predict(at(START), increment, np.random.default_rng(6))
    assert_same_covariance(moments(after, compose(START, increment.mean))[1], expected, slack=1e-9)
    both = PARAMETERS.predict(at(START), increment, np.random.default_rng(7))
    _, sum_of_both = linearised(START, increment, PARAMETERS)
    assert_same_covariance(moments(both, compose(START, increment.mean))[1], sum_of_both, slack=0.01)


def test_wheels_before_or_after_vision_have_their_noise() -> None:
    seen, driven = Increment.from_mean([0.0, -0.2, 0.1], 1e-2 * np.eye(3)), Increment.from_mean([0.0, -4.0, 0.5])
    for both in (seen.then(driven), driven.then(seen)):
        assert noise_variances(both, PARAMETERS) == pytest.approx(noise_variances(driven, PARAMETERS))
        turn_var = covariance_of(PARAMETERS, both)[2, 2] - covariance_of(PARAMETERS, driven)[2, 2]
        assert turn_var == pytest.approx(seen.cov[2, 2], rel=0.01)


@settings(max_examples=100)
@given(st.floats(-3, 3), st.floats(-1, 1), st.floats(-1, 1), st.floats(-2, 2))
def test_transition_is_the_derivative_of_the_motion(heading: float, right: float, back: float, turn: float) -> None:
    pose, increment, step = np.array([0.3, -0.2, heading]), Increment.from_mean([right, back, turn]), 1e-6
    columns = []
    for axis in np.eye(3):
        difference = compose(pose + step * axis, increment.mean) - compose(pose - step * axis, increment.mean)
        columns.append([*difference[:2], wrap_angle(difference[2])])
    found, _ = linearised(pose, increment, PARAMETERS)
    np.testing.assert_allclose(found, np.array(columns).T / (2 * step), atol=1e-8)


def test_particles_move_along_the_axes_of_their_step_to_the_last_bit() -> None:
    cloud = Particles(POSE, np.random.default_rng(0).uniform(-3.0, 3.0, (3, 300)), np.zeros(300))
    increment, normal = Increment.from_mean([0.02, -0.1, 0.02]), np.random.default_rng(1).standard_normal((3, 300))
    step = PARAMETERS.expected_step(cloud, increment)
    plain = step.poses + np.einsum("pkn,kn->pn", step.axes, normal)
    plain[2] = wrap_angle(plain[2])
    moved = PARAMETERS.stepped(cloud, step, normal, increment).columns
    assert moved.tobytes() == plain.tobytes()


def test_moving_takes_little_memory_beside_the_particles() -> None:
    """Much more than this made the system hand out new pages for large clouds in every step."""
    cloud, rng = at(START), np.random.default_rng(0)
    PARAMETERS.predict(cloud, Increment.from_mean(MOTIONS["arc"]), rng)  # compiles
    tracemalloc.start()
    try:
        PARAMETERS.predict(cloud, Increment.from_mean(MOTIONS["arc"]), rng)
        most = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert most < 6 * cloud.columns.nbytes


def swaying(seconds: float, hz: float, bias: float, rng: np.random.Generator) -> tuple[Array, Array, Array, Array]:
    """Return times, rates, accelerations and the true up (T, 3) of a sensor that tilts by ±6° at 1 Hz."""
    t = np.arange(0.0, seconds, 1.0 / hz)
    tilt, rate = np.radians(6.0) * np.sin(2 * np.pi * t), np.radians(6.0) * 2 * np.pi * np.cos(2 * np.pi * t)
    up = np.stack([np.zeros_like(t), np.sin(tilt), np.cos(tilt)], axis=-1)
    rates = np.stack([rate, np.zeros_like(t), np.zeros_like(t)], axis=-1)
    swing = 0.3 * np.sin(2 * np.pi * 0.7 * t)[:, None] * np.array([1.0, 0.5, 0.0])  # m/s²: the robot drives to and fro
    rates = rates + bias * np.array([1.0, -1.0, 0.5]) + 1e-3 * rng.standard_normal(up.shape)
    return np.round(t * 1e9).astype(np.int64), rates, GRAVITY_M_S2 * up + swing, up


@pytest.mark.parametrize("bias", [0.0, 0.01])
def test_a_sensor_that_sways_knows_up_within_its_sigma(bias) -> None:
    t_ns, rates, accelerations, up = swaying(60.0, 100.0, bias, np.random.default_rng(1))
    found, cov = up_of(t_ns, rates, accelerations)
    np.testing.assert_allclose(np.linalg.norm(found, axis=1), 1.0, atol=1e-9)
    late = t_ns > 20e9
    angle = np.arcsin(np.linalg.norm(np.cross(found, up), axis=1))[late]
    sigma = np.sqrt(cov[late, 0, 0])
    assert np.degrees(np.sqrt((angle**2).mean())) < 0.5 and (angle < 3.0 * sigma).mean() > 0.97
    leaning = np.arcsin(np.linalg.norm(np.cross(accelerations, up), axis=1) / GRAVITY_M_S2)[late]
    assert np.sqrt((angle**2).mean()) < 0.5 * np.sqrt((leaning**2).mean())  # better than the accelerometer alone


@pytest.mark.parametrize("first", [0, 2000])
def test_a_sensor_that_falls_goes_on_by_its_gyroscope(first: int) -> None:
    t_ns, rates, accelerations, up = swaying(30.0, 100.0, 0.0, np.random.default_rng(2))
    accelerations[first : first + 100] = 0.0
    found, _ = up_of(t_ns, rates, accelerations)
    angle = np.arcsin(np.linalg.norm(np.cross(found, up), axis=1))[2100]
    assert np.degrees(angle) < 1.0
    with pytest.raises(ValueError, match="measures gravity"):
        up_of(t_ns, rates, np.zeros_like(accelerations))
