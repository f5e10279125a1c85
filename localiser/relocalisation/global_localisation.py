"""Global localisation: poses proposed from one image, weighed by all of its edges; steps: docs/relocalisation.md.

While the blur of the likelihood L narrows, poses that are moved one way are as likely moved the other way. So the
weight w of a pose is that of all that it is drawn from, divided by L at where it came from: a sum of w L over poses is
the evidence at every blur. Without the last likelihood they are draws from the prior.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from localiser.camera import Camera
from localiser.geometry import Array, Indices, between, compose, wrap_angle
from localiser.landmarks import LandmarkMap
from localiser.observation import FEWEST_EDGES, UNKNOWN_RATE, EdgeObservation, Sighting, log_sum_of_rates
from localiser.particles import CAMERA_YAW, CELL_M, CELL_RAD, POSE, Particles, cells_of, multinomial_resample
from localiser.relocalisation.candidates import Candidates
from localiser.relocalisation.hypotheses import Feet, LandmarkPairs, from_bearings, from_feet, from_markers

BESIDE_MAP_M = 3.0  # how far outside the landmarks a robot that looks at them may be
MOST_EDGES = 48  # that poses are proposed from; all of them weigh these
PLACE_POWER = 0.5  # of the likelihood: edges of an image err together, which the clutter model does not know
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


@dataclass(frozen=True, slots=True, eq=False)
class Region:
    """Where the robot may be before anything is seen: every pose from `low` to `high` (3,), all alike."""

    low: Array
    high: Array

    @property
    def log_density(self) -> float:
        """Logarithm of the prior density inside, per m² rad."""
        return float(-np.log(np.prod(self.high - self.low)))

    def contains(self, poses: Array) -> NDArray[np.bool_]:
        """Return which of the poses (N, 3) lie inside, whatever their heading."""
        return np.asarray(((poses >= self.low) & (poses <= self.high))[:, :2].all(axis=1))

    def drawn(self, count: int, rng: np.random.Generator) -> Array:
        """Return poses (count, 3) drawn evenly."""
        return rng.uniform(self.low, self.high, (count, 3))


@dataclass(frozen=True, slots=True, eq=False)
class GlobalLocalisation:
    """Everything about global localisation that stays the same during a run."""

    observation: EdgeObservation
    landmark_map: LandmarkMap
    parameters: SearchParameters
    pairs: LandmarkPairs
    region: Region

    @classmethod
    def of(
        cls, observation: EdgeObservation, landmark_map: LandmarkMap, parameters: SearchParameters | None = None
    ) -> GlobalLocalisation:
        """Return the global localisation on this map; its tables take a second on a large one."""
        points, pairs = landmark_map.points, LandmarkPairs.of(landmark_map, observation.parameters)
        low, high = points.min(axis=0) - BESIDE_MAP_M, points.max(axis=0) + BESIDE_MAP_M
        region = Region(np.append(low, -np.pi), np.append(high, np.pi))
        return cls(observation, landmark_map, parameters or SearchParameters(), pairs, region)

    # -- what an image says of poses ----------------------------------------------------------------------------------

    def known_edges(self, sighting: Sighting) -> int:
        """Return of how many edges of an image the angle is known."""
        return int(self.observation.frame(sighting.edges).is_known.sum())

    def evidence(self, particles: Particles, sighting: Sighting, blur_rad: float = BLUR_RAD) -> tuple[Array, bool]:
        """Return log p(edges | particle, p_k) (K, N) for every detection rate, relative to clutter alone.

        The second value is whether there are so many edges that some are of landmarks, if any is in view.
        """
        every = np.ones((1, len(self.landmark_map)))
        (by_rate,) = self.observation.by_views(particles, sighting, self.landmark_map, every, blur_rad)
        return PLACE_POWER * by_rate, self.known_edges(sighting) >= FEWEST_EDGES

    def log_fit(self, poses: Array, sighting: Sighting, blur_rad: float = BLUR_RAD) -> Array:
        """Return log p(edges | pose) (N,) of poses (N, 3), whatever the detection rate; the camera looks as stated."""
        particles = Particles(POSE, np.ascontiguousarray(poses.T), np.zeros(len(poses)))
        return log_sum_of_rates(self.evidence(particles, sighting, blur_rad)[0] + np.log(UNKNOWN_RATE)[:, None])

    # -- where a robot may be that is lost ----------------------------------------------------------------------------

    def proposed(
        self, like: Particles, sighting: Sighting, effort: float, rng: np.random.Generator
    ) -> tuple[Candidates, float]:
        """Return candidates, perhaps none, drawn where the edges of an image fit the map, and the expected hits.

        Their weight is that of importance sampling, so that a sum over candidates is a mean over the region. like:
        particles whose other columns, constant errors that a robot keeps wherever it is, are drawn for the candidates.
        effort: how much is tried, 1 for an image that stands for itself. Expected hits: how many of the hypotheses are
        the true pose, if it is in the region.
        """
        camera, region = self.observation.camera.at(sighting.edges.mount), self.region
        tried, hits = self._hypotheses(camera, sighting, round(effort * HYPOTHESES), rng)
        if len(tried) == 0:
            return self.even(like, 0, rng), hits
        count = max(round(effort * self.parameters.fresh), 1)
        tried = tried[np.argsort(-self.log_fit(tried, sighting, SEARCH_BLUR_RAD), kind="stable")]
        _, first = np.unique(cells_of(tried), return_index=True)
        best = tried[np.sort(first)[: -(-count // PER_BOX)]]
        poses, log_weight = evenly_around(best, region, rng)
        if len(poses) == 0:
            return self.even(like, 0, rng), hits
        cloud = Particles((*POSE, "log_fit"), np.vstack([poses.T, np.zeros(len(poses))]), log_weight)
        for blur_rad in WIDER_RAD:
            log_fit = self.log_fit(cloud.poses, sighting, blur_rad)
            cloud = replace(cloud, log_weight=cloud.log_weight + log_fit - cloud["log_fit"])
            cloud.columns[3] = log_fit  # the copies keep that of where they come from
            cloud = Candidates.of(cloud).resampled(count, rng).particles
            cloud.columns[:3] += (blur_rad * MOVED)[:, None] * rng.standard_normal((3, len(cloud)))
        # What no box covers has a small likelihood at very many poses: without it, off the map becomes too likely.
        beside = region.drawn(round(EVEN * count), rng)
        poses = np.concatenate([cloud.poses, beside[_boxes_at(beside, best) == 0]])
        poses[:, 2] = wrap_angle(poses[:, 2])
        log_weight = np.full(len(poses), -np.log(max(len(beside), 1)))
        log_weight[: len(cloud)] = cloud.log_weight - cloud["log_fit"]
        fits = self.log_fit(poses, sighting) > 0.0
        return _seeing(camera, poses[fits], log_weight[fits], like, rng), hits

    def even(self, like: Particles, count: int, rng: np.random.Generator) -> Candidates:
        """Return `count` candidates drawn evenly over the region; like: as for `proposed`."""
        return _seeing(self.observation.camera, self.region.drawn(count, rng), np.zeros(count), like, rng)

    def _hypotheses(
        self, camera: Camera, sighting: Sighting, count: int, rng: np.random.Generator
    ) -> tuple[Array, float]:
        """Return robot poses (K, 3) in the region, and how many of those tried are expected to be the true one."""
        feet = Feet.of(self.observation.frame(sighting.edges.longest(MOST_EDGES)))
        by_marker = from_markers(sighting.edges, self.landmark_map)
        cameras, hits = from_feet(feet, self.pairs, count, rng)
        if len(cameras) < count // 2:
            by_bearings, more = from_bearings(feet, self.pairs, count - len(cameras), rng)
            cameras, hits = np.concatenate([cameras, by_bearings]), hits + more
        poses = compose(np.concatenate([by_marker, cameras]), between(camera.robot_from_level, np.zeros(3)))
        inside = self.region.contains(poses)
        return poses[inside], hits + MARKER_HITS * inside[: len(by_marker)].any()


def _seeing(camera: Camera, poses: Array, log_weight: Array, like: Particles, rng: np.random.Generator) -> Candidates:
    """Return candidates at which a camera that sits as stated sees what is seen from `poses` (N, 3).

    Their other columns are drawn from `like`. One of them may be the camera's yaw, for which the robot is turned.
    """
    columns = like.columns[:, multinomial_resample(like.weight, len(poses), rng)]
    turned = poses.copy()
    if CAMERA_YAW in like.names:
        turned[:, 2] = wrap_angle(poses[:, 2] - columns[like.names.index(CAMERA_YAW)])
        turned[:, :2] += (camera.pose_in_map(poses) - camera.pose_in_map(turned))[:, :2]
    columns[:3] = turned.T
    return Candidates.of(replace(like, columns=columns, log_weight=log_weight))


def evenly_around(centres: Array, region: Region, rng: np.random.Generator) -> tuple[Array, Array]:
    """Return poses (N, 3) drawn evenly, `PER_BOX` from each box around poses (K, 3), that are in the region.

    And their log-weights (N,): weights sum to the prior probability of what the boxes, which may overlap, cover of it.
    """
    poses = np.repeat(centres, PER_BOX, axis=0) + BOX * rng.uniform(-0.5, 0.5, (PER_BOX * len(centres), 3))
    poses = poses[region.contains(poses)]
    poses[:, 2] = wrap_angle(poses[:, 2])
    return poses, region.log_density + np.log(BOX.prod() / PER_BOX / _boxes_at(poses, centres))


def _boxes_at(poses: Array, centres: Array) -> Indices:
    """Return how many of the boxes around poses (K, 3) each of the poses (N, 3) is in."""
    from scipy.spatial import cKDTree

    one, other = cKDTree(poses[:, :2]), cKDTree(centres[:, :2])  # a loop over all boxes takes far longer
    near = one.sparse_distance_matrix(other, 0.5 * CELL_M + 1e-6, p=np.inf, output_type="ndarray")
    off = poses[near["i"]] - centres[near["j"]]
    off[:, 2] = wrap_angle(off[:, 2])
    return np.bincount(near["i"][(np.abs(off) <= 0.5 * BOX + 1e-9).all(axis=1)], minlength=len(poses))
