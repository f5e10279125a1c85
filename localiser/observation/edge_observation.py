"""The observation of vertical edges: log p(edges | particle) with unknown association.

Each measured edge is a draw from a mixture. With probability w it belongs to one of the n landmarks that the camera can
see from the pose, each as likely as the other. Else it is clutter, spread evenly over the field of view, and denser
where the last image showed the same thing (`persistent_clutter`):

    p(q_e | pose, w) = (1 - w) / span + (w / n) Σ_l c_el N(q_e; q_l(pose), σ_el²)

q is the bearing of the line held through the nadir point (`line`), or the lean of the free line (`slope`, the paper's
observation). σ_el² adds what the edge's measurement, the mount's common error and the landmark's position contribute.
c_el compares where the edge ends with where the landmark does (`endpoint_likelihood`), and their polarities
(`polarity`): the rim of a picture, high on a wall, is no door jamb.

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
from numpy.typing import NDArray

from localiser.camera import Camera
from localiser.edges import Edges
from localiser.geometry import Array, Increment, between, compose
from localiser.landmarks import (
    LandmarkMap,
    Sight,
    field_of_view_rad,
    image_heights,
    in_camera,
    sight,
    sigmas_m,
)
from localiser.observation import endpoint_likelihood as endpoints
from localiser.observation import likelihood, polarity
from localiser.observation.angle import Angle
from localiser.observation.detection_rate import DETECTION_RATES
from localiser.observation.inlier_rate import INLIER_RATES, InlierRate, log_sum_of_rates
from localiser.observation.parameters import ObservationParameters
from localiser.observation.persistent_clutter import clutter_density
from localiser.observation.protocols import EarlierImage, EndOffsets, Matches, Sighting, Targets
from localiser.observation.scene_clutter import EarlierEdges, scene_clutter
from localiser.particles import CAMERA_YAW, POSE, Particles, estimate, take, thinned

Indices = NDArray[np.int64]

SETTLED = 0.9  # probability of belonging to its landmark from which on an edge is a target of the optimal proposal
BESIDE_M = 0.15  # landmarks stand at most so far from where the map has them
_FAR_SIGMAS = 12.0  # beyond this a normal density is below 1e-31 of its peak: nothing beside clutter
_SHOWN = 0.5  # probability of being in the open from which on a landmark is told to be visible
_FEW = 64  # particles that tell how wide the cloud is


@dataclass(frozen=True, slots=True, eq=False)
class _Expected:
    """The landmarks that are seen from poses: P pairs of both.

    seen: the pairs. angle: (P,) at which each is expected (rad), variance: (P,) of it by the map (rad²). ends: (P, 2)
    upright heights of its lower and upper end, known: (P, 2) whether the map knows them. leaning: (P,) mean polarity.
    in_the_open: (P,) probability that no wall hides it.
    """

    seen: Sight
    angle: Array
    variance: Array
    ends: Array
    known: NDArray[np.bool_]
    leaning: Array
    in_the_open: Array

    @property
    def count(self) -> float:
        """How many landmarks are seen from one pose, at least 1."""
        return max(float(self.in_the_open.sum()), 1.0)


@dataclass(frozen=True, eq=False)
class EdgeObservation:
    """The observation of vertical edges, as `slope` or as `line`, seen by one camera.

    An image whose edges state a mount of their own is seen by the camera as it was mounted then.
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

        blur_rad: sigma of the compared angle that is added to every edge's own. Compiled; `by_rate_plain` is the same
        with arrays.
        """
        everything = np.ones((1, len(landmark_map)))
        found = self._by_rate(particles, sighting, landmark_map, blur_rad, INLIER_RATES, everything, of_edges=True)
        return np.asarray(found[0])

    def by_detection_rate(
        self,
        particles: Particles,
        sighting: Sighting,
        landmark_map: LandmarkMap,
        blur_rad: float = 0.0,
        visibility: Array | None = None,
    ) -> Array:
        """Return log p(edges | particle, p_k) (K, N) for every detection rate, relative to all edges being clutter.

        The edges are a Poisson process. E of them are expected to be clutter, and each of the n landmarks in view shows
        p edges on average. Given the number of edges,

            p(edges | pose, p) ∝ Π_e [E / span + p Σ_l c_el N(q_e; q_l(pose), σ_el²)] / (E + p n)^E

        So a pose that sees no landmark explains the edges as well as clutter does. blur_rad: as for `by_rate`.
        visibility: (V, L) probability v_l that a landmark in view is not hidden, in each of one or two views of it.
        Then v_l c_el N(…) and n = Σ_l v_l, and the result is (V, K, N), in little more time than of one.
        """
        views = np.ones((1, len(landmark_map))) if visibility is None else visibility
        found = self._by_rate(particles, sighting, landmark_map, blur_rad, DETECTION_RATES, views, of_edges=False)
        return np.asarray(found[0]) if visibility is None else found

    def _by_rate(
        self,
        particles: Particles,
        sighting: Sighting,
        landmark_map: LandmarkMap,
        blur_rad: float,
        rates: Array,
        visibility: Array,
        *,
        of_edges: bool,
    ) -> Array:
        if len(sighting.edges) == 0:
            return np.zeros((len(visibility), len(rates), len(particles)))
        angle = self.at(sighting.edges).angle
        scene = likelihood.scene_of(angle, self.parameters, sighting, landmark_map, blur_rad, visibility)
        yaw = particles[CAMERA_YAW] if CAMERA_YAW in particles.names else np.zeros(len(particles))
        columns = np.vstack([particles.columns[:3], yaw])
        return likelihood.by_rate(scene, columns, rates, self.parameters.threads, of_edges=of_edges)

    def by_rate_plain(
        self, particles: Particles, sighting: Sighting, landmark_map: LandmarkMap, blur_rad: float = 0.0
    ) -> Array:
        """Return what `by_rate` does, by arrays over pairs of edge and landmark: slower, and easier to check."""
        count, edges = len(particles), sighting.edges
        if len(edges) == 0:
            return np.zeros((len(INLIER_RATES), count))
        self = self.at(edges)  # noqa: PLW0642
        seen = sight(self.camera, self.camera_poses(particles), landmark_map, self.parameters.sight.far)
        expected = self._expected(seen, landmark_map, sighting.map_scale)
        pair, edge, density = self._near(edges, expected, blur_rad)
        total = np.bincount(seen.pose[pair] * len(edges) + edge, density, minlength=count * len(edges))
        # A particle that sees no landmark can explain no edge: its densities are zero, all edges are clutter.
        visible = np.maximum(np.bincount(seen.pose, expected.in_the_open, minlength=count), 1)
        ratio = total.reshape(count, len(edges)) * (self.angle.span_rad / visible)[:, None]
        return np.stack([np.log1p(rate * (ratio - 1.0)).sum(axis=1) for rate in INLIER_RATES])

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

    # -- what the filter can use besides ----------------------------------------------------------------------------

    def scales(self, particles: Particles, sighting: Sighting, landmark_map: LandmarkMap) -> tuple[float, float]:
        """Return two angles (rad), medians over landmarks and edges: the spread of predictions, the measured sigma.

        Both are of the angle that is compared. (0, inf) where nothing is expected or nothing is measured.
        """
        self = self.at(sighting.edges)  # noqa: PLW0642
        few = take(particles, np.linspace(0, len(particles) - 1, _FEW).astype(np.int64))
        seen = sight(self.camera, self.camera_poses(few), landmark_map, self.parameters.sight.far)
        expected = self._expected(seen, landmark_map, sighting.map_scale)
        times = np.bincount(seen.landmark, minlength=len(landmark_map))
        often = times >= _FEW / 2
        variance = self.angle.measured(sighting.edges)[1]
        if not often.any() or not np.isfinite(variance).any():
            return 0.0, np.inf
        mean, square = (
            np.bincount(seen.landmark, power, minlength=len(times))[often] / times[often]
            for power in (expected.angle, expected.angle**2)
        )
        sigma = np.sqrt(np.nanmedian(variance) + np.median(np.sqrt(expected.variance)) ** 2)
        return float(np.sqrt(np.median(np.maximum(square - mean**2, 0.0)))), float(sigma)

    def targets(
        self, particles: Particles, sighting: Sighting, landmark_map: LandmarkMap, inlier_rate: float
    ) -> Targets:
        """Return the edges with a certain landmark, for all poses among these particles.

        Of the landmarks (K) in view from the mean pose, the k-th is that of an edge with probability

            β_ek = w/K c_ek N(q_e; q_k, σ_ek² + s_k²) / ((1 - w)/span + Σ_l w/K c_el N(q_e; q_l, σ_el² + s_l²)),

        where s_k² is the variance of what some of the particles predict. A landmark is certain from `SETTLED` on.
        """
        edges, self = sighting.edges, self.at(sighting.edges)  # noqa: PLW0642
        expected = self._expected_from(estimate(particles).pose_as_seen, landmark_map, sighting.map_scale)
        seen = expected.seen
        measured, measured_var = self.angle.measured(edges)
        count = len(seen.landmark)
        spread_var = self._spread_var(thinned(particles, _FEW), landmark_map.points[seen.landmark])
        variance = (expected.variance + spread_var)[:, None] + measured_var
        pair, edge = np.nonzero((measured - expected.angle[:, None]) ** 2 < _FAR_SIGMAS**2 * variance)
        own = np.zeros((count, len(edges)))
        own[pair, edge] = self._density(edges, expected, pair, edge, spread_var[pair]) * (inlier_rate / expected.count)
        beta = own / ((1 - inlier_rate) / self.angle.span_rad + own.sum(axis=0))
        pair, edge = np.nonzero(beta >= SETTLED)
        return Targets(
            points=landmark_map.points[seen.landmark[pair]],
            angle=measured[edge],
            variance=measured_var[edge] + expected.variance[pair],
            is_slope=self.parameters.kind == "slope",
        )

    def with_persistent_clutter(
        self, sighting: Sighting, before: Sighting, increment: Increment, turn_var: float
    ) -> Sighting:
        """Return the sighting with the clutter density at each edge, from the edges of the image before."""
        now, then = (self.at(image.edges) for image in (sighting, before))
        measured = *now.angle.bearings(sighting.edges), *then.angle.bearings(before.edges)
        motion, span_rad = _camera_motion(then.camera, now.camera, increment), field_of_view_rad(now.camera)
        density = clutter_density(*measured, motion, turn_var, span_rad)
        return replace(sighting, edges=replace(sighting.edges, clutter=density))

    def scene_clutter(self, sighting: Sighting, earlier: Sequence[EarlierImage]) -> tuple[Array, Array]:
        """Return how dense clutter is at each edge (E,), and how much likelier it is if it continues an earlier one.

        See `observation.scene_clutter`.
        """
        now, images = self.at(sighting.edges), []
        for one in earlier:
            edges, then = one.sighting.edges, self.at(one.sighting.edges)
            images.append(
                EarlierEdges(edges, _camera_motion(then.camera, now.camera, one.since), one.turn_var, then.camera)
            )
        return scene_clutter(now.angle, sighting.edges, images)

    def associate(self, pose: Array, sighting: Sighting, landmark_map: LandmarkMap) -> Matches:
        """Return the most likely landmark of every edge, seen from one robot pose (3,)."""
        x, z, heading = pose.tolist()
        return _matches_from(self, x, z, heading, sighting.edges, landmark_map, sighting.map_scale)

    def _matches(self, pose: Array, edges: Edges, landmark_map: LandmarkMap, map_scale: float) -> Matches:
        """Return the most likely landmark of every edge, seen from one robot pose (3,)."""
        self = self.at(edges)  # noqa: PLW0642
        expected = self._expected_from(pose, landmark_map, map_scale)
        seen = expected.seen
        matches = Matches.none(len(edges), len(landmark_map))
        matches.visible[seen.landmark[expected.in_the_open >= _SHOWN]] = True
        if not len(edges) or not len(seen.pose):
            return matches
        pair, edge, density = self._near(edges, expected)
        odds = density * self.angle.span_rad / expected.count  # against clutter, at an inlier rate of ½
        # Ascending, so that the last write to an edge is its best landmark.
        likelier = np.flatnonzero(odds > 1.0)
        ascending = likelier[np.argsort(odds[likelier], kind="stable")]
        pair, edge, odds = pair[ascending], edge[ascending], odds[ascending]

        measured, measured_var = self.angle.measured(edges)
        residual, sigma = measured[edge] - expected.angle[pair], np.sqrt(measured_var[edge] + expected.variance[pair])
        # The odds fall as exp(-z²/2), and were 1 at the gate.
        gate = np.sqrt((residual / sigma) ** 2 + 2 * np.log(odds))
        matches.landmark[edge], matches.residual[edge] = seen.landmark[pair], residual
        return replace(matches, sigma=_placed(sigma, edge, len(edges)), gate=_placed(gate, edge, len(edges)))

    def by_map_scale(self, pose: Array, sighting: Sighting, landmark_map: LandmarkMap, scales: Array) -> Array:
        """Return log p(edges | scale) (K,) for scales (K,) of the map's sigmas, seen from one robot pose (3,).

        Each landmark has a window of its own: the bearings that are nearer to it than to any other landmark, and
        within `BESIDE_M` of it. At most one of the n edges inside, each as likely as the other, is the landmark's:

            p(q_1 … q_n | scale) ∝ 1 - π + π/n Σ_e 2 w N(q_e; q_l(pose), σ_e² + scale² σ_l²) / P(window),

        where w is half of the window, P(window) the part of the normal that lies inside, and π, how often an edge is
        the landmark's, is integrated out. So neither an edge that is on no map nor a landmark that stands among others
        says that the map is poor.
        """
        from scipy.special import erf

        edges, self = sighting.edges, self.at(sighting.edges)  # noqa: PLW0642
        expected = self._expected_from(pose, landmark_map, 1.0)
        measured, measured_var = self.angle.measured(edges)
        order = np.argsort(expected.angle, kind="stable")
        gap = np.diff(expected.angle[order], prepend=-np.inf, append=np.inf)
        window = BESIDE_M * np.sqrt(expected.variance)
        window /= np.maximum(sigmas_m(landmark_map, self.parameters.landmark_sigma_m)[expected.seen.landmark], 1e-9)
        window[order] = np.minimum(window[order], np.minimum(gap[:-1], gap[1:]) / 2)
        apart = measured - expected.angle[:, None]
        pair, edge = np.nonzero((np.abs(apart) < window[:, None]) & np.isfinite(measured_var))
        landmark, index, count = np.unique(pair, return_inverse=True, return_counts=True)
        variance = expected.variance[pair] * scales[:, None] ** 2 + measured_var[edge]
        inside = erf(window[pair] / np.sqrt(2.0 * variance))
        ratio = np.zeros((len(landmark), len(scales)))
        np.add.at(ratio, index, (2.0 * window[pair] * _normal(apart[pair, edge], variance) / inside / count[index]).T)
        by_rate = np.log1p(INLIER_RATES[:, None, None] * (ratio - 1.0)).sum(axis=1)
        return np.asarray(log_sum_of_rates(by_rate) - np.log(len(INLIER_RATES)))

    def end_offsets(self, pose: Array, sighting: Sighting, landmark_map: LandmarkMap) -> EndOffsets:
        """Return how far from its landmark's ends each edge that belongs to one ends, seen from one robot pose (3,).

        A height v above the camera at a distance d ahead is at e = (v c + d s) / (d c - v s) of the upright image, so
        that ∂e/∂h = -d / (d c - v s)², where h is the height of the camera, and c and s are of its tilt.
        """
        edges, self = sighting.edges, self.at(sighting.edges)  # noqa: PLW0642
        landmark = self.associate(pose, sighting, landmark_map).landmark
        edge = np.flatnonzero((landmark >= 0) & np.isfinite(edges.ends_px).all(axis=(1, 2)))
        landmark, camera = landmark[edge], self.camera
        _, ahead_m = in_camera(camera.pose_in_map(pose[None]), landmark_map.points[landmark])
        ends_m = np.column_stack([landmark_map.bottom_m[landmark], landmark_map.top_m[landmark]])
        expected = np.column_stack(image_heights(camera, ahead_m[0], *ends_m.T))
        measured, cut = endpoints.ends_lower_first(edges.ends_px[edge], camera)
        _, _, e_low, e_high = camera.upright_bounds
        inside = np.isfinite(ends_m) & (expected > e_low) & (expected < e_high) & ~cut
        depth = ahead_m[0, :, None] * np.cos(camera.mount.tilt_rad)
        depth = depth - (ends_m - camera.mount.height_m) * np.sin(camera.mount.tilt_rad)
        per_height = -ahead_m[0, :, None] / depth**2
        return EndOffsets((measured - expected)[inside], per_height[inside])

    # -- pairs of an edge and a landmark ----------------------------------------------------------------------------

    def _expected(self, seen: Sight, landmark_map: LandmarkMap, map_scale: float) -> _Expected:
        """Return how the landmarks that are seen are expected; map_scale: of the map's sigmas."""
        predicted, per_bearing = self.angle.predicted(seen.tangent)
        landmark = seen.landmark
        sigma_m = map_scale * sigmas_m(landmark_map, self.parameters.landmark_sigma_m)[landmark]
        return _Expected(
            seen=seen,
            angle=predicted,
            variance=(per_bearing * sigma_m / seen.range_m) ** 2,
            ends=np.column_stack([seen.e_bottom, seen.e_top]),
            known=np.isfinite(np.column_stack([landmark_map.bottom_m[landmark], landmark_map.top_m[landmark]])),
            leaning=polarity.mean_polarity(landmark_map.polarity[landmark]),
            in_the_open=self.parameters.sight.in_the_open(seen.range_m),
        )

    def _expected_from(self, pose: Array, landmark_map: LandmarkMap, map_scale: float) -> _Expected:
        """Return the landmarks that are seen from one robot pose (3,)."""
        x, z, heading = pose.tolist()
        return _expected_from(self, x, z, heading, landmark_map, map_scale)

    def _near(self, edges: Edges, expected: _Expected, blur_rad: float = 0.0) -> tuple[Indices, Indices, Array]:
        """Return every pair within the gate: indices into `expected` and `edges`, and its density."""
        pair, edge = self._pairs(edges, expected, blur_rad)
        return pair, edge, self._density(edges, expected, pair, edge, blur_rad**2)

    def _pairs(self, edges: Edges, expected: _Expected, blur_rad: float) -> tuple[Indices, Indices]:
        """Return every pair within the gate: indices into `expected` and `edges`."""
        predicted, position_var = expected.angle, expected.variance
        measured, measured_var = self.angle.measured(edges)
        # An edge of which this observation knows nothing (a lean, where only bearings are measured) has no pair.
        known = np.flatnonzero(np.isfinite(measured) & np.isfinite(measured_var))
        order = known[np.argsort(measured[known])]
        largest_var = (measured_var[known] + blur_rad**2).max(initial=0.0)
        reach = likelihood.GATE_SIGMAS * np.sqrt(position_var + largest_var)
        first = np.searchsorted(measured[order], predicted - reach)
        last = np.searchsorted(measured[order], predicted + reach)
        pair = np.repeat(np.arange(len(predicted)), last - first)
        within = np.arange(len(pair)) - np.repeat(np.cumsum(last - first) - (last - first), last - first)
        return pair, order[first[pair] + within]

    def _density(self, edges: Edges, expected: _Expected, pair: Indices, edge: Indices, var: Array | float) -> Array:
        """Return c_el N(q_e; q_l, σ_el² + var) (P,) of pairs, relative to how dense clutter is at the edge."""
        measured, measured_var = self.angle.measured(edges)
        variance = expected.variance[pair] + measured_var[edge] + var
        residual = measured[edge] - expected.angle[pair]
        return _normal(residual, variance) * self._alike(edges, expected, pair, edge)

    def _alike(self, edges: Edges, expected: _Expected, pair: Indices, edge: Indices) -> Array:
        """Return c_el (P,) of pairs, relative to how dense clutter is at the edge."""
        margin = self.parameters.sight.margin_px / self.camera.focal_px
        ends = endpoints.endpoints_of(edges, self.camera)
        agreement = endpoints.agreement(ends, edge, expected.ends[pair], expected.known[pair], self.camera, margin)
        alike = (1.0 + edges.polarity[edge] * expected.leaning[pair]) * expected.in_the_open[pair]
        return np.asarray(alike * agreement / edges.clutter[edge])

    def _spread_var(self, particles: Particles, points: Array) -> Array:
        """Return the variance (K,) of the angle at which particles expect points (K, 2), over those that face them."""
        right, ahead = in_camera(self.camera_poses(particles), points)
        faced, weight = ahead > 0, particles.weight
        predicted, _ = self.angle.predicted(right / np.where(faced, ahead, 1.0))
        total = np.maximum(weight @ faced, 1e-300)
        mean = weight @ (faced * predicted) / total
        return np.asarray(weight @ (faced * (predicted - mean) ** 2) / total)


@lru_cache(maxsize=4)  # several questions about an image are asked from the same pose
def _expected_from(
    observation: EdgeObservation, x: float, z: float, heading: float, landmark_map: LandmarkMap, map_scale: float
) -> _Expected:
    camera = observation.camera
    pose = camera.pose_in_map(np.array([[x, z, heading]]))
    seen = sight(camera, pose, landmark_map, observation.parameters.sight.far)
    return observation._expected(seen, landmark_map, map_scale)


@lru_cache(maxsize=4)  # the filter and what shows its result ask the same
def _matches_from(
    observation: EdgeObservation,
    x: float,
    z: float,
    heading: float,
    edges: Edges,
    landmark_map: LandmarkMap,
    map_scale: float,
) -> Matches:
    return observation._matches(np.array([x, z, heading]), edges, landmark_map, map_scale)


@lru_cache(maxsize=16)
def _mounted(observation: Any, camera: Camera) -> Any:
    return replace(observation, camera=camera)


def _camera_motion(before: Camera, now: Camera, increment: Increment) -> Array:
    """Return how the camera moved (3,), in its own frame before, while the robot did, and the camera on the robot."""
    mount, then = now.robot_from_level, before.robot_from_level
    right, back, _ = between(then, compose(increment.mean, mount))
    return np.array([right, back, increment.mean[2] + (mount[2] - then[2])])


def _normal(error: Array, variance: Array) -> Array:
    return np.asarray(np.exp(-0.5 * error**2 / variance) / np.sqrt(2 * np.pi * variance))


def _placed(values: Array, edge: Indices, count: int) -> Array:
    """Return (E,) with the values at these edges, the last where there are several, and nan elsewhere."""
    result = np.full(count, np.nan)
    result[edge] = values
    return result
