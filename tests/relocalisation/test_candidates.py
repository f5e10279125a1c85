"""What earlier images say of a place that is proposed late, against candidates that were followed all along."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from proposal_room import CAMERA, room
from simulated_edges import EdgeNoise, simulated_edges

from localiser.geometry import Array, Increment, Trajectory, between, compose
from localiser.motion import MotionModel, MotionParameters, covariance_of
from localiser.observation import DETECTION_RATES, EdgeObservation, ObservationParameters, Sighting
from localiser.particles import POSE, Particles, cells_of
from localiser.relocalisation import Candidates, GlobalLocalisation, History, beyond
from localiser.relocalisation.candidates import SCENES

ROOM = room(80)
SEARCH = GlobalLocalisation.of(EdgeObservation(CAMERA, ObservationParameters()), ROOM)
STEP = Increment.from_mean([0.02, -0.3, 0.1])


class Exact:
    """A motion model without noise of its own, so that the covariance is that of the increment."""

    def predict(self, cloud: Particles, increment: Increment, rng: np.random.Generator) -> Particles:
        columns = cloud.columns.copy()
        columns[:3] = compose(columns[:3].T, increment.mean).T
        return replace(cloud, columns=columns)


EXACT: MotionModel = Exact()


FREE = np.array([0.0, np.inf])  # limits of what a place may gain by an image


def stated(particles: Particles, slope: float) -> tuple[Array, bool]:
    """Return log p (K, N) of an image that is a number: so many times how far back the robot is, for each rate."""
    return np.tile(slope * particles.columns[1], (len(DETECTION_RATES), 1)), True


def proposed(poses: Array, log_weight: Array | None = None) -> Candidates:
    weight = np.zeros(len(poses)) if log_weight is None else log_weight
    return Candidates.of(Particles(POSE, np.ascontiguousarray(np.asarray(poses, dtype=float).T), weight))


def driven(slopes: list[float], entered: list[float], limits: list[Array]) -> History:
    """A history of one image a scene, of which the last is only on its way."""
    history = History()
    for slope, probability, limit in zip(slopes, entered, limits, strict=True):
        history = limited(history.moved(STEP, 1.0).entering(probability), limit)
        history = history.with_image(slope)  # type: ignore[arg-type]
    return history


def limited(history: History, limits: Array = FREE) -> History:
    return replace(history, limits=history.limits + limits)


def log_weights(history: History, candidates: Candidates, slope: float, evidence: Any = stated) -> Array:
    rng = np.random.default_rng(0)
    return history.weighed(candidates, slope, evidence, EXACT, rng).particles.log_weight  # type: ignore[arg-type]


def test_a_place_that_is_proposed_late_is_as_likely_as_if_it_had_been_followed() -> None:
    """40 candidates followed through ten images, and the same places proposed by the last image."""
    rng, begin = np.random.default_rng(3), np.array([1.0, 1.5, 0.3])
    truth = [begin]
    for _ in range(9):
        truth.append(compose(truth[-1], STEP.mean))
    t_ns = np.arange(10) * 1_000_000_000
    noise = EdgeNoise(detection_probability=0.8, clutter_per_frame=4.0)
    edges = simulated_edges(ROOM, CAMERA, Trajectory(t_ns, np.array(truth)), rng, noise=noise)
    images = [Sighting(int(t), seen) for t, seen in zip(t_ns, edges, strict=True)]

    followed = proposed(begin + rng.normal(0, [0.3, 0.3, 0.1], (40, 3)), rng.normal(size=40))
    prior, history = followed.particles.log_weight, History(entered=np.array([0.4]))
    for index, sighting in enumerate(images):
        if index:
            followed = replace(followed, particles=EXACT.predict(followed.particles, STEP, rng))
        by_rate, needs_landmarks = SEARCH.evidence(followed.particles, sighting)
        followed, _ = followed.weighed(by_rate, 1.0, needs_landmarks=needs_landmarks)
        history = limited(history.moved(STEP, 1.0))
        if index < 9:
            history = history.with_image(sighting)

    late = proposed(followed.particles.poses, prior)
    found = history.weighed(late, images[-1], SEARCH.evidence, EXACT, rng)
    assert found.particles.log_weight == pytest.approx(followed.particles.log_weight + np.log(0.4), abs=1e-6)
    np.testing.assert_allclose(found.rates, followed.rates, atol=1e-9)
    assert np.ptp(found.particles.log_weight) > 20.0, "these images tell the places apart"


def test_what_entered_later_counts_by_later_images_only() -> None:
    """A plain sum over when the robot came, of products over the images since, each within its limits."""
    slopes, entered = [2.0, 3.0, 5.0, 1.0], [0.5, 0.01, 0.002, 0.1]
    limits = [FREE, np.array([0.7, 0.9]), FREE, np.array([0.1, 2.0])]
    history = limited(driven(slopes[:3], entered[:3], limits[:3]).moved(STEP, 0.4).entering(entered[3]), limits[3])
    poses = np.array([[0.0, 0.5, 0.0], [0.3, -0.2, 0.6], [1.0, 0.4, -1.0]])
    found = log_weights(history, proposed(poses, np.array([0.0, 0.2, -0.3])), slopes[3])
    for pose, log_prior, log_weight in zip(poses, [0.0, 0.2, -0.3], found, strict=True):
        at = [pose]
        for _ in range(3):
            at.insert(0, compose(at[0], between(STEP.mean, np.zeros(3))))
        gains = [slope * place[1] * new for slope, place, new in zip(slopes, at, [1, 1, 1, 0.4], strict=True)]
        gains = [min(gain - limit[0], limit[1]) for gain, limit in zip(gains, limits, strict=True)]
        total = sum(came * np.exp(sum(gains[when:])) for when, came in enumerate(entered))
        assert log_weight == pytest.approx(log_prior + np.log(total))


def test_without_earlier_images_only_this_one_counts_and_wholly() -> None:
    history = limited(History(entered=np.array([0.5])).moved(STEP, 0.1))
    assert log_weights(history, proposed(np.array([[0.0, 2.0, 0.0]])), 3.0) == pytest.approx([6.0 + np.log(0.5)])


def test_images_of_one_scene_are_kept_once() -> None:
    history = History(entered=np.array([1.0])).moved(STEP, 0.3)
    for index in range(31):
        history = history.with_image(float(index)).moved(STEP, 0.3)  # type: ignore[arg-type]
    assert [one.sighting for one in history.images] == [0.0, 4.0, 8.0, 12.0, 16.0, 20.0, 24.0, 28.0]
    np.testing.assert_allclose(history.images[0].step.path_m, 4 * STEP.path_m)


def test_what_entered_before_the_robot_was_carried_counts_no_longer() -> None:
    history = driven([1.0, 1.0], [0.5, 0.25], [FREE] * 2).entering(0.1, carried=0.2)
    assert history.entered == pytest.approx([0.4, 0.2, 0.1])


@pytest.mark.parametrize("overlooked", [0.3, 1.0])
def test_what_entered_before_the_images_that_are_kept_falls_by_what_is_looked_at(overlooked: float) -> None:
    history = History(entered=np.array([0.5]))
    for _ in range(SCENES + 2):
        history = replace(history.moved(STEP, 1.0), overlooked=overlooked)
        history = history.with_image(1.0)  # type: ignore[arg-type]
    assert len(history.images) == SCENES
    assert history.entered.sum() == pytest.approx(0.5 * overlooked**2)


def test_a_robot_that_enters_later_has_learnt_nothing_of_the_detection_rate_before() -> None:
    """Its first images show nothing that a place expects, and then it is carried to where it all shows."""

    def rated(particles: Particles, slope: float) -> tuple[Array, bool]:
        return np.tile(slope * np.arange(len(DETECTION_RATES))[:, None], (1, len(particles))), True

    history = History(entered=np.array([1.0]))
    for _ in range(5):
        history = limited(history.moved(STEP, 1.0)).with_image(-2.0)  # type: ignore[arg-type]
    history = limited(history.moved(STEP, 1.0).entering(1.0, carried=1.0))
    fresh = limited(History(entered=np.array([1.0])).moved(STEP, 1.0))
    at = proposed(np.zeros((1, 3)))
    late, at_once = (log_weights(each, at, 2.0, rated) for each in (history, fresh))
    assert late == pytest.approx(at_once, abs=1e-6)


def test_places_before_are_as_uncertain_as_odometry() -> None:
    """The covariance of 20,000 draws, within four standard errors."""
    motion, count, rng = MotionParameters(), 20_000, np.random.default_rng(1)
    step = Increment.from_mean([0.1, -0.5, 0.4], np.diag([0.02, 0.05, 0.03]) ** 2)
    history, asked = limited(History().moved(step, 1.0)).with_image(1.0), []  # type: ignore[arg-type]

    def evidence(particles: Particles, slope: float) -> tuple[Array, bool]:
        asked.append(particles)
        return stated(particles, slope)

    here = proposed(np.tile([1.0, 2.0, 0.5], (count, 1)))
    limited(history.moved(step, 1.0)).weighed(here, 1.0, evidence, motion, rng)  # type: ignore[arg-type]
    before, now = asked
    assert np.array_equal(now.columns, here.particles.columns)
    steps = between(before.poses, now.poses)
    cov = covariance_of(motion, step)
    np.testing.assert_allclose(steps.mean(axis=0), step.mean, atol=4 * np.sqrt(cov.max() / count))
    error = 4 * np.sqrt((cov**2 + np.outer(np.diag(cov), np.diag(cov))) / count)
    assert (np.abs(np.cov(steps.T) - cov) < error).all()


def test_a_place_that_is_followed_already_is_not_counted_twice() -> None:
    """In each cell the larger of both probabilities."""
    rng = np.random.default_rng(2)
    found = proposed(rng.uniform([0, 0, 0], [3, 3, 1], (300, 3)), rng.normal(-8.0, 2.0, 300))
    known = proposed(rng.uniform([0, 0, 0], [3, 3, 1], (200, 3)))
    more, probability = beyond(found, known, 0.4)
    cell = np.split(cells_of(np.concatenate([each.particles.poses for each in (found, known)])), [300])
    mass = np.exp(found.particles.log_weight), 0.4 * known.particles.weight
    expected = 0.0
    for index in range(max(one.max() for one in cell) + 1):
        new, old = (weight[there == index].sum() for weight, there in zip(mass, cell, strict=True))
        expected += max(new, old) - old
    assert probability == pytest.approx(expected) and 0 < expected < mass[0].sum()
    assert np.exp(more.particles.log_weight).sum() == pytest.approx(expected)
    assert beyond(found, None, 0.0)[1] == pytest.approx(mass[0].sum())
    far = replace(found, particles=replace(found.particles, log_weight=found.particles.log_weight + 1000.0))
    several, most = beyond(far, known, 0.4)
    assert np.isfinite(most) and np.ptp(several.particles.log_weight) > 5.0
    nothing, none = beyond(found, found, 1.0)
    assert len(nothing) == 0 and none == 0.0
