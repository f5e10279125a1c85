"""How well measured edges fit a pose: log-likelihood with unknown association.

Each measured edge is a draw from a mixture: with probability w it belongs to one of the n landmarks that the camera
can see from the pose, each as likely as the other, else it is clutter, spread evenly over the field of view (and
denser where the last image showed it, `lasting`):

    p(q_e | pose, w) = (1 - w) / span + (w / n) Σ_l c_el N(q_e; q_l(pose), σ_el²)

q is the bearing of the line held through the nadir point (`line`), or the lean of the free line (`slope`, the paper's
observation). σ_el² adds what the edge's measurement, the mount's common error and the landmark's position contribute.
c_el compares the edge's ends with the landmark's: the rim of a picture, high on a wall, is no door jamb. It is the
squared share of the edge that lies between the landmark's ends, times for each end

    m min(R_e / v_l, 1) + (1 - m) R_e N(e; e_l(pose), σ²)

since an edge either reaches where its landmark ends, or ends anywhere on the v_l that the image shows of it (m), while
the density of clutter's ends is 1 / R_e there. Clutter stands in rows, so R_e is large where an end stands alone and
small where other edges of the image end. The floor contact tells the range; a book tells nothing of a door. An end of a
landmark beyond the image's border is not there to be reached (min(R_e / v_l, 1) is left), one that the map does not
know tells nothing, and what the border ends is not short. Last, an edge is rarely darker on the side where its
landmark is lighter (`polarity`).

How many edges are clutter differs from place to place, so w is not a parameter: the likelihood is computed for every
share of `inliers`, which learns their distribution and integrates them out.

Consecutive images see the same texture from almost the same place, so their errors repeat: taking them as independent
makes the filter too sure. `independent_share` is the part of a frame that counts as new.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Annotated, Literal, Protocol

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from localiser.camera import Camera
from localiser.edges import Edges
from localiser.geometry import Array, Increment, between, compose
from localiser.landmarks import LandmarkMap, Sight, SightParameters, in_camera, sight, widest_tangent
from localiser.observation import endpoint_likelihood as ends
from localiser.observation import likelihood, polarity
from localiser.observation import persistent_clutter as lasting
from localiser.observation.angle import Angle
from localiser.observation.inlier_rate import INLIER_SHARES, InlierShare
from localiser.particles import CAMERA_YAW, POSE, Particles, estimate, take

GATE_SIGMAS = 6.0  # beyond this a normal density is below 1e-8 of its peak: nothing beside clutter
SETTLED = 0.9  # probability from which on an edge guides particles to where it is of its landmark
_UNKNOWN_M = 1e9  # beyond every height
_FEW = 64  # particles that tell how wide the cloud is


@dataclass(frozen=True, slots=True)
class ObservationParameters:
    """The mixture of landmarks and clutter."""

    kind: Annotated[
        Literal["line", "slope"],
        Field(description="what is compared: the line held through the nadir point, or the slope alone (the paper's)"),
    ] = "line"
    landmark_sigma_m: Annotated[
        float,
        Field(ge=0, description="how far a landmark may stand from where the map has it, where that is silent (m)"),
    ] = 0.01
    decorrelation_m: Annotated[
        float, Field(ge=0, description="driving after which errors of an edge are new (m); 0: always new")
    ] = 0.07
    decorrelation_deg: Annotated[
        float, Field(ge=0, description="turning after which errors of an edge are new (degrees); 0: always new")
    ] = 4.0
    association: Annotated[
        Literal["unknown", "known"],
        Field(description="whether to believe what edges of a log say of which landmark they belong to"),
    ] = "unknown"
    threads: Annotated[
        int, Field(ge=1, le=64, description="threads that weigh particles; results do not depend on it")
    ] = 1
    sight: SightParameters = field(default_factory=SightParameters)


@dataclass(frozen=True, slots=True, eq=False)
class Targets:
    """Edges of which it is known which landmark they belong to: K of them.

    points: (K, 2) of the landmarks. angle: (K,) measured, rad. variance: (K,) rad². is_slope: whether angles are leans,
    not bearings.
    """

    points: Array
    angle: Array
    variance: Array
    is_slope: bool


class Observation(Protocol):
    """Anything that weighs particles by edges."""

    @property
    def camera(self) -> Camera:
        """The camera that saw them."""
        ...

    def log_likelihood(self, particles: Particles, edges: Edges, landmark_map: LandmarkMap) -> Array:
        """Return log p(edges | particle) (N,), up to a constant that all particles share."""
        ...

    def by_share(self, particles: Particles, edges: Edges, landmark_map: LandmarkMap, blur_rad: float = 0.0) -> Array:
        """Return log p(edges | particle, w_k) (K, N) for every inlier share w_k, up to a constant that all share.

        blur_rad: sigma that is added to every edge's own.
        """
        ...

    def with_lasting(self, edges: Edges, before: Edges, increment: Increment, turn_var: float) -> Edges:
        """Return the edges of an image, told where clutter of the last image is by now."""
        ...

    def targets(self, particles: Particles, edges: Edges, landmark_map: LandmarkMap, inlier_share: float) -> Targets:
        """Return what the edges say of landmarks, `inlier_share` being how many edges belong to any."""
        ...

    def scales(self, particles: Particles, edges: Edges, landmark_map: LandmarkMap) -> tuple[float, float]:
        """Return how far (rad) the particles' predictions of an edge spread, and sigma (rad) of measuring it."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class Matches:
    """Which landmark each edge belongs to, seen from one pose.

    landmark: (E,) index into the map, -1 for clutter. residual: (E,) measured minus predicted, rad, nan for clutter.
    visible: (L,) whether the landmark is inside the field of view.
    """

    landmark: NDArray[np.int64]
    residual: Array
    visible: NDArray[np.bool_]


@dataclass(frozen=True, slots=True, eq=False)
class EdgeObservation:
    """The observation of vertical edges, as `slope` or as `line`, seen by one camera."""

    camera: Camera
    parameters: ObservationParameters

    @property
    def angle(self) -> Angle:
        """The angle that is compared."""
        return Angle(self.camera, self.parameters.kind)

    def log_likelihood(self, particles: Particles, edges: Edges, landmark_map: LandmarkMap) -> Array:
        """Return log p(edges | particle) (N,), relative to all edges being clutter; the inlier share is unknown."""
        return InlierShare.unknown().log_mean(self.by_share(particles, edges, landmark_map))

    def by_share(self, particles: Particles, edges: Edges, landmark_map: LandmarkMap, blur_rad: float = 0.0) -> Array:
        """Return log p(edges | particle, w_k) (K, N) for every inlier share, relative to all edges being clutter.

        blur_rad: sigma of the compared angle that is added to every edge's own. Compiled; `by_share_plain` is the same
        with arrays.
        """
        if len(edges) == 0:
            return np.zeros((len(INLIER_SHARES), len(particles)))
        scene = self._scene(edges, landmark_map, blur_rad)
        yaw = particles[CAMERA_YAW] if CAMERA_YAW in particles.names else np.zeros(len(particles))
        return likelihood.by_share(
            scene, np.vstack([particles.columns[:3], yaw]), INLIER_SHARES, self.parameters.threads
        )

    def by_share_plain(
        self, particles: Particles, edges: Edges, landmark_map: LandmarkMap, blur_rad: float = 0.0
    ) -> Array:
        """Return what `by_share` does, by arrays over pairs of edge and landmark: slower, and easier to check."""
        count = len(particles)
        if len(edges) == 0:
            return np.zeros((len(INLIER_SHARES), count))
        seen = sight(self.camera, self.camera_poses(particles), landmark_map, self.parameters.sight)
        pair, edge, density = self._densities(edges, landmark_map, seen, blur_rad)
        total = np.bincount(seen.pose[pair] * len(edges) + edge, density, minlength=count * len(edges))
        # A particle that sees no landmark can explain no edge: its densities are zero, all edges are clutter.
        visible = np.maximum(np.bincount(seen.pose, minlength=count), 1)
        ratio = total.reshape(count, len(edges)) * (self.angle.span_rad / visible)[:, None]
        return np.stack([np.log1p(share * (ratio - 1.0)).sum(axis=1) for share in INLIER_SHARES])

    def camera_poses(self, particles: Particles) -> Array:
        """Return the floor poses (N, 3) of the particles' cameras in the map, each with its own yaw on the mount."""
        poses = self.camera.pose_in_map(particles.poses)
        if CAMERA_YAW in particles.names:
            poses[:, 2] += particles[CAMERA_YAW]
        return poses

    def warm_up(self) -> None:
        """Compile what weighs particles, or load it from the disk, so that no frame has to wait for it."""
        angle = np.zeros(1)
        edges = Edges.from_columns(angle, angle + 0.01, angle, angle + 0.01)
        self.by_share(Particles(POSE, np.zeros((3, 1)), angle), edges, LandmarkMap.from_points(np.array([[0.0, -3.0]])))

    def _scene(self, edges: Edges, landmark_map: LandmarkMap, blur_rad: float) -> likelihood.Scene:
        """Return what all particles share, as the compiled loop takes it."""
        measured, variance = self.angle.measured(edges)
        # Edges of which this observation knows nothing go to the end: no landmark comes near them.
        known = np.isfinite(measured) & np.isfinite(variance)
        measured, variance = np.where(known, measured, np.inf), np.where(known, variance + blur_rad**2, 1.0)
        ended = ends.ends_of(edges, self.camera)
        order = np.argsort(measured, kind="stable")
        mount, parameters, focal = self.camera.mount, self.parameters.sight, self.camera.focal_px
        margin = parameters.margin_px / focal * np.array([-1.0, 1.0, -1.0, 1.0])
        shortest = max(parameters.length_min_px, 1e-9) / focal
        largest_var = float(variance[known].max(initial=0.0))
        bottom, top = landmark_map.bottom_m - mount.height_m, landmark_map.top_m - mount.height_m
        return likelihood.Scene(
            landmarks=np.column_stack(
                [
                    landmark_map.points,
                    np.where(np.isnan(bottom), -_UNKNOWN_M, bottom),
                    np.where(np.isnan(top), _UNKNOWN_M, top),
                    self._landmark_sigma(landmark_map) ** 2,
                    polarity.leaning(landmark_map.polarity),
                ]
            ),
            edges=np.column_stack(
                [
                    measured,
                    variance,
                    ended.e,
                    ended.per_length,
                    ended.room,
                    ended.peak,
                    edges.polarity,
                    1.0 / edges.clutter,
                ]
            )[order],
            offset=(mount.right_m, mount.back_m, mount.yaw_rad),
            view=(
                float(np.sin(mount.tilt_rad)),
                float(np.cos(mount.tilt_rad)),
                *(np.array(self.camera.upright_bounds) + margin).tolist(),
                shortest,
            ),
            ends=(ends.TOLERANCE_PX / focal, focal / ends.SIGMA_PX, ended.missed),
            range_m=(parameters.range_min_m, parameters.range_max_m),
            widest=widest_tangent(self.camera, parameters),
            gate=(GATE_SIGMAS, largest_var),
            span=self.angle.span_rad,
            is_slope=self.parameters.kind == "slope",
        )

    def scales(self, particles: Particles, edges: Edges, landmark_map: LandmarkMap) -> tuple[float, float]:
        """Return two angles (rad), medians over landmarks and edges: the spread of predictions, the measured sigma.

        Both are of the angle that is compared. (0, inf) where nothing is expected or nothing is measured.
        """
        few = take(particles, np.linspace(0, len(particles) - 1, _FEW).astype(np.int64))
        seen = sight(self.camera, self.camera_poses(few), landmark_map, self.parameters.sight)
        predicted, per_bearing = self.angle.predicted(seen.tangent)
        times = np.bincount(seen.landmark, minlength=len(landmark_map))
        often = times >= _FEW / 2
        variance = self.angle.measured(edges)[1]
        if not often.any() or not np.isfinite(variance).any():
            return 0.0, np.inf
        mean, square = (
            np.bincount(seen.landmark, power, minlength=len(times))[often] / times[often]
            for power in (predicted, predicted**2)
        )
        position_sigma = per_bearing * self._landmark_sigma(landmark_map)[seen.landmark] / seen.range_m
        sigma = np.sqrt(np.nanmedian(variance) + np.median(position_sigma) ** 2)
        return float(np.sqrt(np.median(np.maximum(square - mean**2, 0.0)))), float(sigma)

    def targets(self, particles: Particles, edges: Edges, landmark_map: LandmarkMap, inlier_share: float) -> Targets:
        """Return the edges whose landmark is in no doubt, wherever among these particles the robot may be.

        Of the landmarks (K) in view from the mean pose, the k-th has an edge as its own with probability

            β_ek = w/K c_ek N(q_e; q_k, σ_ek² + s_k²) / ((1 - w)/span + Σ_l w/K c_el N(q_e; q_l, σ_el² + s_l²)),

        s_k² being how much the particles' predictions of it spread. It must have one of `SETTLED`.
        """
        mean = self.camera.pose_in_map(estimate(particles).pose_as_seen)
        seen = sight(self.camera, mean[None], landmark_map, self.parameters.sight)
        measured, measured_var = self.angle.measured(edges)
        known = np.isfinite(measured) & np.isfinite(measured_var)
        of_known, measured, measured_var = np.flatnonzero(known), measured[known], measured_var[known]
        predicted, per_bearing = self.angle.predicted(seen.tangent)
        position_var = (per_bearing * self._landmark_sigma(landmark_map)[seen.landmark] / seen.range_m) ** 2
        spread_var = self._spread_var(particles, landmark_map.points[seen.landmark])

        variance = (spread_var + position_var)[:, None] + measured_var
        own = np.exp(-0.5 * (measured - predicted[:, None]) ** 2 / variance) / np.sqrt(2 * np.pi * variance)
        pair, edge = (index.ravel() for index in np.indices(own.shape))
        own *= self._agreement(edges, landmark_map, seen, pair, of_known[edge]).reshape(own.shape)
        own /= edges.clutter[of_known]
        own *= inlier_share / max(len(predicted), 1)
        beta = own / ((1 - inlier_share) / self.angle.span_rad + own.sum(axis=0))
        landmark, edge = np.nonzero(beta >= SETTLED)
        return Targets(
            points=landmark_map.points[seen.landmark[landmark]],
            angle=measured[edge],
            variance=measured_var[edge] + position_var[landmark],
            is_slope=self.parameters.kind == "slope",
        )

    def _spread_var(self, particles: Particles, points: Array) -> Array:
        """Return the variance (K,) of the angle at which particles expect points (K, 2), over those that face them."""
        right, ahead = in_camera(self.camera_poses(particles), points)
        faced = ahead > 0
        weight = np.where(faced, particles.weight[:, None], 0.0)
        weight /= np.maximum(weight.sum(axis=0), 1e-300)
        predicted, _ = self.angle.predicted(right / np.where(faced, ahead, 1.0))
        return np.asarray((weight * (predicted - (weight * predicted).sum(axis=0)) ** 2).sum(axis=0))

    def with_lasting(self, edges: Edges, before: Edges, increment: Increment, turn_var: float) -> Edges:
        """Return the edges of an image, told where clutter of the last image is by now; see `lasting`."""
        (bearing, sigma), (earlier, earlier_sigma) = self.angle.bearings(edges), self.angle.bearings(before)
        mount = self.camera.robot_from_level
        right, back, _ = between(mount, compose(increment.mean, mount))
        motion = np.array([right, back, increment.mean[2]])
        clutter = lasting.lasting(bearing, sigma, earlier, earlier_sigma, motion, turn_var, self.angle.field_rad)
        return replace(edges, clutter=clutter)

    def associate(self, pose: Array, edges: Edges, landmark_map: LandmarkMap) -> Matches:
        """Return the most likely landmark of every edge, seen from one robot pose (3,)."""
        seen = sight(self.camera, self.camera.pose_in_map(pose[None]), landmark_map, self.parameters.sight)
        visible = np.zeros(len(landmark_map), dtype=bool)
        visible[seen.landmark] = True
        landmark = np.full(len(edges), -1)
        residual = np.full(len(edges), np.nan)
        if len(edges) and len(seen.pose):
            pair, edge, density = self._densities(edges, landmark_map, seen)
            likelier = density / len(seen.pose) > 1.0 / self.angle.span_rad  # than clutter, at even shares
            pair, edge, density = pair[likelier], edge[likelier], density[likelier]
            # Ascending, so that the last write to an edge is its best landmark.
            ascending = np.argsort(density, kind="stable")
            pair, edge = pair[ascending], edge[ascending]
            landmark[edge] = seen.landmark[pair]
            residual[edge] = self.angle.measured(edges)[0][edge] - self.angle.predicted(seen.tangent[pair])[0]
        return Matches(landmark, residual, visible)

    def _densities(
        self, edges: Edges, landmark_map: LandmarkMap, seen: Sight, blur_rad: float = 0.0
    ) -> tuple[NDArray[np.int64], NDArray[np.int64], Array]:
        """Return c_el N(q_e; q_l, σ_el²) of every pair within the gate: indices into `seen` and `edges`, density."""
        predicted, per_bearing = self.angle.predicted(seen.tangent)
        position_sigma = per_bearing * self._landmark_sigma(landmark_map)[seen.landmark] / seen.range_m
        measured, measured_var = self.angle.measured(edges)
        measured_var = measured_var + blur_rad**2
        # An edge of which this observation knows nothing (a lean, where only bearings are measured) has no pair.
        known = np.flatnonzero(np.isfinite(measured) & np.isfinite(measured_var))
        order = known[np.argsort(measured[known])]
        reach = GATE_SIGMAS * np.sqrt(position_sigma**2 + measured_var[known].max(initial=0.0))
        first = np.searchsorted(measured[order], predicted - reach)
        last = np.searchsorted(measured[order], predicted + reach)
        pair = np.repeat(np.arange(len(predicted)), last - first)
        within = np.arange(len(pair)) - np.repeat(np.cumsum(last - first) - (last - first), last - first)
        edge = order[first[pair] + within]
        variance = position_sigma[pair] ** 2 + measured_var[edge]
        residual = measured[edge] - predicted[pair]
        density = np.exp(-0.5 * residual**2 / variance) / np.sqrt(2 * np.pi * variance)
        return pair, edge, density / edges.clutter[edge] * self._agreement(edges, landmark_map, seen, pair, edge)

    def _agreement(
        self, edges: Edges, landmark_map: LandmarkMap, seen: Sight, pair: NDArray[np.int64], edge: NDArray[np.int64]
    ) -> Array:
        """Return c_el: how well ends and polarity of each edge agree with its pair's landmark; 1 tells nothing."""
        expected = np.column_stack([seen.e_bottom, seen.e_top])[pair]
        known = np.isfinite(np.column_stack([landmark_map.bottom_m, landmark_map.top_m]))[seen.landmark[pair]]
        margin = self.parameters.sight.margin_px / self.camera.focal_px
        alike = polarity.agreement(edges.polarity[edge], polarity.leaning(landmark_map.polarity)[seen.landmark[pair]])
        return alike * ends.agreement(ends.ends_of(edges, self.camera), edge, expected, known, self.camera, margin)

    def _landmark_sigma(self, landmark_map: LandmarkMap) -> Array:
        """Return the sigma (L,) in metres of each landmark's position, the mean over directions."""
        trace = np.trace(landmark_map.cov, axis1=1, axis2=2)
        return np.where(np.isnan(trace), self.parameters.landmark_sigma_m, np.sqrt(np.maximum(trace, 0) / 2))


def independent_share(increment: Increment, parameters: ObservationParameters) -> float:
    """Return the share of a frame's log-likelihood that is new after moving by `increment`, 0 … 1.

    Errors of an edge are taken as a first-order Markov process over the path: their correlation between two frames is
    ρ = exp(-path/decorrelation_m - turned/decorrelation_rad). Such a chain tells as much about a constant as if each
    frame counted (1 - ρ)/(1 + ρ); so a robot that stands still learns nothing from seeing the same image again.
    """
    exponent = 0.0
    for moved, scale in (
        (increment.path_m, parameters.decorrelation_m),
        (increment.turned_rad, np.radians(parameters.decorrelation_deg)),
    ):
        if scale == 0:
            return 1.0
        exponent += moved / scale
    return float(np.tanh(exponent / 2))
