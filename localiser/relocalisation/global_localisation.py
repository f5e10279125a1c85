"""Global localisation: poses proposed from one image, weighed by all of its edges.

Poses are drawn from `proposals`, or uniformly where an image shows too few edges. Their weights

    prior(x) / q(x)

make them draws from the prior of a robot that may be anywhere. `history` weighs them by this image and those before.
Places are compared by the filter's own likelihood, slightly blurred, and to a power below one.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from localiser.camera import Camera
from localiser.edges import Edges
from localiser.geometry import Array, wrap_angle
from localiser.landmarks import LandmarkMap
from localiser.observation import DetectionRate, EdgeObservation, InlierRate, Sighting
from localiser.particles import CAMERA_YAW, POSE, Particles, multinomial_resample
from localiser.relocalisation import evidence
from localiser.relocalisation.candidates import Candidates
from localiser.relocalisation.mixture import Region
from localiser.relocalisation.places import Places
from localiser.relocalisation.proposals import FEWEST, ProposalParameters, propose
from localiser.relocalisation.views import View, are_known, view_of

PAIRS_MOST = 2_000_000  # of particles and landmarks in an image
FEWEST_POSES = 10_000  # that an image may take on however large a map
BESIDE_MAP_M = 3.0  # how far outside the landmarks a robot that looks at them may be
MOST_EDGES = 48  # that poses are proposed from; all of them weigh these
POWER = 0.5  # of the likelihood: edges of an image err together, which the clutter model does not know
BLUR_RAD = np.radians(0.3)  # how far from each other the particles of one place may be


@dataclass(frozen=True, slots=True)
class SearchParameters:
    """When global localisation is tried, and with how many poses."""

    carried: Annotated[
        float,
        Field(ge=0, lt=1, description="chance of being carried away, or led astray, between two scenes (0.3 m or 12°)"),
    ] = 3e-4
    doubt: Annotated[
        float, Field(gt=0, lt=1, description="probability of being lost from which poses elsewhere are looked for")
    ] = 0.005
    fresh: Annotated[int, Field(ge=1, le=1_000_000, description="poses that the images of one scene propose")] = 1000
    particles_most: Annotated[
        int, Field(ge=1, le=10_000_000, description="most particles while several places are possible")
    ] = 8000


@dataclass(frozen=True, eq=False)
class Clues:
    """What one image says of places: its edges for a likelihood, and the view of it for proposals.

    sighting: as the filter weighs tracked particles by it.
    """

    sighting: Sighting
    observation: EdgeObservation
    landmark_map: LandmarkMap

    @cached_property
    def view(self) -> View:
        """The longest edges, which poses are proposed from. Few images of a robot that is not lost need it."""
        return view_of(*self._longest)

    @cached_property
    def _longest(self) -> tuple[Camera, Edges, Literal["line", "slope"]]:
        edges = self.sighting.edges
        return self.observation.camera.at(edges.mount), edges.longest(MOST_EDGES), self.observation.parameters.kind

    @cached_property
    def is_blind(self) -> bool:
        """Whether the image shows too little for poses to be proposed from it."""
        return int(are_known(*self._longest).sum()) < FEWEST

    def by_rate(self, particles: Particles) -> Array:
        """Return log p(edges | particle, p_k) (K, N) for every detection rate, relative to clutter alone."""
        return POWER * self.observation.by_detection_rate(particles, self.sighting, self.landmark_map, BLUR_RAD)

    def as_tracked(self, particles: Particles) -> Array:
        """Return log p(edges | particle) (N,) as the filter weighs tracked particles.

        The inlier rate is that of an unknown place, as each place has another one.
        """
        return InlierRate.unknown().log_mean(self.observation.by_rate(particles, self.sighting, self.landmark_map))

    def blind_weight(self, particles: Particles, by_rate: Array) -> float:
        """Return the weight, 0 … 1, of the particles from which the map has nothing in view though many edges are seen.

        by_rate: (K, N) what `by_rate` returns of them.
        """
        return 0.0 if self.is_blind else float(particles.weight[(by_rate == 0.0).all(axis=0)].sum())

    def by_pose(self, poses: Array) -> Array:
        """Return the same (K, N) for poses (N, 3) of a robot whose camera looks where it is stated to."""
        return self.by_rate(Particles(POSE, np.ascontiguousarray(poses.T), np.zeros(len(poses))))


@dataclass(frozen=True, slots=True, eq=False)
class GlobalLocalisation:
    """Everything about global localisation that stays the same during a run."""

    observation: EdgeObservation
    landmark_map: LandmarkMap
    places: Places
    parameters: SearchParameters

    @classmethod
    def of(
        cls, observation: EdgeObservation, landmark_map: LandmarkMap, parameters: SearchParameters | None = None
    ) -> GlobalLocalisation:
        """Return the global localisation on this map; its tables take a second on a large one."""
        sight, sigma_m = observation.parameters.sight, observation.parameters.landmark_sigma_m
        region = Region.around(landmark_map.points, BESIDE_MAP_M)
        places = Places.of(landmark_map, observation.camera, sight, region, sigma_m)
        return cls(observation, landmark_map, places, parameters or SearchParameters())

    @property
    def most(self) -> int:
        """The most particles that an image may take, so that it takes a bounded time however large the map is."""
        return min(self.parameters.particles_most, max(PAIRS_MOST // max(len(self.places), 1), FEWEST_POSES))

    def warm_up(self) -> None:
        """Compile what scores poses, or load it from the disk, so that no frame has to wait for it."""
        angle = np.zeros(1)
        edges = Edges.from_columns(angle, angle + 0.01, angle, angle + 0.01)
        clues = self.clues(Sighting(0, edges))
        clues.by_pose(np.zeros((1, 3)))
        evidence.warm_up(clues.view, self.places)

    def clues(self, sighting: Sighting) -> Clues:
        """Return what an image says of places."""
        return _clues(self, sighting)

    def proposed(
        self, like: Particles, clues: Clues, effort: float, rng: np.random.Generator, *, is_first: bool = False
    ) -> tuple[Candidates | None, float]:
        """Return candidates drawn over the whole region, and the expected hits.

        Poses that explain the edges no better than clutter does are left out; None where all do. The weight of the
        others is that of importance sampling, so that a sum over candidates is a mean over the region. like: particles
        whose other columns, constant errors that a robot keeps wherever it is, are drawn for the candidates. effort:
        how much is tried, 1 for an image that stands for itself. is_first: whether nothing has been proposed before, so
        that draws must be dense everywhere. Expected hits: how many of the poses tried are the true one, if it is in
        the region.
        """
        count = self.most if is_first else max(round(effort * self.parameters.fresh), 1)
        unknown = DetectionRate.unknown()

        def log_likelihood(poses: Array) -> Array:
            return unknown.log_mean(clues.by_pose(poses))

        parameters = ProposalParameters().scaled(effort)
        places = self.places.seen_by(clues.view.camera)
        proposals = propose(clues.view, places, log_likelihood, rng, parameters)
        hits = proposals.expected_hits(count)
        poses, log_prior_over_q = proposals.drawn(count, rng)
        fits = (log_likelihood(poses) > 0.0) & np.isfinite(log_prior_over_q)
        if not fits.any():
            return None, hits
        log_weight = log_prior_over_q[fits] - float(np.log(count))
        return Candidates.unknown(self._robots(like, poses[fits], log_weight, clues.view.camera, rng)), hits

    def anywhere(self, like: Particles, count: int, rng: np.random.Generator) -> Candidates:
        """Return `count` candidates drawn evenly over the region; like: as for `proposed`."""
        poses = self.places.region.drawn(count, rng)
        return Candidates.unknown(self._robots(like, poses, np.zeros(count), self.observation.camera, rng))

    def _robots(
        self, like: Particles, poses: Array, log_weight: Array, camera: Camera, rng: np.random.Generator
    ) -> Particles:
        """Return particles at which a camera that sits as stated sees what is seen from `poses` (N, 3).

        Their other columns are drawn from `like`. One of them may be the camera's yaw, for which the robot is turned.
        """
        columns = like.columns[:, multinomial_resample(like.weight, len(poses), rng)]
        columns[:3] = poses.T
        if CAMERA_YAW in like.names:
            turned = poses.copy()
            turned[:, 2] = wrap_angle(poses[:, 2] - columns[like.names.index(CAMERA_YAW)])
            turned[:, :2] += (camera.pose_in_map(poses) - camera.pose_in_map(turned))[:, :2]
            columns[:3] = turned.T
        return replace(like, columns=columns, log_weight=log_weight)


@lru_cache(maxsize=32)  # the history asks the same images again
def _clues(search: GlobalLocalisation, sighting: Sighting) -> Clues:
    return Clues(sighting, search.observation, search.landmark_map)
