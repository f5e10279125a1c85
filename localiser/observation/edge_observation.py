"""The observation of vertical edges: log p(edges | particle) with unknown association.

Each measured edge is a draw from a mixture. With probability w it belongs to one of the n landmarks that the camera can
see from the pose, each as likely as the other. Else it is clutter, spread evenly over the field of view, and denser
where the last image showed the same thing (`persistent_clutter`):

    p(q_e | pose, w) = (1 - w) / span + (w / n) Σ_l c_el N(q_e; q_l(pose), σ_el²)

q is the bearing of the line held through the nadir point (`line`), or the lean of the free line (`slope`, the paper's
observation). σ_el² adds what the edge's measurement, the mount's common error and the landmark's position contribute.
c_el compares where the edge ends with where the landmark does (`endpoint_likelihood`), and their polarities: the rim of
a picture, high on a wall, is no door jamb.

How many edges are clutter differs from place to place, so w is not a parameter. The likelihood is computed for every
inlier rate of `inlier_rate`, which learns their distribution and integrates them out.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import Any, Self

import numpy as np

from localiser.camera import Camera
from localiser.edges import Edges
from localiser.geometry import Array, Increment, between, compose
from localiser.landmarks import LandmarkMap, field_of_view_rad, in_camera
from localiser.observation import likelihood
from localiser.observation.angle import Angle
from localiser.observation.association import Association, expected_from
from localiser.observation.detection_rate import DETECTION_RATES
from localiser.observation.inlier_rate import INLIER_RATES, InlierRate
from localiser.observation.likelihood import View
from localiser.observation.parameters import ObservationParameters
from localiser.observation.persistent_clutter import clutter_density
from localiser.observation.scene_clutter import EarlierEdges, scene_clutter
from localiser.observation.sighting import EarlierImage, Sighting
from localiser.particles import CAMERA_YAW, POSE, Particles, estimate, take, thinned

FEW = 64  # particles that tell how wide the cloud is


@dataclass(frozen=True, eq=False)
class EdgeObservation:
    """The observation of vertical edges, as `slope` or as `line`, seen by one camera.

    An image whose edges state a mount of their own is seen by the camera as it was mounted then. With
    `parameters.association` known, an edge is of the landmark that it names, or clutter; others tell nothing.
    """

    camera: Camera
    parameters: ObservationParameters

    def at(self, edges: Edges) -> Self:
        """Return the observation by the camera as it was mounted when it took the image of these edges."""
        camera = self.camera.at(edges.mount)
        found: Self = self if camera is self.camera else _mounted(self, camera)
        return found

    @cached_property
    def angle(self) -> Angle:
        """The angle that is compared."""
        return Angle(self.camera, self.parameters.kind)

    def on_processors(self, most: int) -> EdgeObservation:
        """Return the same, which weighs by as many threads as there are processors; results do not depend on it.

        most: threads, unless the parameters ask for more.
        """
        threads = max(self.parameters.threads, min(os.cpu_count() or 1, most))
        return replace(self, parameters=replace(self.parameters, threads=threads))

    # -- likelihood -------------------------------------------------------------------------------------------------

    def log_likelihood(self, particles: Particles, sighting: Sighting, landmark_map: LandmarkMap) -> Array:
        """Return log p(edges | particle) (N,), relative to all edges being clutter; the inlier rate is unknown."""
        return InlierRate.unknown().log_mean(self.by_rate(particles, sighting, landmark_map))

    def by_rate(
        self, particles: Particles, sighting: Sighting, landmark_map: LandmarkMap, blur_rad: float = 0.0
    ) -> Array:
        """Return log p(edges | particle, w_k) (K, N) for every inlier rate, relative to all edges being clutter.

        blur_rad: sigma of the compared angle that is added to every edge's own.
        """
        view = View(INLIER_RATES, True, sighting.persistent)
        return self.by_views(particles, sighting, landmark_map, [view], blur_rad)[0]

    def by_detection_rate(
        self, particles: Particles, sighting: Sighting, landmark_map: LandmarkMap, blur_rad: float = 0.0
    ) -> Array:
        """Return log p(edges | particle, p_k) (K, N) for every detection rate, relative to all edges being clutter.

        The edges are a Poisson process. E of them are expected to be clutter, and each of the n landmarks in view shows
        p edges on average. Given the number of edges,

            p(edges | pose, p) ∝ Π_e [E / span + p Σ_l c_el N(q_e; q_l(pose), σ_el²)] / (E + p n)^E

        So a pose that sees no landmark explains the edges as well as clutter does. Clutter is that of the scene.
        """
        view = View(DETECTION_RATES, False, sighting.scene)
        return self.by_views(particles, sighting, landmark_map, [view], blur_rad)[0]

    def by_views(
        self,
        particles: Particles,
        sighting: Sighting,
        landmark_map: LandmarkMap,
        views: Sequence[View],
        blur_rad: float = 0.0,
    ) -> list[Array]:
        """Return log p(edges | particle, rate_k) (K, N) in each view, in little more time than in one."""
        if len(sighting.edges) == 0:
            return [np.zeros((len(view.rates), len(particles))) for view in views]
        yaw = particles[CAMERA_YAW] if CAMERA_YAW in particles.names else np.zeros(len(particles))
        columns, angle = np.vstack([particles.columns[:3], yaw]), self.at(sighting.edges).angle
        return likelihood.by_views(angle, self.parameters, columns, sighting, landmark_map, views, blur_rad)

    def camera_poses(self, particles: Particles) -> Array:
        """Return the floor poses (N, 3) of the particles' cameras in the map, each with its own yaw on the mount."""
        poses = self.camera.pose_in_map(particles.poses)
        if CAMERA_YAW in particles.names:
            poses[:, 2] += particles[CAMERA_YAW]
        return poses

    def warm_up(self) -> None:
        """Compile what compares edges, or load it from the disk, so that no frame has to wait for it."""
        angle = np.zeros(1)
        sighting = Sighting(0, Edges.from_columns(angle, angle + 0.01, angle, angle + 0.01))
        one = Particles(POSE, np.zeros((3, 1)), angle)
        self.by_rate(one, sighting, LandmarkMap.from_points(np.array([[0.0, -3.0]])))
        self.scene_clutter(sighting, [EarlierImage(sighting, Increment.from_mean(np.zeros(3)), 0.0)])

    # -- association ------------------------------------------------------------------------------------------------

    def associate(self, pose: Array, sighting: Sighting, landmark_map: LandmarkMap) -> Association:
        """Return how the edges compare with the landmarks that are seen from one robot pose (3,)."""
        angle = self.at(sighting.edges).angle
        poses = angle.camera.pose_in_map(pose[None])
        expected = expected_from(angle, self.parameters, poses, landmark_map, sighting.map_scale)
        return Association.of(angle, self.parameters, sighting, landmark_map, expected)

    def associate_prior(self, particles: Particles, sighting: Sighting, landmark_map: LandmarkMap) -> Association:
        """Return how the edges compare with the landmarks seen from the mean pose of particles.

        An angle is then also as uncertain as what those of the particles predict that face the landmark.
        """
        self = self.at(sighting.edges)  # noqa: PLW0642
        poses = self.camera.pose_in_map(estimate(particles).pose_as_seen[None])
        expected = expected_from(self.angle, self.parameters, poses, landmark_map, sighting.map_scale)
        few = thinned(particles, FEW)
        right, ahead = in_camera(self.camera_poses(few), landmark_map.points[expected.landmark])
        faced, weight = ahead > 0, few.weight
        predicted, _ = self.angle.predicted(right / np.where(faced, ahead, 1.0))
        total = np.maximum(weight @ faced, 1e-300)
        mean = weight @ (faced * predicted) / total
        spread_var = weight @ (faced * (predicted - mean) ** 2) / total
        return Association.of(self.angle, self.parameters, sighting, landmark_map, expected, spread_var)

    def scales(self, particles: Particles, sighting: Sighting, landmark_map: LandmarkMap) -> tuple[float, float]:
        """Return two angles (rad), medians over landmarks and edges: the spread of predictions, the measured sigma.

        Both are of the angle that is compared. (0, inf) where nothing is expected or nothing is measured.
        """
        self = self.at(sighting.edges)  # noqa: PLW0642
        few = take(particles, np.linspace(0, len(particles) - 1, FEW).astype(np.int64))
        poses = self.camera_poses(few)
        expected = expected_from(self.angle, self.parameters, poses, landmark_map, sighting.map_scale)
        times = np.bincount(expected.landmark, minlength=len(landmark_map))
        often = times >= FEW / 2
        variance = self.angle.measured(sighting.edges)[1]
        if not often.any() or not np.isfinite(variance).any():
            return 0.0, np.inf
        mean, square = (
            np.bincount(expected.landmark, power, minlength=len(times))[often] / times[often]
            for power in (expected.angle, expected.angle**2)
        )
        sigma = np.sqrt(np.nanmedian(variance) + np.median(np.sqrt(expected.variance)) ** 2)
        return float(np.sqrt(np.median(np.maximum(square - mean**2, 0.0)))), float(sigma)

    # -- clutter ----------------------------------------------------------------------------------------------------

    def persistent_clutter(self, edges: Edges, before: Edges, increment: Increment, turn_var: float) -> Array:
        """Return how dense clutter is at each edge (E,), from the edges of the image before."""
        now, then = self.at(edges), self.at(before)
        measured = *now.angle.bearings(edges), *then.angle.bearings(before)
        motion, span_rad = _camera_motion(then.camera, now.camera, increment), field_of_view_rad(now.camera)
        return clutter_density(*measured, motion, turn_var, span_rad)

    def scene_clutter(self, sighting: Sighting, earlier: Sequence[EarlierImage]) -> tuple[Array, Array]:
        """Return how dense clutter is at each edge (E,), and how much likelier it is if it continues an earlier one.

        earlier: images of the same scene, the one that is believed most first; the others tell of edges that it missed.
        See `observation.scene_clutter`.
        """
        now, images = self.at(sighting.edges), []
        for one in earlier:
            edges, then = one.sighting.edges, self.at(one.sighting.edges)
            images.append(
                EarlierEdges(edges, _camera_motion(then.camera, now.camera, one.since), one.turn_var, then.camera)
            )
        return scene_clutter(now.angle, sighting.edges, images)


@lru_cache(maxsize=16)
def _mounted(observation: Any, camera: Camera) -> Any:
    return replace(observation, camera=camera)


def _camera_motion(before: Camera, now: Camera, increment: Increment) -> Array:
    """Return how the camera moved (3,), in its own frame before, while the robot did, and the camera on the robot."""
    mount, then = now.robot_from_level, before.robot_from_level
    right, back, _ = between(then, compose(increment.mean, mount))
    return np.array([right, back, increment.mean[2] + (mount[2] - then[2])])
