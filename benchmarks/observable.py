"""Whether what a robot has seen can tell it where it is at all: a grid filter that is fine only where it must be.

The belief over (x, z, heading) is a mass in every cell that matters, with the mean pose of that mass, so that motions
smaller than a cell are not rounded away. It begins even over the map on coarse cells, whose edges are blurred by as
much as predictions differ within a cell; the best are split in eight, down to `FINEST`. Nothing is drawn at random and
nothing is proposed, so it knows nothing of the filter that it judges, beyond the likelihood that both share.
[Thrun, Burgard, Fox 2005, table 8.1; Burgard, Derr, Fox, Cremers 1998: selective updating]
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray
from scenarios import Trial

from localiser import geometry, motion
from localiser.edges import Edges
from localiser.geometry import Array, Increment, Trajectory
from localiser.landmarks import LandmarkMap
from localiser.motion import MotionParameters
from localiser.observation import EdgeObservation, Sighting, novelty_of
from localiser.observation.inlier_rate import InlierRate
from localiser.particles import POSE, Particles

LEVELS = 4
FINEST = np.array([0.03, 0.03, np.deg2rad(0.6)])
MARGIN_M = 0.5  # around the landmarks
NEGLIGIBLE = 1e-6  # of the heaviest cell: what is lighter is dropped
NEAR_M, ENOUGH = 0.5, 0.9  # known is a place that this share of the mass is near to
MOST_SPLIT = 50_000  # cells of a level that are looked into
_TYPICAL_M = 3.0  # range of an edge, for how much a cell's width moves its bearing


@dataclass(frozen=True, slots=True, eq=False)
class Masses:
    """C cells: mean pose (C, 3) and logarithm of the mass (C,) of each; width (3,) of a cell in x, z, heading."""

    poses: Array
    log_mass: Array
    width: Array

    @classmethod
    def even(cls, landmark_map: LandmarkMap) -> Masses:
        """Return the same mass in every cell around the landmarks, as coarse as the first level."""
        width = FINEST * 2 ** (LEVELS - 1)
        low, high = landmark_map.points.min(axis=0) - MARGIN_M, landmark_map.points.max(axis=0) + MARGIN_M
        axes = [np.arange(a + w / 2, b, w) for a, b, w in zip(low, high, width[:2], strict=True)]
        axes.append(np.arange(-np.pi, np.pi - width[2] / 2, width[2]))
        poses = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
        return cls(poses, np.zeros(len(poses)), width)

    @property
    def mass(self) -> Array:
        """Share (C,) of each cell."""
        mass = np.exp(self.log_mass - self.log_mass.max())
        return np.asarray(mass / mass.sum())

    @property
    def blur_rad(self) -> float:
        """How much a bearing differs within a cell, as one sigma."""
        return float(np.hypot(self.width[0] / _TYPICAL_M, self.width[2]) / np.sqrt(12.0))

    def only(self, chosen: NDArray[np.int64] | NDArray[np.bool_], log_mass: Array) -> Masses:
        """Return the chosen cells, with other masses (C,)."""
        return Masses(self.poses[chosen], log_mass[chosen], self.width)

    def split(self) -> Masses:
        """Return the masses in cells of half the width."""
        offset = np.array(list(product((-0.25, 0.25), repeat=3))) * self.width
        poses = (self.poses[:, None] + offset).reshape(-1, 3)
        poses[:, 2] = geometry.wrap_angle(poses[:, 2])
        return Masses(poses, np.repeat(self.log_mass, len(offset)), self.width / 2)

    def moved(self, increment: Increment, noise_cov: Array) -> Masses:
        """Return the masses after a motion + N(0, noise_cov (3, 3)), both in the robot's frame.

        The noise is three points along each of its axes, as Gauss and Hermite have them; cells are then filled anew.
        """
        variance, axes = np.linalg.eigh(noise_cov)
        steps, weights = np.array([-np.sqrt(3.0), 0.0, np.sqrt(3.0)]), np.log([1 / 6, 2 / 3, 1 / 6])
        grid = list(product(range(3), repeat=3))
        offsets = np.array([axes @ (np.sqrt(np.maximum(variance, 0.0)) * steps[list(k)]) for k in grid])
        poses = geometry.compose(self.poses[:, None], increment.mean + offsets).reshape(-1, 3)
        log_mass = (self.log_mass[:, None] + np.array([weights[list(k)].sum() for k in grid])).ravel()
        return Masses(poses, log_mass, self.width)._gathered()

    def near(self) -> float:
        """Return the largest share of the mass that lies within 0.5 m of any one of the heaviest cells."""
        mass = self.mass
        heaviest = np.argsort(-mass)[:50]
        distance = np.hypot(*(self.poses[heaviest, None, :2] - self.poses[None, :, :2]).transpose(2, 0, 1))
        return float(((distance < NEAR_M) @ mass).max())

    def _gathered(self) -> Masses:
        """Return one mass for every cell, at the mean of what fell into it."""
        x, z, heading = np.floor((self.poses - self.poses.min(axis=0)) / self.width).astype(np.int64).T
        cell = (x * (z.max() + 1) + z) * (heading.max() + 1) + heading
        _, first, of = np.unique(cell, return_index=True, return_inverse=True)
        mass = np.exp(self.log_mass - self.log_mass.max())
        total = np.bincount(of, mass)
        origin = self.poses[first]
        residual = self.poses - origin[of]
        residual[:, 2] = geometry.wrap_angle(residual[:, 2])
        mean = origin + np.stack([np.bincount(of, mass * part) for part in residual.T], axis=1) / total[:, None]
        mean[:, 2] = geometry.wrap_angle(mean[:, 2])
        return Masses(mean, np.log(total), self.width)


def beliefs(
    observation: EdgeObservation,
    landmark_map: LandmarkMap,
    odometry: Trajectory,
    frames: list[Edges],
    parameters: MotionParameters,
) -> Iterator[Masses]:
    """Yield the belief after each image, of a robot that may be anywhere at the first one."""
    masses, share = Masses.even(landmark_map), 1.0
    for number, edges in enumerate(frames):
        if number:
            increment = Increment.from_mean(geometry.between(odometry.poses[number - 1], odometry.poses[number]))
            _, noise_cov = motion.linearised(np.zeros(3), increment, parameters)
            masses, share = masses.moved(increment, noise_cov), novelty_of(increment, observation.parameters)
        masses = _weighed(observation, landmark_map, masses, edges, share)
        yield masses


def is_observable(trial: Trial, observation: EdgeObservation, parameters: MotionParameters, frame: int) -> bool:
    """Whether images up to `frame` leave 90 % of the belief within 0.5 m of some pose."""
    images = slice(None, frame + 1)
    odometry = Trajectory(trial.odometry.t_ns[images], trial.odometry.poses[images])
    *_, last = beliefs(observation, trial.landmark_map, odometry, trial.frames[images], parameters)
    return last.near() >= ENOUGH


def _weighed(
    observation: EdgeObservation, landmark_map: LandmarkMap, masses: Masses, edges: Edges, share: float
) -> Masses:
    """Return the masses weighed by an image, on cells as fine as their number allows."""
    while True:
        particles = Particles(POSE, masses.poses.T.copy(), np.zeros(len(masses.poses)))
        by_rate = observation.by_rate(particles, Sighting(0, edges), landmark_map, masses.blur_rad)
        log_mass = masses.log_mass + share * InlierRate.unknown().log_mean(by_rate)
        if masses.width[0] <= FINEST[0]:
            return masses.only(log_mass > log_mass.max() + np.log(NEGLIGIBLE), log_mass)
        # A blurred likelihood is no bound: it only says which cells to look into, not how much lies in each.
        best = np.argsort(-log_mass, kind="stable")[:MOST_SPLIT]
        masses = masses.only(best, masses.log_mass).split()
