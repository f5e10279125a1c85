"""Candidates: weighted poses at all places, beside the one that is tracked, where the robot may be (docs/belief.md).

They are particles that many places share. Images weigh places against each other by less than they tell of a pose,
because the clutter of earlier images explains most edges as well. Within one cell of floor and heading, particles share
its weight by the likelihood of the filter. So those of a place lie as close to the edges as if it were tracked.

For places that are proposed late (`History`) one image is kept for each scene. It counts for those since the one
before, and the last image for those since it. What entered before the images that are kept counts as what is unexplored
does: it falls by what images look at.

Two things are not exact. A pose has one path, drawn from the noise of odometry, so a place that is as good as followed
ones may be found only by a later image. And as a place has the largest probability that any image gave it (`beyond`),
errors of these draws add up on the side of other places.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from localiser.geometry import Array, Increment, between, compose, wrap_angle
from localiser.motion import MotionModel, covariance_of
from localiser.observation import UNKNOWN_RATE, Sighting, log_sum_of_rates
from localiser.particles import Particles, cells_of, from_gaussian, log_sum, only, systematic_resample

PER_CELL = 60  # particles in each cell of floor and heading, on average
LEAST_WEIGHT = 1e-9  # of a cell, below which it is given up
EVENNESS = 0.25  # power of a cell's weight by which it gets particles
SPREAD = 0.2  # of the spread of a cell: by how much its particles are moved, so that copies part
RATE_MEMORY_SCENES = 5.0  # scenes after which the detection rate may be another
SCENES = 24  # that are kept
MOST_LOG = 600.0  # of a probability that is still finite
_NEVER = -500.0  # log-likelihood of a pose that is given up


@dataclass(frozen=True, slots=True, eq=False)
class Candidates:
    """particles: N of them. rates: (K, N) probability of each of `DETECTION_RATES` at each of them."""

    particles: Particles
    rates: Array

    def __len__(self) -> int:
        return len(self.particles)

    @classmethod
    def of(cls, particles: Particles, rate: Array = UNKNOWN_RATE) -> Candidates:
        """Return candidates with the same distribution (K,) of the detection rate, as images told it, if any did."""
        return cls(particles, np.tile(rate[:, None], (1, len(particles))))

    def weighed(
        self, by_rate: Array, novelty: float, *, needs_landmarks: bool, within: Array | None = None
    ) -> tuple[Candidates, float]:
        """Return the candidates after an image, and the logarithm of their mean likelihood.

        by_rate: (K, N) log p(edges | particle, p_k), relative to clutter alone. novelty: of the scene, 0 … 1.
        needs_landmarks: whether poses from which no landmark is in view are given up. There, what the image shows is
        not on the map. within: (N,) the log-likelihood by which the particles of a cell share its weight; None: as
        by_rate says.
        """
        forgotten = 1.0 - np.exp(-novelty / RATE_MEMORY_SCENES)
        rates = self.rates + forgotten * (UNKNOWN_RATE[:, None] - self.rates)
        joint = novelty * by_rate + np.log(rates)
        log_kept = np.where((by_rate == 0.0).all(axis=0), _NEVER, 0.0) if needs_landmarks else 0.0
        log_fit = log_sum_of_rates(joint)
        before = self.particles.log_weight
        after = before + log_fit + log_kept
        log_mean = log_sum(after) - log_sum(before)
        if within is not None:
            cell = cells_of(self.particles.poses)
            shared = before + novelty * within + log_kept
            after = shared + (_log_mass(after, cell) - _log_mass(shared, cell))[cell]
        return Candidates(replace(self.particles, log_weight=after), np.exp(joint - log_fit)), log_mean

    def joined(self, others: Candidates, log_odds: float) -> Candidates:
        """Return both, in which the others as a whole have exp(log_odds) times the weight of these."""
        one, other = self.particles, others.particles
        log_weight = [one.log_weight - log_sum(one.log_weight), other.log_weight - log_sum(other.log_weight) + log_odds]
        columns = np.concatenate([one.columns, other.columns], axis=1)
        particles = replace(one, columns=columns, log_weight=np.concatenate(log_weight))
        return Candidates(particles, np.concatenate([self.rates, others.rates], axis=1))

    def only(self, chosen: NDArray[np.bool_]) -> Candidates:
        """Return those chosen (N,)."""
        return Candidates(only(self.particles, chosen), self.rates[:, chosen])

    def resampled(self, most: int, rng: np.random.Generator) -> Candidates:
        """Return candidates at the same places, at most so many, with the same sum of weights.

        A cell of weight W gets particles in proportion to W^¼, and these share W. So the result is still weighted,
        and a place that fits a little worse than others is not lost by chance.
        """
        weight, cell = self.particles.weight, cells_of(self.particles.poses)
        mass = np.bincount(cell, weight)
        followed = mass > LEAST_WEIGHT
        share = np.where(followed, mass, 0.0) ** EVENNESS
        each = np.maximum(mass, 1e-300)
        chance = weight * (share / share.sum() / each)[cell]
        index = systematic_resample(chance, min(PER_CELL * int(followed.sum()), most), rng)
        columns, there = self.particles.columns[:, index], cell[index]
        for row, column in enumerate(self.particles.columns[:3]):
            off = column - (np.bincount(cell, weight * column) / each)[cell]
            sigma = np.sqrt(np.bincount(cell, weight * off**2) / each)
            columns[row] += SPREAD * sigma[there] * rng.standard_normal(len(index))
        columns[2] = wrap_angle(columns[2])
        log_weight = np.log(mass[there] / np.bincount(there)[there]) + log_sum(self.particles.log_weight)
        return Candidates(replace(self.particles, columns=columns, log_weight=log_weight), self.rates[:, index])


def _log_mass(log_weight: Array, cell: NDArray[np.int64]) -> Array:
    """Return the logarithm (C,) of the weight in each cell; log_weight, cell: (N,)."""
    top = np.full(int(cell.max(initial=-1)) + 1, -np.inf)
    np.maximum.at(top, cell, log_weight)
    return np.asarray(top + np.log(np.bincount(cell, np.exp(log_weight - top[cell]))))


# -- places that are proposed late -------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, eq=False)
class PastImage:
    """An image that is kept.

    novelty: of the images since the one before, which it counts for. step: motion from it to the next one that is kept,
    or to the last image. limits: (2,) another place gains log-likelihood - limits[0] by it, at most limits[1]. For
    candidates their mean is limited, and for a place that is proposed late each pose, which is the safe side.
    """

    sighting: Sighting
    novelty: float
    step: Increment
    limits: Array


@dataclass(frozen=True, slots=True, eq=False)
class History:
    """Images of the last scenes, oldest first, and what happened since the last of them.

    entered: (K + 1,) probability that came to where nobody has looked, between one of the K images and the one before,
    and since the last: at first all of it, later that of a robot that was carried, or that comes onto the map. limits:
    of what a place may gain since then. overlooked: part of what was unexplored that still is. new: scenes.
    """

    images: tuple[PastImage, ...] = ()
    entered: Array = field(default_factory=lambda: np.zeros(1))
    limits: Array = field(default_factory=lambda: np.zeros(2))
    overlooked: float = 1.0
    new: float = 0.0

    def moved(self, increment: Increment, novelty: float) -> History:
        """Return the history after a motion. novelty: of the scene of the image that follows it, 0 … 1."""
        if not self.images:
            return replace(self, new=1.0)
        last = replace(self.images[-1], step=self.images[-1].step.then(increment))
        return replace(self, images=(*self.images[:-1], last), new=self.new + novelty)

    def entering(self, probability: float, carried: float = 0.0) -> History:
        """Return the history of a robot that comes to where nobody has looked, with this probability.

        carried: probability that it was carried since the last image. What entered before that counts no longer.
        """
        entered = (1.0 - carried) * self.entered
        entered[-1] += probability
        return replace(self, entered=entered)

    def with_image(self, sighting: Sighting) -> History:
        """Return the history with an image, if it is of another scene than the last one that was kept."""
        if self.new < 1.0:
            return self
        last = PastImage(sighting, self.new, Increment.from_mean(np.zeros(3)), self.limits)
        images, entered = (*self.images, last), np.append(self.entered, 0.0)
        if len(images) > SCENES:
            entered[1] += self.overlooked * entered[0]
        return History(images[-SCENES:], entered[-SCENES - 1 :])

    def weighed(
        self,
        proposed: Candidates,
        sighting: Sighting,
        evidence: Callable[[Particles, Sighting], tuple[Array, bool]],
        motion: MotionModel,
        rng: np.random.Generator,
    ) -> Candidates:
        """Return proposed poses with the probabilities of docs/belief.md, step 5.

        proposed: of weight prior / density of draws. sighting: the last image. evidence: `GlobalLocalisation.evidence`.
        """
        # Where they were, by odometry and its noise; now last.
        clouds = [replace(proposed.particles, log_weight=np.zeros(len(proposed)))]
        for image in reversed(self.images):
            steps = from_gaussian(image.step.mean, covariance_of(motion, image.step), len(proposed), rng).poses
            columns = clouds[0].columns.copy()
            columns[:3] = compose(columns[:3].T, between(steps, np.zeros_like(steps))).T
            clouds.insert(0, replace(clouds[0], columns=columns))
        last = PastImage(sighting, self.new, Increment.from_mean(np.zeros(3)), self.limits)
        log_path, followed = np.full(len(proposed), -np.inf), proposed
        for cloud, entered, image in zip(clouds, self.entered, (*self.images, last), strict=True):
            log_entered = np.log(max(entered, 1e-300))
            log_path = np.logaddexp(log_path, log_entered)
            rates = followed.rates + np.exp(log_entered - log_path) * (proposed.rates - followed.rates)
            by_rate, needs_landmarks = evidence(cloud, image.sighting)
            followed, _ = Candidates(cloud, rates).weighed(by_rate, image.novelty, needs_landmarks=needs_landmarks)
            log_path += np.minimum(followed.particles.log_weight - image.limits[0], image.limits[1])
        log_path += proposed.particles.log_weight
        return Candidates(replace(proposed.particles, log_weight=log_path), followed.rates)


def beyond(proposed: Candidates, known: Candidates | None, probability: float) -> tuple[Candidates, float]:
    """Return proposed poses that have some probability beyond those known in their cells, with that, and all of it.

    proposed: log_weight is that of their probability. known: candidates that are followed, and the probability of all
    of them. What images say of a place that is followed already is counted once.
    """
    log_weight = proposed.particles.log_weight
    top = max(float(log_weight.max()) - MOST_LOG, 0.0)
    mass = np.exp(log_weight - top)
    if known is not None:
        cell = cells_of(np.concatenate([proposed.particles.poses, known.particles.poses]))
        here, there = cell[: len(mass)], cell[len(mass) :]
        found = np.bincount(here, mass)
        before = np.bincount(there, np.exp(-top) * probability * known.particles.weight, minlength=len(found))
        gained = np.maximum(found - before[: len(found)], 0.0)
        mass = mass * (gained / np.maximum(found, 1e-300))[here]
    more = mass > 0
    particles = replace(only(proposed.particles, more), log_weight=np.log(mass[more]))
    return Candidates(particles, proposed.rates[:, more]), float(mass.sum())
