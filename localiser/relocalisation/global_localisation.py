"""Global localisation: poses proposed from one image join the particles of a robot that may be lost.

The belief is a mixture: the truth is among the particles, or the robot may be anywhere, by the odds of being lost.
Poses of the second kind are drawn from `proposals`, or uniformly where an image shows too few edges. They are weighed
by the whole image, so

    their weight : that of the particles = odds of being lost · mean of prior/q · p(edges | pose)

By Bayes' rule they get almost no weight while the particles explain the edges. Several places are kept until one of
them has enough weight. The number of particles follows from the cells that they occupy [Fox 2003].

Places are compared by the filter's own likelihood, slightly blurred.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
from pydantic import Field

from localiser.edges import Edges
from localiser.geometry import Array, wrap_angle
from localiser.landmarks import LandmarkMap
from localiser.observation import InlierRate, LocalisesGlobally, Sighting
from localiser.particles import (
    CAMERA_YAW,
    POSE,
    Particles,
    enough_particles,
    log_sum,
    multinomial_resample,
    poses_per_cell,
    systematic_resample,
)
from localiser.relocalisation import evidence
from localiser.relocalisation.lost_probability import LostProbability
from localiser.relocalisation.mixture import Region
from localiser.relocalisation.places import Places
from localiser.relocalisation.proposals import FEWEST, propose
from localiser.relocalisation.views import View, view_of

CELL_M, CELL_RAD = 0.25, np.pi / 18  # of the histogram that the particles must fill
LEAST_NOVELTY = 0.1  # of an image that poses are proposed from
NEGLIGIBLE = 1e-3  # odds of the places that an image proposes, below which none of them joins
SEEN_FIRST = 10_000  # poses that the first image proposes
PAIRS_MOST = 2_000_000  # of particles and landmarks in an image
BESIDE_MAP_M = 3.0  # how far outside the landmarks a robot that looks at them may be
ALIKE = 0.5  # one jamb shows as two or three edges: what each of them tells on its own
BLUR_RAD = np.radians(0.1)  # how far from each other the particles of one place may be


@dataclass(frozen=True, slots=True)
class SearchParameters:
    """When global localisation is tried, and with how many poses."""

    carried: Annotated[
        float, Field(ge=0, lt=1, description="chance of being carried away, or led astray, between independent images")
    ] = 3e-4
    doubt: Annotated[
        float, Field(gt=0, lt=1, description="probability of being lost from which poses elsewhere are looked for")
    ] = 0.005
    fresh: Annotated[int, Field(ge=1, le=1_000_000, description="poses that an image proposes")] = 2000
    particles_most: Annotated[
        int, Field(ge=1, le=10_000_000, description="most particles while several places are possible")
    ] = 100_000


@dataclass(frozen=True, slots=True, eq=False)
class Clues:
    """What one image says of places: its edges for a likelihood, and the view of it for proposals."""

    view: View
    sighting: Sighting
    observation: LocalisesGlobally
    landmark_map: LandmarkMap

    @property
    def is_blind(self) -> bool:
        """Whether the image shows too little for poses to be proposed from it."""
        return len(self.view) < FEWEST

    def by_rate(self, particles: Particles) -> Array:
        """Return log p(edges | particle, w_k) (K, N) for every inlier share, relative to all edges being clutter."""
        return ALIKE * self.observation.by_rate(particles, self.sighting, self.landmark_map, BLUR_RAD)

    def by_pose(self, poses: Array) -> Array:
        """Return the same (K, N) for poses (N, 3) of a robot whose camera looks where it is stated to."""
        return self.by_rate(Particles(POSE, np.ascontiguousarray(poses.T), np.zeros(len(poses))))


@dataclass(frozen=True, slots=True, eq=False)
class GlobalLocalisation:
    """Everything about global localisation that stays the same during a run."""

    observation: LocalisesGlobally
    landmark_map: LandmarkMap
    places: Places
    parameters: SearchParameters

    @classmethod
    def of(
        cls, observation: LocalisesGlobally, landmark_map: LandmarkMap, parameters: SearchParameters | None = None
    ) -> GlobalLocalisation:
        """Return the global localisation on this map; its tables take a second on a large one."""
        sight, sigma_m = observation.parameters.sight, observation.parameters.landmark_sigma_m
        region = Region.around(landmark_map.points, BESIDE_MAP_M)
        places = Places.of(landmark_map, observation.camera, sight, region, sigma_m)
        return cls(observation, landmark_map, places, parameters or SearchParameters())

    @property
    def most(self) -> int:
        """The most particles that an image may take, so that it takes a bounded time however large the map is."""
        return min(self.parameters.particles_most, max(PAIRS_MOST // max(len(self.places), 1), SEEN_FIRST))

    def warm_up(self) -> None:
        """Compile what scores poses, or load it from the disk, so that no frame has to wait for it."""
        angle = np.zeros(1)
        edges = Edges.from_columns(angle, angle + 0.01, angle, angle + 0.01)
        clues = self.clues(Sighting(0, edges))
        clues.by_pose(np.zeros((1, 3)))
        evidence.warm_up(clues.view, self.places)

    def first_count(self, sighting: Sighting) -> int:
        """Return how many particles a robot that may be anywhere needs after its first image."""
        # Proposals are dense where the robot may be; blind draws must be so everywhere.
        return self.most if self.clues(sighting).is_blind else min(self.most, SEEN_FIRST)

    def clues(self, sighting: Sighting) -> Clues:
        """Return what an image says of places."""
        edges = replace(sighting.edges, clutter=np.ones(len(sighting.edges)))  # counted in full, at a power of a half
        view = view_of(self.observation.camera, edges, self.observation.parameters.kind)
        return Clues(view, replace(sighting, edges=edges), self.observation, self.landmark_map)

    def fresh(
        self, like: Particles, clues: Clues, inliers: InlierRate, count: int, rng: np.random.Generator
    ) -> tuple[Particles, float]:
        """Return `count` particles drawn over the whole region, weighed by all of the edges, and their log-evidence.

        like: particles whose other columns, constant errors that a robot keeps wherever it is, are drawn for the new
        ones. log-evidence: log of the mean of p(edges | pose) over the region, relative to all edges being clutter.
        """

        def log_likelihood(poses: Array) -> Array:
            return inliers.log_mean(clues.by_pose(poses))

        poses, log_prior_over_q = propose(clues.view, self.places, log_likelihood, rng).drawn(count, rng)
        log_weight = log_prior_over_q + log_likelihood(poses)
        others = multinomial_resample(like.weight, count, rng)
        drawn = replace(like, columns=like.columns[:, others], log_weight=log_weight)
        return placed(drawn, self._seeing_the_same(poses, drawn)), float(log_sum(log_weight) - np.log(count))

    def _seeing_the_same(self, poses: Array, particles: Particles) -> Array:
        """Return where robots (N, 3) are whose cameras, turned as the particles say, see what those at `poses` do."""
        if CAMERA_YAW not in particles.names:
            return poses
        turned, camera = poses.copy(), self.observation.camera
        turned[:, 2] = wrap_angle(poses[:, 2] - particles[CAMERA_YAW])
        turned[:, :2] += (camera.pose_in_map(poses) - camera.pose_in_map(turned))[:, :2]
        return turned

    def is_needed(self, lost: LostProbability, clues: Clues, novelty: float) -> bool:
        """Whether the robot may be lost and an image of this novelty can tell where else it may be."""
        return len(clues.view) > 0 and novelty >= LEAST_NOVELTY and lost.probability >= self.parameters.doubt

    def followed(
        self, moved: Particles, lost: LostProbability, clues: Clues, novelty: float, rng: np.random.Generator
    ) -> tuple[Particles, LostProbability, float]:
        """Return particles at several places weighed by an image, the probability of being lost and the log-evidence.

        Poses that the image proposes join them, unless those at the present places explain it far better.
        """
        by_rate = clues.by_rate(moved)
        weighed = replace(moved, log_weight=moved.log_weight + novelty * lost.inliers.log_mean(by_rate))
        log_evidence = log_sum(weighed.log_weight) - log_sum(moved.log_weight)
        log_odds = lost.log_odds - lost.log_evidence(by_rate, moved.log_weight)
        lost = lost.after(by_rate, moved.log_weight, novelty, self.parameters.carried)
        if not self.is_needed(lost, clues, novelty):
            return weighed, lost, log_evidence
        fresh, fresh_evidence = self.fresh(weighed, clues, lost.inliers, self.parameters.fresh, rng)
        log_odds += fresh_evidence  # both sides weighed by all of the image
        if log_odds < np.log(NEGLIGIBLE):
            return weighed, lost, log_evidence
        return joined(weighed, fresh, log_odds), lost.joined(log_odds), log_evidence + np.logaddexp(0.0, log_odds)


def placed(particles: Particles, poses: Array) -> Particles:
    """Return the particles at other poses (N, 3); their other columns stay."""
    columns = particles.columns.copy()
    columns[:3] = poses.T
    return replace(particles, columns=columns)


def joined(particles: Particles, others: Particles, log_odds: float) -> Particles:
    """Return both as one cloud, in which the others as a whole have exp(log_odds) times the weight of the first."""
    log_weight = particles.log_weight - log_sum(particles.log_weight)
    log_others = others.log_weight - log_sum(others.log_weight) + log_odds
    columns = np.concatenate([particles.columns, others.columns], axis=1)
    return replace(particles, columns=columns, log_weight=np.concatenate([log_weight, log_others]))


def resampled(particles: Particles, fewest: int, most: int, rng: np.random.Generator) -> Particles:
    """Return equally weighted particles, as many as the places they occupy need, each moved a little.

    A particle moves by its share of the cell that it lies in: the more there are in a cell, the less. So copies part,
    and a cloud far sparser than the edges are sharp is made as even as its number allows.
    """
    weight = particles.weight
    index = systematic_resample(weight, most, rng)
    enough = enough_particles(particles.poses[index], CELL_M, CELL_RAD)
    count = int(np.clip(enough, fewest, most))
    index = systematic_resample(weight, count, rng)
    poses = particles.poses[index]
    step = poses_per_cell(poses, CELL_M, CELL_RAD)[:, None] ** (-1.0 / 3.0) / np.sqrt(12.0)
    poses += rng.standard_normal(poses.shape) * step * [CELL_M, CELL_M, CELL_RAD]
    poses[:, 2] = wrap_angle(poses[:, 2])
    return placed(replace(particles, columns=particles.columns[:, index], log_weight=np.zeros(count)), poses)
