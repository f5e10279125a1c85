"""The association: which landmark each edge of an image shows, seen from one pose, and all that follows from it.

Every pair of an edge and a landmark that are near each other is a row of one table, by the model of
`edge_observation`. The optimal proposal takes the rows that are certain, the display the likeliest row of each edge.
How far the map errs and how high the camera sits are told by the same rows.

c_el, how well the ends of an edge agree with those of a landmark, is the squared part of the edge that lies between
the landmark's ends, times for each end

    m min(R_e / v_l, 1) + (1 - m) R_e N(e; e_l(pose), σ²)

An edge either reaches where its landmark ends, or ends anywhere on the v_l that the image shows of it (m), while the
density of clutter's ends is 1 / R_e there (`frame`). An end of a landmark beyond the image's border cannot be reached
(min(R_e / v_l, 1) is left). One that the map does not know tells nothing, and an edge that the border ends is not
short.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from localiser.camera import Camera
from localiser.edges import Edges
from localiser.geometry import Array
from localiser.landmarks import LandmarkMap, image_heights, in_camera, sight
from localiser.observation.frame import (
    GATE_SIGMAS,
    MEAN_POLARITY,
    TOLERANCE_PX,
    Frame,
    Indices,
    ends_lower_first,
    marked_landmarks,
)
from localiser.observation.inlier_rate import INLIER_RATES, log_sum_of_rates
from localiser.observation.sighting import Matches, Sighting, Targets
from localiser.particles import CAMERA_YAW, Particles, thinned

FEW_SPREAD = 64  # particles that tell how wide the cloud is
SETTLED = 0.9  # probability of belonging to its landmark from which on an edge is a target of the optimal proposal
BESIDE_M = 0.15  # landmarks stand at most so far from where the map has them
_SHOWN = 0.5  # probability of being in the open from which on a landmark is told to be visible


@dataclass(frozen=True, slots=True, eq=False)
class Expected:
    """The landmarks that are seen from poses: K pairs of both.

    pose, landmark: (K,) indices. angle: (K,) at which each is expected (rad), per_m: (K,) derivative by how far it
    stands to the side (rad/m), variance: (K,) of it by the map (rad²). ends: (K, 2) upright heights of its lower and
    upper end, known: (K, 2) whether the map knows them. polarity: (K,). in_the_open: (K,) probability that no wall
    hides it.
    """

    pose: Indices
    landmark: Indices
    angle: Array
    per_m: Array
    variance: Array
    ends: Array
    known: NDArray[np.bool_]
    polarity: NDArray[np.int8]
    in_the_open: Array


def expected_from(frame: Frame, camera_poses: Array, landmark_map: LandmarkMap, map_scale: float) -> Expected:
    """Return the landmarks that the frame's camera sees from poses (N, 3); map_scale: of the map's sigmas."""
    parameters = frame.parameters
    seen = sight(frame.camera, camera_poses, landmark_map, frame.far)
    predicted, per_bearing = frame.predicted(seen.tangent)
    landmark, per_m = seen.landmark, per_bearing / seen.range_m
    sigma_m = map_scale * landmark_map.sigma_m(parameters.landmark_sigma_m)[landmark]
    return Expected(
        pose=seen.pose,
        landmark=landmark,
        angle=predicted,
        per_m=per_m,
        variance=(per_m * sigma_m) ** 2,
        ends=np.column_stack([seen.e_bottom, seen.e_top]),
        known=np.isfinite(np.column_stack([landmark_map.bottom_m[landmark], landmark_map.top_m[landmark]])),
        polarity=landmark_map.polarity[landmark],
        in_the_open=parameters.sight.in_the_open(seen.range_m),
    )


def camera_poses(camera: Camera, particles: Particles) -> Array:
    """Return the floor poses (N, 3) of the particles' cameras in the map, each with its own yaw on the mount."""
    poses = camera.pose_in_map(particles.poses)
    if CAMERA_YAW in particles.names:
        poses[:, 2] += particles[CAMERA_YAW]
    return poses


@dataclass(frozen=True, slots=True, eq=False)
class Association:
    """How edges (E) compare with the landmarks that are seen from one pose: P pairs near each other.

    expected: the landmarks seen. pair: (P,) index into these, edge: (P,). residual: (P,) measured minus expected angle,
    variance: (P,) of it (rad, rad²). odds: (P,) that the edge is this landmark's, against clutter that is spread
    evenly, at an inlier rate of ½.
    """

    frame: Frame
    sighting: Sighting
    landmark_map: LandmarkMap
    expected: Expected
    pair: Indices
    edge: Indices
    residual: Array
    variance: Array
    odds: Array

    @classmethod
    def of(
        cls,
        frame: Frame,
        sighting: Sighting,
        landmark_map: LandmarkMap,
        expected: Expected,
        particles: Particles | None = None,
    ) -> Association:
        """Return how the edges of a sighting compare with what is expected from one pose; particles: see `over`."""
        (measured, measured_var), named, variance = frame.measured, frame.edges.landmark_id, expected.variance
        if particles is not None:
            few = thinned(particles, FEW_SPREAD)
            right, ahead = in_camera(camera_poses(frame.camera, few), landmark_map.points[expected.landmark])
            faced, weight = ahead > 0, few.weight
            predicted, _ = frame.predicted(right / np.where(faced, ahead, 1.0))
            total = np.maximum(weight @ faced, 1e-300)
            mean = weight @ (faced * predicted) / total
            variance = variance + weight @ (faced * (predicted - mean) ** 2) / total
        order = np.argsort(measured)
        apart, apart_var = measured[order] - expected.angle[:, None], measured_var[order] + variance[:, None]
        pair, column = np.nonzero(apart**2 < GATE_SIGMAS**2 * apart_var)  # none of an edge of which nothing is known
        edge = order[column]
        if frame.parameters.association == "known":  # an edge is of the landmark that it names, or clutter
            said, shared = named[edge] == expected.landmark[pair], np.ones(len(edge))
        else:
            marked = marked_landmarks(frame.edges, landmark_map)[edge]
            said = (marked < 0) | (marked == expected.landmark[pair])  # a marker's side is that landmark, or clutter
            shared = np.where(marked >= 0, 1.0, max(float(expected.in_the_open.sum()), 1.0))
        pair, edge, shared = pair[said], edge[said], shared[said]
        residual, variance = measured[edge] - expected.angle[pair], variance[pair] + measured_var[edge]
        odds = normal(residual, variance) * agreement(frame, expected, pair, edge) * frame.span_rad / shared
        return cls(frame, sighting, landmark_map, expected, pair, edge, residual, variance, odds)

    def over(self, particles: Particles) -> Association:
        """Return the same over all poses of the particles whose mean pose it is from.

        An angle is then also as uncertain as what those of the particles predict that face the landmark.
        """
        return Association.of(self.frame, self.sighting, self.landmark_map, self.expected, particles)

    def matches(self) -> Matches:
        """Return the most likely landmark of every edge, whether or not an earlier image showed it too."""
        count = len(self.frame.edges.bearing)
        matches, seen = Matches.none(count, len(self.landmark_map)), self.expected
        matches.visible[seen.landmark[seen.in_the_open >= _SHOWN]] = True
        # Ascending, so that the last write to an edge is its best landmark.
        likelier = np.flatnonzero(self.odds > 1.0)
        best = likelier[np.argsort(self.odds[likelier], kind="stable")]
        edge, sigmas, gates = self.edge[best], np.full(count, np.nan), np.full(count, np.nan)
        matches.landmark[edge], matches.residual[edge] = seen.landmark[self.pair[best]], self.residual[best]
        # The odds fall as exp(-z²/2), and were 1 at the gate.
        sigmas[edge] = np.sqrt(self.variance[best])
        gates[edge] = np.sqrt(self.residual[best] ** 2 / self.variance[best] + 2 * np.log(self.odds[best]))
        return replace(matches, sigma=sigmas, gate=gates)

    def targets(self, inlier_rate: float) -> Targets:
        """Return the edges with a certain landmark.

        Of the landmarks (K) in view, the k-th is that of an edge with probability

            β_ek = w/K c_ek N(q_e; q_k, σ_ek²) / ((1 - w)/span + Σ_l w/K c_el N(q_e; q_l, σ_el²)),

        where σ² has the variance of what particles predict. A landmark is certain from `SETTLED` on.
        """
        own, total = self._odds_at(inlier_rate)
        measured, measured_var = self.frame.measured
        certain = np.flatnonzero(own >= SETTLED * (1 - inlier_rate + total[self.edge]))
        pair, edge = self.pair[certain], self.edge[certain]
        return Targets(
            points=self.landmark_map.points[self.expected.landmark[pair]],
            angle=measured[edge],
            variance=measured_var[edge] + self.expected.variance[pair],
            is_slope=self.frame.parameters.kind == "slope",
        )

    def clutter(self, inlier_rate: float) -> Array:
        """Return the probability (E,) that an edge is of nothing on the map: 1 - Σ_k β_ek of `targets`."""
        _, total = self._odds_at(inlier_rate)
        return np.asarray((1 - inlier_rate) / (1 - inlier_rate + total))

    def _odds_at(self, inlier_rate: float) -> tuple[Array, Array]:
        """Return the weight of each pair (P,) beside 1 - inlier_rate for clutter, and the sum for each edge (E,)."""
        clutter = self.sighting.persistent
        own = inlier_rate * self.odds / (1.0 if clutter is None else clutter[self.edge])
        return own, np.asarray(np.bincount(self.edge, own, len(self.frame.measured[0])), dtype=np.float64)

    def by_map_scale(self, scales: Array) -> Array:
        """Return log p(edges | scale) (K,) for scales (K,) of the map's sigmas.

        Each landmark has a window of its own: the bearings that are nearer to it than to any other landmark, and
        within `BESIDE_M` of it. At most one of the n edges inside, each as likely as the other, is the landmark's:

            p(q_1 … q_n | scale) ∝ 1 - π + π/n Σ_e 2 w N(q_e; q_l(pose), σ_e² + scale² σ_l²) / P(window),

        where w is half of the window, P(window) the part of the normal that lies inside, and π, how often an edge is
        the landmark's, is integrated out. So neither an edge that is on no map nor a landmark that stands among others
        says that the map is poor.
        """
        from scipy.special import erf

        expected, (measured, measured_var) = self.expected, self.frame.measured
        order = np.argsort(expected.angle, kind="stable")
        gap = np.diff(expected.angle[order], prepend=-np.inf, append=np.inf)
        window = BESIDE_M * np.abs(expected.per_m)
        window[order] = np.minimum(window[order], np.minimum(gap[:-1], gap[1:]) / 2)
        apart = measured - expected.angle[:, None]
        pair, edge = np.nonzero((np.abs(apart) < window[:, None]) & np.isfinite(measured_var))
        landmark, index, count = np.unique(pair, return_inverse=True, return_counts=True)
        stated_var = expected.variance[pair] / self.sighting.map_scale**2
        variance = stated_var * scales[:, None] ** 2 + measured_var[edge]
        inside = erf(window[pair] / np.sqrt(2.0 * variance))
        ratio = np.zeros((len(landmark), len(scales)))
        np.add.at(ratio, index, (2.0 * window[pair] * normal(apart[pair, edge], variance) / inside / count[index]).T)
        by_rate = np.log1p(INLIER_RATES[:, None, None] * (ratio - 1.0)).sum(axis=1)
        return np.asarray(log_sum_of_rates(by_rate) - np.log(len(INLIER_RATES)))


def end_offsets(
    matches: Matches, pose: Array, edges: Edges, camera: Camera, landmark_map: LandmarkMap
) -> tuple[Array, Array]:
    """Return how far from its landmark's ends each edge that belongs to one ends, seen from one robot pose (3,).

    Of P ends inside the image: the measured minus the expected upright height (P,), and the derivative (P,) of the
    expected one by the camera's height above the floor, 1/m.

    A height v above the camera at a distance d ahead is at e = (v c + d s) / (d c - v s) of the upright image, so
    that ∂e/∂h = -d / (d c - v s)², where h is the height of the camera, and c and s are of its tilt.
    """
    edge = np.flatnonzero((matches.landmark >= 0) & np.isfinite(edges.ends_px).all(axis=(1, 2)))
    landmark, mount = matches.landmark[edge], camera.mount
    _, ahead_m = in_camera(camera.pose_in_map(pose[None]), landmark_map.points[landmark])
    ends_m = np.column_stack([landmark_map.bottom_m[landmark], landmark_map.top_m[landmark]])
    expected = np.column_stack(image_heights(camera, ahead_m[0], *ends_m.T))
    measured, cut = ends_lower_first(edges.ends_px[edge], camera)
    _, _, e_low, e_high = camera.upright_bounds
    inside = np.isfinite(ends_m) & (expected > e_low) & (expected < e_high) & ~cut
    depth = ahead_m[0, :, None] * np.cos(mount.tilt_rad) - (ends_m - mount.height_m) * np.sin(mount.tilt_rad)
    per_height = -ahead_m[0, :, None] / depth**2
    return (measured - expected)[inside], per_height[inside]


def agreement(frame: Frame, expected: Expected, pair: Indices, edge: Indices) -> Array:
    """Return c_el (P,) of pairs: how well ends and polarities agree, and the probability that no wall is before."""
    camera, ends, end, known = frame.camera, frame.ends, expected.ends[pair], expected.known[pair]
    per_px = 1.0 / camera.focal_px
    margin = frame.parameters.sight.margin_px / camera.focal_px
    border = np.array(camera.upright_bounds[2:]) + margin * np.array([-1.0, 1.0])
    cut = np.clip(end, *border)
    per_visible = 1.0 / np.maximum(cut[:, 1] - cut[:, 0], 1e-12)
    in_image = (end > border[0]) & (end < border[1])
    bottom = np.where(in_image[:, 0], end[:, 0], -np.inf)
    top = np.where(in_image[:, 1], end[:, 1], np.inf)
    low, high = ends.e[edge].T
    inside = np.minimum(top, high) - np.maximum(bottom, low)
    covered = np.clip((inside + 2 * TOLERANCE_PX * per_px) * ends.per_length[edge], 0.0, 1.0)
    short = np.minimum(ends.room[edge] * per_visible[:, None], 1.0) * np.where(in_image, ends.missed, 1.0)
    off = np.where(in_image, ends.e[edge] - end, np.inf) / ends.sigma[edge]
    at = np.where(known, short + ends.peak[edge] * np.exp(-0.5 * off**2), 1.0)
    by_polarity = 1.0 + MEAN_POLARITY * frame.edges.polarity[edge] * expected.polarity[pair]
    return np.asarray(covered**2 * at.prod(axis=1) * by_polarity * expected.in_the_open[pair])


def normal(error: Array, variance: Array) -> Array:
    """Return the normal density of errors of these variances."""
    return np.asarray(np.exp(-0.5 * error**2 / variance) / np.sqrt(2 * np.pi * variance))
