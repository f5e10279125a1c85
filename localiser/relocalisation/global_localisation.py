"""Global localisation: poses proposed from one image, weighed by all of its edges.

Hypotheses are poses at which two or three edges are landmarks (`hypotheses`). The best of them are found by the
filter's own likelihood L, blurred. Poses are drawn evenly from a box around each, with weights w₁ = prior / q. Then
the blur narrows in steps b: poses are drawn by w_b L_b(x), and moved a little to x', so that they gather where the
edges fit. As moves one way are as likely as the other way, the weight of a pose at the next step is that of all that it
is drawn from, divided by L_b(x) at where it came from: a sum of w L over poses is the evidence at every blur. Without
the last likelihood they are draws from the prior of a robot that may be anywhere. `history` weighs them by this image
and those before.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Annotated

import numpy as np
from pydantic import Field

from localiser.camera import Camera
from localiser.edges import Edges
from localiser.geometry import Array, wrap_angle
from localiser.landmarks import LandmarkMap
from localiser.observation import DetectionRate, EdgeObservation, InlierRate, Sighting
from localiser.particles import (
    CAMERA_YAW,
    CELL_M,
    CELL_RAD,
    POSE,
    Particles,
    cells_of,
    multinomial_resample,
)
from localiser.relocalisation.candidates import Candidates
from localiser.relocalisation.hypotheses import Feet, feet_of, from_markers, poses_of
from localiser.relocalisation.places import Places, Region

BESIDE_MAP_M = 3.0  # how far outside the landmarks a robot that looks at them may be
FEWEST = 5  # edges; fewer may all be clutter almost anywhere
MOST_EDGES = 48  # that poses are proposed from; all of them weigh these
POWER = 0.5  # of the likelihood: edges of an image err together, which the clutter model does not know
HYPOTHESES, PER_BOX = 12_500, 10  # tried by one image; poses drawn around each of the best
EVEN = 0.2  # as many poses again are drawn from the whole region
BOX = np.array([CELL_M, CELL_M, CELL_RAD])  # around a hypothesis: m, m, rad
MARKER_HITS = 3.0  # how many poses near the true one a marker gives that is where the map has it
BLUR_RAD = np.radians(0.3)  # how far from each other the particles of one place may be
SEARCH_BLUR_RAD = np.radians(0.4)  # how far off the bearings of a hypothesis may be
WIDER_RAD = np.radians([1.4, 0.65])  # the same of poses that are drawn around it, step by step
MOVED = np.array([1.0, 1.0, 0.5])  # how far they are moved between these steps: m, m, rad for each radian of the blur


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
    def feet(self) -> Feet:
        """The longest edges, which poses are proposed from. Few images of a robot that is not lost need it."""
        return feet_of(self.observation.frame(self.sighting.edges.longest(MOST_EDGES)))

    @cached_property
    def is_blind(self) -> bool:
        """Whether the image shows too little to tell that what it shows is not on the map."""
        return int(self.observation.frame(self.sighting.edges).is_known.sum()) < FEWEST

    def by_rate(self, particles: Particles, blur_rad: float = BLUR_RAD) -> Array:
        """Return log p(edges | particle, p_k) (K, N) for every detection rate, relative to clutter alone."""
        return POWER * self.observation.by_detection_rate(particles, self.sighting, self.landmark_map, blur_rad)

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

    def anywhere(self, particles: Particles, blur_rad: float = BLUR_RAD) -> Array:
        """Return log p(edges | particle) (N,) where nothing is known of the detection rate."""
        return DetectionRate.unknown().log_mean(self.by_rate(particles, blur_rad))


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
        region = Region.around(landmark_map.points, BESIDE_MAP_M)
        of = observation.parameters
        places = Places.of(landmark_map, of.sight, region, of.landmark_sigma_m)
        return cls(observation, landmark_map, places, parameters or SearchParameters())

    def warm_up(self) -> None:
        """Compile what scores poses, or load it from the disk, so that no frame has to wait for it."""
        angle = np.zeros(1)
        edges = Edges.from_columns(angle, angle + 0.01, angle, angle + 0.01)
        self.clues(Sighting(0, edges)).anywhere(Particles(POSE, np.zeros((3, 1)), np.zeros(1)))

    def clues(self, sighting: Sighting) -> Clues:
        """Return what an image says of places."""
        return Clues(sighting, self.observation, self.landmark_map)

    def proposed(
        self, like: Particles, clues: Clues, effort: float, rng: np.random.Generator
    ) -> tuple[Candidates | None, float]:
        """Return candidates drawn where the edges of an image fit the map, and the expected hits.

        Poses that explain the edges no better than clutter does are left out; None where all do. The weight of the
        others is that of importance sampling, so that a sum over candidates is a mean over the region. like: particles
        whose other columns, constant errors that a robot keeps wherever it is, are drawn for the candidates. effort:
        how much is tried, 1 for an image that stands for itself. Expected hits: how many of the hypotheses are the true
        pose, if it is in the region.
        """
        tried, hits = poses_of(clues.feet, self.places, round(effort * HYPOTHESES), rng)
        by_marker = clues.feet.robot_poses(from_markers(clues.feet.camera, clues.sighting.edges, self.landmark_map))
        by_marker = by_marker[self.places.region.contains(by_marker)]
        if len(by_marker):
            tried, hits = np.concatenate([by_marker, tried]), hits + MARKER_HITS
        if len(tried) == 0:
            return None, hits
        count = max(round(effort * self.parameters.fresh), 1)
        likeliest = np.argsort(-clues.anywhere(_at(tried), SEARCH_BLUR_RAD), kind="stable")
        _, first = np.unique(cells_of(tried[likeliest]), return_index=True)
        best = tried[likeliest[np.sort(first)[: -(-count // PER_BOX)]]]
        even = evenly_around(best, self.places.region, rng)
        if len(even) == 0:
            return None, hits
        cloud = Particles((*POSE, "log_fit"), np.vstack([even.columns, np.zeros(len(even))]), even.log_weight)
        for blur_rad in WIDER_RAD:
            log_fit = clues.anywhere(cloud, blur_rad)
            cloud = replace(cloud, log_weight=cloud.log_weight + log_fit - cloud["log_fit"])
            cloud.columns[3] = log_fit  # the copies keep that of where they come from
            cloud = Candidates.unknown(cloud).resampled(count, rng).particles
            cloud.columns[:3] += (blur_rad * MOVED)[:, None] * rng.standard_normal((3, len(cloud)))
        # What no box covers has a small likelihood at very many poses: without it, off the map becomes too likely.
        beside = self.places.region.drawn(round(EVEN * count), rng)
        poses = np.concatenate([cloud.poses, beside[_boxes_at(beside, best) == 0]])
        poses[:, 2] = wrap_angle(poses[:, 2])
        log_weight = np.full(len(poses), -np.log(max(len(beside), 1)))
        log_weight[: len(cloud)] = cloud.log_weight - cloud["log_fit"]
        fits = clues.anywhere(_at(poses)) > 0.0
        if not fits.any():
            return None, hits
        return Candidates.unknown(self._robots(like, poses[fits], log_weight[fits], clues.feet.camera, rng)), hits

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


def evenly_around(centres: Array, region: Region, rng: np.random.Generator) -> Particles:
    """Return poses drawn evenly, `PER_BOX` from each box around poses (K, 3): those in the region.

    Their weights sum to the prior probability of what the boxes, which may overlap, cover of the region.
    """
    poses = np.repeat(centres, PER_BOX, axis=0)
    poses += BOX * rng.uniform(-0.5, 0.5, poses.shape)
    poses = poses[region.contains(poses)]
    poses[:, 2] = wrap_angle(poses[:, 2])
    log_weight = region.log_density + np.log(BOX.prod() / PER_BOX / _boxes_at(poses, centres))
    return replace(_at(poses), log_weight=log_weight)


def _boxes_at(poses: Array, centres: Array) -> Array:
    """Return how many of the boxes around poses (K, 3) each of the poses (N, 3) is in."""
    boxes = np.zeros(len(poses))
    for centre in centres:
        apart = poses - centre
        apart[:, 2] = wrap_angle(apart[:, 2])
        boxes += (np.abs(apart) <= 0.5 * BOX + 1e-9).all(axis=1)
    return boxes


def _at(poses: Array) -> Particles:
    """Return particles at robot poses (N, 3), of a camera that looks where it is stated to."""
    return Particles(POSE, np.ascontiguousarray(poses.T), np.zeros(len(poses)))
