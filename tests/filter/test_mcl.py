"""The filter: events of any rates in, estimates out; and the estimates against a grid filter."""

import runpy
from dataclasses import dataclass

import numpy as np
import pytest
from folders import ROOT
from grid_filter import GridFilter, headings
from numpy.typing import NDArray
from simulated_edges import EdgeNoise, simulated_edges

from localiser import geometry, particles
from localiser.camera import Camera, Mount
from localiser.edges import Edges
from localiser.filter import Event, FilterState, Located, Mcl, MclParameters, Odometry, Sighting, Start, finish, step
from localiser.geometry import Array, Increment, Trajectory, arc_motion, compose, wrap_angle
from localiser.landmarks import LandmarkMap
from localiser.motion import EXACT, MotionParameters, linearised
from localiser.observation import EdgeObservation, InlierRate, ObservationParameters
from localiser.particles import POSE, Particles

CAMERA = Camera(640, 480, 554.0, 554.0, 319.5, 239.5, Mount(np.radians(20), 0.9, back_m=-0.1))
POINTS = np.array([[-1.2, -4.0], [-0.4, -5.5], [0.5, -4.5], [1.3, -5.0], [-2.0, -6.5], [2.0, -7.0]])
MAP = LandmarkMap.from_points(POINTS)
INDEPENDENT = ObservationParameters(kind="slope", landmark_sigma_m=0.0, decorrelation_m=0.0)
NO_NOISE = MotionParameters(0.0, 0.0, 0.0, 0.0, bias=EXACT)
NOISE = MotionParameters(bias=EXACT)
PRIOR = np.diag([0.1, 0.1, 0.05]) ** 2
START_POSE = np.array([0.1, 0.3, 0.05])
SECOND = 1_000_000_000


@dataclass(frozen=True)
class Weighs:
    """An observation that says what it is told: log-likelihood from poses alone."""

    per_metre: float = 0.0

    def log_likelihood(self, particles: Particles, sighting: Sighting, landmark_map: LandmarkMap) -> Array:
        return self.per_metre * particles["x"]


def filter_of(count: int = 300, motion: MotionParameters = NO_NOISE, **changes: object) -> Mcl:
    fields = {
        "landmark_map": MAP,
        "observation": EdgeObservation(CAMERA, INDEPENDENT),
        "parameters": MclParameters(particles=count, start_particles=count),
        "motion": motion,
        "correlation": INDEPENDENT,
    }
    return Mcl(**(fields | changes))  # type: ignore[arg-type]


def run(mcl: Mcl, events: list[Event], seed: int = 0, state: FilterState | None = None) -> list[Located]:
    rng, state = np.random.default_rng(seed), state or FilterState()
    found = [located for event in events for located in step(mcl, state, event, rng)]
    return found + list(finish(mcl, state, rng))


def circle(times_ns: NDArray[np.int64] | list[int], start_heading: float = 0.0) -> Trajectory:
    """A drive of 0.4 m/s and 0.5 rad/s, exact at all times, from an odometry origin that is nowhere near the map's."""
    origin, velocity = np.array([20.0, -7.0, start_heading]), np.array([0.0, -0.4])
    poses = [compose(origin, arc_motion(velocity * t / SECOND, 0.5 * t / SECOND, 1.0)) for t in times_ns]
    return Trajectory(np.array(times_ns, dtype=np.int64), np.array(poses))


def odometry(track: Trajectory) -> list[Odometry]:
    return [Odometry(int(t), pose) for t, pose in zip(track.t_ns, track.poses, strict=True)]


def in_time(*streams: list) -> list[Event]:
    """Events in the order of time; of equal times those of earlier streams come first."""
    return sorted((event for stream in streams for event in stream), key=lambda event: event.t_ns)


def images(times_ns: list[int]) -> list[Sighting]:
    return [Sighting(t, Edges.none()) for t in times_ns]


IMAGE_TIMES = [130_000_001 + k * 210_000_000 for k in range(12)]


# -- time -------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("heading", [0.0, np.pi - 0.3, -2.0])
def test_increments_between_images_are_exact_whatever_the_rates(heading: float) -> None:
    """Odometry at 20 Hz or 3 Hz, images at 4.8 Hz, never at the same time: on arcs interpolation is exact."""
    truth = circle([0, *IMAGE_TIMES], heading)
    for step_ns in (50_000_000, 330_000_000):
        events = in_time(
            [Start(0, START_POSE, PRIOR)],
            odometry(circle(np.arange(0, 3 * SECOND, step_ns), heading)),
            images(IMAGE_TIMES),
        )
        found = run(filter_of(), events)
        assert [located.t_ns for located in found] == IMAGE_TIMES
        expected = geometry.between(truth.poses[:-1], truth.poses[1:])
        np.testing.assert_allclose([located.increment.mean for located in found], expected, atol=1e-9)
        np.testing.assert_allclose([located.increment.turned_rad for located in found], expected[:, 2], atol=1e-9)
        np.testing.assert_allclose([located.odometry for located in found], truth.poses[1:], atol=1e-9)


def test_without_noise_particles_end_where_the_odometry_leads() -> None:
    events = in_time(
        [Start(0, START_POSE, np.zeros((3, 3)))],
        odometry(circle(np.arange(0, 3 * SECOND, 50_000_000))),
        images(IMAGE_TIMES),
    )
    last = run(filter_of(5), events)[-1]
    truth = circle([0, IMAGE_TIMES[-1]])
    expected = compose(START_POSE, geometry.between(truth.poses[0], truth.poses[1]))
    np.testing.assert_allclose(last.particles.poses, np.tile(expected, (5, 1)), atol=1e-9)
    np.testing.assert_allclose(last.estimate.pose, expected, atol=1e-9)


def test_odometry_resampled_along_its_arcs_changes_nothing() -> None:
    """Same seed, odometry at 20 and at 40 Hz: the path along chords differs by 1e-5, the particles hardly at all."""
    mcl = filter_of(200, NOISE)
    results = [
        run(
            mcl,
            in_time(
                [Start(0, START_POSE, PRIOR)], odometry(circle(np.arange(0, 3 * SECOND, step_ns))), images(IMAGE_TIMES)
            ),
        )
        for step_ns in (50_000_000, 25_000_000)
    ]
    for coarse, fine in zip(*results, strict=True):
        assert coarse.increment.path_m == pytest.approx(fine.increment.path_m, rel=1e-4)
        np.testing.assert_allclose(coarse.particles.columns, fine.particles.columns, atol=1e-5)


def test_an_image_waits_for_odometry_and_is_not_lost_at_the_end() -> None:
    mcl, state, rng = filter_of(), FilterState(), np.random.default_rng(0)
    first, second, late = odometry(circle([0, SECOND, 2 * SECOND]))
    assert list(step(mcl, state, Start(0, START_POSE, PRIOR), rng)) == []
    assert list(step(mcl, state, first, rng)) == []
    assert list(step(mcl, state, Sighting(SECOND // 4, Edges.none()), rng)) == []
    assert list(step(mcl, state, Sighting(SECOND // 2, Edges.none()), rng)) == []
    assert [located.t_ns for located in step(mcl, state, second, rng)] == [SECOND // 4, SECOND // 2]
    assert list(step(mcl, state, late, rng)) == []
    assert [located.t_ns for located in step(mcl, state, Sighting(2 * SECOND, Edges.none()), rng)] == [2 * SECOND]
    assert list(step(mcl, state, Sighting(3 * SECOND, Edges.none()), rng)) == []
    (last,) = finish(mcl, state, rng)
    np.testing.assert_array_equal(last.increment.mean, 0)
    assert len(state.odometry) == 2, "but for two poses, odometry that is past is forgotten"


def test_images_alone_localise_a_robot_that_stands() -> None:
    found = run(filter_of(), [Start(0, START_POSE, PRIOR), *images([1, 2])])
    assert [located.t_ns for located in found] == [1, 2]
    np.testing.assert_array_equal(found[1].increment.mean, 0)


# -- start ------------------------------------------------------------------------------------------------------------


def test_an_image_before_any_start_is_refused() -> None:
    moves = odometry(circle([0, SECOND, 2 * SECOND]))
    with pytest.raises(ValueError, match="before any start"):
        run(filter_of(), in_time(moves, images([SECOND // 2])))
    with pytest.raises(ValueError, match="before any start"):
        run(filter_of(), in_time([Start(SECOND, START_POSE, PRIOR)], moves, images([SECOND // 2])))


def test_a_start_in_the_middle_begins_anew_between_two_odometry_poses() -> None:
    """What odometry said before the start does not move the particles drawn at the start."""
    start_ns, image_ns = 1_234_000_000, 1_700_000_000
    second = Start(start_ns, np.array([5.0, 6.0, -3.0]), np.zeros((3, 3)))
    events = in_time(
        [Start(0, START_POSE, PRIOR), second],
        odometry(circle(np.arange(0, 3 * SECOND, 100_000_000))),
        images([SECOND, image_ns]),
    )
    last = run(filter_of(4), events)[-1]
    truth = circle([start_ns, image_ns])
    np.testing.assert_allclose(last.increment.mean, geometry.between(*truth.poses), atol=1e-9)
    np.testing.assert_allclose(last.estimate.pose, compose(second.mean, last.increment.mean), atol=1e-9)


# -- weighing, estimate, resampling -----------------------------------------------------------------------------------


@pytest.mark.parametrize(("per_metre", "resamples"), [(1.0, False), (12.0, True)])
def test_estimate_is_that_of_the_weighted_particles_and_resampling_comes_after(per_metre, resamples):
    mcl, state = filter_of(500, observation=Weighs(per_metre)), FilterState()
    (located,) = run(mcl, [Start(0, START_POSE, PRIOR), *odometry(circle([0, SECOND])), *images([0])], state=state)
    drawn = particles.from_gaussian(START_POSE, PRIOR, 500, np.random.default_rng(0))
    weight = particles.normalised(per_metre * drawn["x"])
    assert located.ess == pytest.approx(1 / np.square(weight).sum())
    assert (located.ess < 250) == resamples
    np.testing.assert_allclose(located.estimate.pose[:2], drawn.poses[:, :2].T @ weight, atol=1e-12)
    np.testing.assert_allclose(located.particles.weight, weight, atol=1e-12)
    if resamples:
        np.testing.assert_array_equal(state.particles.log_weight, 0)
        assert set(state.particles["x"]) < set(drawn["x"]), "only copies of what was there, and not all of it"
    else:
        np.testing.assert_allclose(state.particles.weight, weight, atol=1e-12)


def test_weights_accumulate_until_they_are_resampled() -> None:
    mcl = filter_of(500, observation=Weighs(1.0))
    found = run(mcl, [Start(0, START_POSE, PRIOR), *odometry(circle([0])), *images([0, 1, 2])])
    x = found[0].particles["x"]
    np.testing.assert_allclose(found[2].particles.weight, particles.normalised(3 * x), atol=1e-12)


def test_an_image_from_the_same_place_tells_nothing_new() -> None:
    """Unless errors are said to be independent; the first image counts in full."""
    events = [Start(0, START_POSE, PRIOR), *odometry(circle([0])), *images([0, 1, 2])]
    found = run(filter_of(500, observation=Weighs(1.0), correlation=ObservationParameters()), events)
    expected = particles.normalised(found[0].particles["x"])
    np.testing.assert_allclose([located.particles.weight for located in found], [expected] * 3, atol=1e-12)


@pytest.mark.parametrize("heading", [np.pi, -np.pi, np.pi - 0.01])
def test_headings_at_the_seam_are_averaged_as_directions(heading: float) -> None:
    mean = np.array([0.0, 0.0, heading])
    found = run(filter_of(4000), [Start(0, mean, PRIOR), *odometry(circle([0, SECOND])), *images([SECOND])])
    assert abs(wrap_angle(found[0].estimate.pose[2] - heading - 0.5)) < 4 * 0.05 / np.sqrt(4000)
    assert found[0].estimate.pose_cov[2, 2] == pytest.approx(0.05**2, rel=0.1)
    assert (np.abs(found[0].particles["heading"]) <= np.pi).all()


def sighted(truth: Trajectory, seed: int, sigma_px: float = 0.5) -> list[Sighting]:
    rng = np.random.default_rng([seed, 1])
    frames = simulated_edges(MAP, CAMERA, truth, rng, noise=EdgeNoise(endpoint_sigma_px=sigma_px))
    return [Sighting(int(t), edges) for t, edges in zip(truth.t_ns, frames, strict=True)]


def ahead(seconds: float, step_ns: int, speed: float = 0.3) -> Trajectory:
    t_ns = np.arange(0, round(seconds * SECOND), step_ns)
    return Trajectory(t_ns, np.array([[0.0, -speed * t / SECOND, 0.0] for t in t_ns]))


def test_same_generator_same_arrays_another_differs() -> None:
    truth = ahead(2, 200_000_000)
    events = in_time([Start(0, START_POSE, PRIOR)], odometry(ahead(2.2, 70_000_000)), sighted(truth, 0))
    first, again, other = (run(filter_of(300, NOISE), events, seed) for seed in (3, 3, 4))
    assert any(located.ess < 150 for located in first), "resampling must be part of it"
    for a, b in zip(first, again, strict=True):
        np.testing.assert_array_equal(a.particles.columns, b.particles.columns)
        np.testing.assert_array_equal(a.particles.log_weight, b.particles.log_weight)
        np.testing.assert_array_equal(a.estimate.cov, b.estimate.cov)
    assert (first[-1].particles.columns != other[-1].particles.columns).any()


def test_edges_lead_from_a_wrong_start_to_the_truth() -> None:
    truth = ahead(3, 200_000_000)
    events = in_time([Start(0, START_POSE, PRIOR)], odometry(ahead(3.2, 70_000_000)), sighted(truth, 0))
    found = run(filter_of(2000, NOISE), events)
    error = found[-1].estimate.pose - truth.poses[-1]
    assert np.hypot(*START_POSE[:2]) > 0.3
    assert (np.abs(error) < 4 * np.sqrt(np.diag(found[-1].estimate.pose_cov))).all()
    assert np.hypot(*error[:2]) < 0.1


# -- against the grid filter ------------------------------------------------------------------------------------------


def test_means_and_spreads_agree_with_the_grid_filter() -> None:
    """Mean over 12 seeds within 4 standard errors and 3 mm (1 mrad) for the cells of 5 cm and 2°; sigmas within 5 %."""
    motion = MotionParameters(alpha1=5e-3, alpha2=6e-3, alpha3=8e-3, alpha4=1e-3, bias=EXACT)
    prior, seeds = np.diag([0.15, 0.15, 0.08]) ** 2, 12
    increment = Increment.from_mean([0.0, -0.3, 0.06])
    poses = [np.zeros(3)]
    for _ in range(3):
        poses.append(compose(poses[-1], increment.mean))
    t_ns = np.arange(4) * SECOND
    truth = Trajectory(t_ns, np.array(poses))
    # Edges so uncertain that cells of the grid can hold the posterior.
    frames = sighted(truth, 5, sigma_px=6.0)

    axis = np.linspace(-1.4, 1.4, 57)
    grid = GridFilter.gaussian(axis, axis - 0.5, headings(180), START_POSE, prior)
    observation = EdgeObservation(CAMERA, INDEPENDENT)
    noise = linearised(np.zeros(3), increment, motion)[1]
    means, sigmas, inliers = [], [], InlierRate.unknown()
    for index, frame in enumerate(frames):
        if index:
            grid = grid.predict(increment, noise)

        inliers = inliers.after(1.0)

        def by_rate(cells: Array, edges: Edges = frame.edges) -> Array:
            return observation.by_rate(Particles(POSE, cells.T, np.zeros(len(cells))), Sighting(0, edges), MAP)

        grid = grid.update(lambda cells: inliers.log_mean(by_rate(cells)))  # noqa: B023
        held = grid.p.ravel() > 1e-12
        inliers = inliers.given(by_rate(grid.poses[held]), grid.p.ravel()[held] / grid.p.ravel()[held].sum(), 1.0)
        means.append(grid.mean)
        sigmas.append(np.sqrt(np.diag(grid.cov)))

    events = in_time([Start(0, START_POSE, prior)], odometry(truth), frames)
    found = [run(filter_of(10_000, motion), events, seed) for seed in range(seeds)]
    error = np.array([[located.estimate.pose for located in one] for one in found]) - np.array(means)
    standard_error = error.std(axis=0, ddof=1) / np.sqrt(seeds)
    assert (np.abs(error.mean(axis=0)) < 4 * standard_error + [0.003, 0.003, 0.001]).all()
    spread = np.sqrt(np.mean([[np.diag(located.estimate.pose_cov) for located in one] for one in found], axis=0))
    np.testing.assert_allclose(spread, sigmas, rtol=0.05)
    moved = np.abs(np.array(means)[0] - START_POSE)
    assert (moved > 4 * standard_error[0]).any(), "the edges must matter"


# -- against the limit of accuracy ------------------------------------------------------------------------------------


@pytest.mark.slow
def test_slope_comes_close_to_the_posterior_bound() -> None:
    """20 seeds, 40 frames, 2000 particles, edges without images; the whole drive is left to the benchmark."""
    benchmark = runpy.run_path(str(ROOT / "benchmarks" / "efficiency.py"))
    setting = benchmark["setting_of"]("corridor", 40)
    verdict = benchmark["verdict_of"]([benchmark["run"](setting, "slope", 2000, seed) for seed in range(20)])
    assert verdict.efficiency.value <= 1.3
    assert verdict.nees_mean <= 3.5, "no surer than it may be"
