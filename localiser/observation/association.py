"""The association: which landmark each edge of an image shows, seen from one pose, and all that follows from it.

Every pair of an edge and a landmark that are near each other is a row of one table (docs/observation.md).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from localiser.camera import Camera
from localiser.geometry import Array, Indices
from localiser.landmarks import LandmarkMap, image_heights, in_camera
from localiser.observation.frame import Frame
from localiser.observation.inlier_rate import INLIER_RATES, log_sum_of_rates
from localiser.observation.sighting import Matches, Sighting, Targets

SETTLED = 0.9  # probability of belonging to its landmark from which on an edge is a target of the optimal proposal
BESIDE_M = 0.15  # landmarks stand at most so far from where the map has them
_SHOWN = 0.5  # probability of being in the open from which on a landmark is told to be visible


@dataclass(frozen=True, slots=True, eq=False)
class Association:
    """How edges (E) compare with the landmarks (K) that are seen from one pose: P pairs near each other.

    landmark: (K,) indices. angle: (K,) at which each is expected (rad), per_m: (K,) how fast that changes as it is
    moved aside (rad/m), map_var, pose_var: (K,) its variances by the map and by the pose's (rad²). in_the_open: (K,)
    probability that no wall hides it. pair: (P,) index into these, edge: (P,). residual: (P,) measured minus expected
    angle (rad). odds: (P,) that the edge is this landmark's, against clutter that is spread evenly, at an inlier rate
    of ½. all_odds: (P,) the same where the angle is as uncertain as the pose, too.
    """

    frame: Frame
    sighting: Sighting
    landmark_map: LandmarkMap
    landmark: Indices
    angle: Array
    per_m: Array
    map_var: Array
    pose_var: Array
    in_the_open: Array
    pair: Indices
    edge: Indices
    residual: Array
    odds: Array
    all_odds: Array

    def matches(self) -> Matches:
        """Return the most likely landmark of every edge, whether or not an earlier image showed it too."""
        found = Matches.none(len(self.frame.edges), len(self.landmark_map))
        found.visible[self.landmark[self.in_the_open >= _SHOWN]] = True
        # Ascending, so that the last write to an edge is its best landmark.
        likelier = np.flatnonzero(self.odds > 1.0)
        best = likelier[np.argsort(self.odds[likelier], kind="stable")]
        pair, edge, residual = self.pair[best], self.edge[best], self.residual[best]
        variance = self.map_var[pair] + self.frame.measured[1][edge]
        found.landmark[edge], found.residual[edge], found.sigma[edge] = self.landmark[pair], residual, np.sqrt(variance)
        # The odds fall as exp(-z²/2), and were 1 at the gate.
        found.gate[edge] = np.sqrt(residual**2 / variance + 2 * np.log(self.odds[best]))
        return found

    def targets(self, inlier_rate: float) -> Targets:
        """Return the edges with a certain landmark.

        Of the landmarks (K) in view, the k-th is that of an edge with probability

            β_ek = w/K c_ek N(q_e; q_k, σ_ek²) / ((1 - w)/span + Σ_l w/K c_el N(q_e; q_l, σ_el²)),

        where σ² has the variance by the pose, too. A landmark is certain from `SETTLED` on.
        """
        own, total = self._odds_at(inlier_rate)
        measured, measured_var = self.frame.measured
        certain = np.flatnonzero(own >= SETTLED * (1 - inlier_rate + total[self.edge]))
        pair, edge = self.pair[certain], self.edge[certain]
        points, variance = self.landmark_map.points[self.landmark[pair]], measured_var[edge] + self.map_var[pair]
        return Targets(points, measured[edge], variance, self.frame.parameters.kind == "slope")

    def clutter(self, inlier_rate: float) -> Array:
        """Return the probability (E,) that an edge is of nothing on the map: 1 - Σ_k β_ek of `targets`."""
        _, total = self._odds_at(inlier_rate)
        return np.asarray((1 - inlier_rate) / (1 - inlier_rate + total))

    def _odds_at(self, inlier_rate: float) -> tuple[Array, Array]:
        """Return the weight of each pair (P,) beside 1 - inlier_rate for clutter, and the sum for each edge (E,)."""
        clutter = self.sighting.persistent
        own = inlier_rate * self.all_odds / (1.0 if clutter is None else clutter[self.edge])
        return own, np.asarray(np.bincount(self.edge, own, len(self.frame.edges)), dtype=np.float64)

    def by_map_scale(self, scales: Array) -> Array:
        """Return log p(edges | scale) (K,) for scales (K,) of the map's sigmas.

        Each landmark has a window of its own: the bearings that are nearer to it than to any other landmark, and
        within `BESIDE_M` of it. At most one of the n edges inside, each as likely as the other, is the landmark's:

            p(q_1 … q_n | scale) ∝ 1 - π + π/n Σ_e 2 w N(q_e; q_l(pose), σ_e² + scale² σ_l²) / P(window),

        where w is half of the window, P(window) the part of the normal that lies inside, and π, how often an edge is
        the landmark's, is integrated out. So an edge that is on no map does not say that the map is poor.
        """
        from scipy.special import erf

        measured, measured_var = self.frame.measured
        order = np.argsort(self.angle, kind="stable")
        gap = np.diff(np.concatenate([[-np.inf], self.angle[order], [np.inf]]))
        window = BESIDE_M * self.per_m
        window[order] = np.minimum(window[order], np.minimum(gap[:-1], gap[1:]) / 2)
        apart = measured - self.angle[:, None]
        pair, edge = np.nonzero((np.abs(apart) < window[:, None]) & np.isfinite(measured_var))
        count = np.bincount(pair)
        first = (np.cumsum(count) - count)[count > 0]  # of each landmark, whose edges follow each other
        variance = self.map_var[pair] / self.sighting.map_scale**2 * scales[:, None] ** 2 + measured_var[edge]
        inside = erf(window[pair] / np.sqrt(2.0 * variance)) * np.sqrt(2 * np.pi * variance)
        density = np.exp(-0.5 * apart[pair, edge] ** 2 / variance) / inside
        ratio = np.add.reduceat(2.0 * window[pair] / count[pair] * density, first, axis=1)
        by_rate = np.log1p(INLIER_RATES[:, None, None] * (ratio - 1.0)).sum(axis=2)
        return np.asarray(log_sum_of_rates(by_rate) - np.log(len(INLIER_RATES)))

    def end_offsets(self, matches: Matches, pose: Array, camera: Camera) -> tuple[Array, Array]:
        """Return how far from its landmark's ends each edge that belongs to one ends, seen from one robot pose (3,).

        Of P ends inside the image: the measured minus the expected upright height (P,), and the derivative (P,) of the
        expected one by the camera's height above the floor, 1/m. P is 0 where some ends of the image are not known.
        camera: at the height that is meant.

        A height v above the camera at a distance d ahead is at e = (v c + d s) / (d c - v s) of the upright image, so
        that ∂e/∂h = -d / (d c - v s)², where h is the height of the camera, and c and s are of its tilt.
        """
        edge = np.flatnonzero(matches.landmark >= 0)
        landmark, mount, ends, landmark_map = matches.landmark[edge], camera.mount, self.frame.ends, self.landmark_map
        _, ahead_m = in_camera(camera.pose_in_map(pose[None]), landmark_map.points[landmark])
        ends_m = np.column_stack([landmark_map.bottom_m[landmark], landmark_map.top_m[landmark]])
        expected = np.column_stack(image_heights(camera, ahead_m[0], *ends_m.T))
        _, _, e_low, e_high = camera.upright_bounds
        inside = np.isfinite(ends_m) & (expected > e_low) & (expected < e_high) & ~ends.cut[edge]
        depth = ahead_m[0, :, None] * np.cos(mount.tilt_rad) - (ends_m - mount.height_m) * np.sin(mount.tilt_rad)
        per_height = -ahead_m[0, :, None] / depth**2
        return (ends.e[edge] - expected)[inside], per_height[inside]
