"""Candidates: weighted poses at all places, beside the one that is tracked, where the robot may be.

They are particles that many places share. Each has its own distribution of the detection rate, learnt from the images
that it has been weighed by: landmarks of another place may be seen more or less often.

Images weigh places against each other by less than they tell of a pose, because the clutter of earlier images explains
most edges as well. Within one cell of floor and heading, particles share its weight by the likelihood that the filter
itself weighs particles by. So those of a place lie as close to the edges as if it were tracked.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from localiser.geometry import Array, wrap_angle
from localiser.observation import DetectionRate, log_sum_of_rates
from localiser.particles import Particles, cells_of, log_sum, only, systematic_resample

PER_CELL = 60  # particles in each cell of floor and heading, on average
LEAST_WEIGHT = 1e-9  # of a cell, below which it is given up
EVENNESS = 0.25  # power of a cell's weight by which it gets particles
SPREAD = 0.2  # of the spread of a cell: by how much its particles are moved, so that copies part
MEMORY_SCENES = 5.0  # scenes after which the detection rate may be another
_NEVER = -500.0  # log-likelihood of a pose that is given up
_UNKNOWN: Array = DetectionRate.unknown().probability[:, None]


@dataclass(frozen=True, slots=True, eq=False)
class Candidates:
    """particles: N of them. rates: (K, N) probability of each of `DETECTION_RATES` at each of them."""

    particles: Particles
    rates: Array

    def __len__(self) -> int:
        return len(self.particles)

    @classmethod
    def of(cls, particles: Particles, rate: DetectionRate | None = None) -> Candidates:
        """Return candidates with the same distribution of the detection rate; None: no image was compared with them."""
        probability = _UNKNOWN if rate is None else rate.probability[:, None]
        return cls(particles, np.tile(probability, (1, len(particles))))

    def weighed(
        self, by_rate: Array, novelty: float, *, needs_landmarks: bool, within: Array | None = None
    ) -> tuple[Candidates, float]:
        """Return the candidates after an image, and the logarithm of their mean likelihood.

        by_rate: (K, N) log p(edges | particle, p_k), relative to clutter alone. novelty: of the scene, 0 … 1.
        needs_landmarks: whether poses from which no landmark is in view are given up. There, what the image shows is
        not on the map. within: (N,) the log-likelihood by which the particles of a cell share its weight; None: as
        by_rate says.
        """
        rates = self.rates + (1.0 - np.exp(-novelty / MEMORY_SCENES)) * (_UNKNOWN - self.rates)
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
        log_weight = one.log_weight - log_sum(one.log_weight)
        log_others = other.log_weight - log_sum(other.log_weight) + log_odds
        columns = np.concatenate([one.columns, other.columns], axis=1)
        particles = replace(one, columns=columns, log_weight=np.concatenate([log_weight, log_others]))
        return Candidates(particles, np.concatenate([self.rates, others.rates], axis=1))

    def only(self, chosen: NDArray[np.bool_]) -> Candidates:
        """Return those chosen (N,)."""
        return Candidates(only(self.particles, chosen), self.rates[:, chosen])

    def resampled(self, most: int, rng: np.random.Generator) -> Candidates:
        """Return candidates at the same places, at most so many, with the same sum of weights.

        A cell of weight W gets particles in proportion to W^¼, and these share W. So the result is still weighted,
        and a place that fits a little worse than others is not lost by chance.
        """
        weight, poses = self.particles.weight, self.particles.poses
        cell = cells_of(poses)
        mass = np.bincount(cell, weight)
        followed = mass > LEAST_WEIGHT
        share = np.where(followed, mass, 0.0) ** EVENNESS
        each = np.maximum(mass, 1e-300)
        chance = weight * (share / share.sum() / each)[cell]
        index = systematic_resample(chance, min(PER_CELL * int(followed.sum()), most), rng)
        drawn = np.bincount(cell[index], minlength=len(mass))
        columns = self.particles.columns[:, index]
        for row, column in enumerate(poses.T):
            off = column - (np.bincount(cell, weight * column) / each)[cell]
            sigma = np.sqrt(np.bincount(cell, weight * off**2) / each)
            columns[row] += SPREAD * sigma[cell[index]] * rng.standard_normal(len(index))
        columns[2] = wrap_angle(columns[2])
        log_weight = np.log(mass[cell[index]] / drawn[cell[index]]) + log_sum(self.particles.log_weight)
        return Candidates(replace(self.particles, columns=columns, log_weight=log_weight), self.rates[:, index])


def _log_mass(log_weight: Array, cell: NDArray[np.int64]) -> Array:
    """Return the logarithm (C,) of the weight in each cell; log_weight, cell: (N,)."""
    top = np.full(int(cell.max(initial=-1)) + 1, -np.inf)
    np.maximum.at(top, cell, log_weight)
    return np.asarray(top + np.log(np.bincount(cell, np.exp(log_weight - top[cell]))))
