"""The observation of vertical edges: log p(edges | particle) with unknown association.

Each measured edge is a draw from a mixture. With probability w it belongs to one of the n landmarks that the camera can
see from the pose, each as likely as the other. Else it is clutter, spread evenly over the field of view, and denser
where the last image showed the same thing (`clutter`):

    p(q_e | pose, w) = (1 - w) / span + (w / n) Σ_l c_el N(q_e; q_l(pose), σ_el²)

q is the bearing of the line held through the nadir point (`line`), or the lean of the free line (`slope`, the paper's
observation). σ_el² adds what the edge's measurement, the mount's common error and the landmark's position contribute.
c_el compares where the edge ends with where the landmark does (`association`), and their polarities: the rim of a
picture, high on a wall, is no door jamb.

How many edges are clutter differs from place to place, so w is not a parameter. The likelihood is computed for every
inlier rate of `inlier_rate`, which learns their distribution and integrates them out.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from localiser.camera import Camera
from localiser.edges import Edges
from localiser.geometry import Array, Increment, between, compose
from localiser.landmarks import LandmarkMap, in_camera
from localiser.observation import clutter, likelihood
from localiser.observation.association import Association, expected_from
from localiser.observation.clutter import EarlierFrame
from localiser.observation.frame import Frame
from localiser.observation.inlier_rate import DETECTION_RATES, INLIER_RATES, InlierRate
from localiser.observation.likelihood import View
from localiser.observation.sighting import EarlierImage, ObservationParameters, Sighting
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

    def frame(self, edges: Edges) -> Frame:
        """Return the edges of an image as they are compared, by the camera as it was mounted then."""
        return _frame(self, edges)

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
        frame, count = self.frame(sighting.edges), particles.columns.shape[1]
        if not len(frame.edges.bearing):
            return [np.zeros((len(view.rates), count)) for view in views]
        yaw = particles[CAMERA_YAW] if CAMERA_YAW in particles.names else np.zeros(count)
        columns = np.vstack([particles.columns[:3], yaw])
        return likelihood.by_views(frame, columns, sighting, landmark_map, views, blur_rad)

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
        frame = self.frame(sighting.edges)
        poses = frame.camera.pose_in_map(pose[None])
        expected = expected_from(frame, poses, landmark_map, sighting.map_scale)
        return Association.of(frame, sighting, landmark_map, expected)

    def associate_cloud(self, particles: Particles, sighting: Sighting, landmark_map: LandmarkMap) -> Association:
        """Return how the edges compare with the landmarks seen from the mean pose of particles.

        An angle is then also as uncertain as what those of the particles predict that face the landmark.
        """
        frame, few = self.frame(sighting.edges), thinned(particles, FEW)
        poses = frame.camera.pose_in_map(estimate(particles).pose_as_seen[None])
        expected = expected_from(frame, poses, landmark_map, sighting.map_scale)
        right, ahead = in_camera(camera_poses(frame.camera, few), landmark_map.points[expected.landmark])
        faced, weight = ahead > 0, few.weight
        predicted, _ = frame.predicted(right / np.where(faced, ahead, 1.0))
        total = np.maximum(weight @ faced, 1e-300)
        mean = weight @ (faced * predicted) / total
        spread_var = weight @ (faced * (predicted - mean) ** 2) / total
        return Association.of(frame, sighting, landmark_map, expected, spread_var)

    def scales(self, particles: Particles, sighting: Sighting, landmark_map: LandmarkMap) -> tuple[float, float]:
        """Return two angles (rad), medians over landmarks and edges: the spread of predictions, the measured sigma.

        Both are of the angle that is compared. (0, inf) where nothing is expected or nothing is measured.
        """
        few = take(particles, np.linspace(0, len(particles) - 1, FEW).astype(np.int64))
        frame = self.frame(sighting.edges)
        expected = expected_from(frame, camera_poses(frame.camera, few), landmark_map, sighting.map_scale)
        times = np.bincount(expected.landmark, minlength=len(landmark_map))
        often = times >= FEW / 2
        variance = frame.measured[1]
        if not often.any() or not np.isfinite(variance).any():
            return 0.0, np.inf
        mean, square = (
            np.bincount(expected.landmark, power, minlength=len(times))[often] / times[often]
            for power in (expected.angle, expected.angle**2)
        )
        sigma = np.sqrt(np.nanmedian(variance) + np.median(np.sqrt(expected.variance)) ** 2)
        return float(np.sqrt(np.median(np.maximum(square - mean**2, 0.0)))), float(sigma)

    # -- clutter ----------------------------------------------------------------------------------------------------

    def persistent_clutter(self, edges: Edges, seen: Sighting, increment: Increment, turn_var: float) -> Array:
        """Return how dense clutter is at each edge (E,), from the image before."""
        frame = self.frame(edges)
        return clutter.persistent_clutter(frame, self._earlier(frame, seen.edges, increment, turn_var), seen.clutter)

    def scene_clutter(self, sighting: Sighting, earlier: Sequence[EarlierImage]) -> tuple[Array, Array]:
        """Return how dense clutter is at each edge (E,), and how much likelier it is if it continues an earlier one.

        earlier: images of the same scene, the one that is believed most first; the others tell of edges that it missed.
        See `observation.clutter`.
        """
        frame = self.frame(sighting.edges)
        images = [self._earlier(frame, one.sighting.edges, one.since, one.turn_var) for one in earlier]
        return clutter.scene_clutter(frame, images)

    def _earlier(self, now: Frame, edges: Edges, since: Increment, turn_var: float) -> EarlierFrame:
        """Return the frame of an earlier image, and how the camera moved since, with the robot and on it."""
        frame = self.frame(edges)
        mount, then = now.camera.robot_from_level, frame.camera.robot_from_level
        right, back, _ = between(then, compose(since.mean, mount))
        return EarlierFrame(frame, np.array([right, back, since.mean[2] + (mount[2] - then[2])]), turn_var)


@lru_cache(maxsize=64)  # an image is asked for some forty times, and those of the last scenes with every image
def _frame(observation: EdgeObservation, edges: Edges) -> Frame:
    return Frame(edges, observation.camera.at(edges.mount), observation.parameters)


def camera_poses(camera: Camera, particles: Particles) -> Array:
    """Return the floor poses (N, 3) of the particles' cameras in the map, each with its own yaw on the mount."""
    poses = camera.pose_in_map(particles.poses)
    if CAMERA_YAW in particles.names:
        poses[:, 2] += particles[CAMERA_YAW]
    return poses
