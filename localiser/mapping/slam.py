"""SLAM: a map from a log alone, with robot poses and landmarks both unknown.

1. Follow edges, with poses from the wheels; smooth; follow again with the better poses and narrower gates, until gates
   are as narrow as true poses allow. What wheels misjudge from frame to frame is gone then, what adds up is not.
2. Close loops: join landmarks that are one by the joint covariance, smooth, open what turns out not to fit, until no
   more are.
3. Associate every edge anew, as with known poses, and smooth, until nothing changes.

Feet on the floor tell the scale after each solve.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from localiser.camera import Camera
from localiser.geometry import Array, forward, wrap_angle
from localiser.mapping.factors import Bearings, Prior, Problem, Wheels
from localiser.mapping.floor_scale import Scale, scale_by_floor_contacts
from localiser.mapping.from_known_poses import with_leftovers
from localiser.mapping.landmarks import Built, fitted, long_enough, measured_sigma, numbered, same_groups
from localiser.mapping.loop_closure import same_landmarks, without_outvoted_tracks
from localiser.mapping.parameters import MappingParameters
from localiser.mapping.place_recognition import recognised
from localiser.mapping.reassociate import reassociate
from localiser.mapping.score_test import without_contradicting_visits
from localiser.mapping.sightings import Index, Sightings
from localiser.mapping.smooth import CONVERGED, Smoothed, dead_reckoned, smooth
from localiser.mapping.tracks import follow
from localiser.mapping.triangulate import misfit

_NARROWING = (1.0, 0.5, 0.25, 0.1, 0.05)  # of the wheels' turn error, in which edges are looked for
_TRUE_TURN_RAD = 7e-4  # how far turns of smoothed poses may be off between two frames
_ROUGHLY = 2e-3  # fall of the cost that ends a solution which is only a step on the way
_CONSTELLATION_ROUNDS = 4
_LOOSE = (100.0, 20.0, 4.0, 1.0)  # bearings are taken to be so much worse while a large loop is pulled together
_LOOP_ROUNDS, _LAST_LOOP_ROUNDS = 12, 4
_PARTING_ROUNDS = 4
_REPEATED = 2.0  # errors of an edge repeat from frame to frame: four sightings say what one independent one would
_ASSOCIATION_ROUNDS = 3
_POSE_BEARING_RAD = 5e-4  # what remains of pose errors in bearings, while associating anew
_FIRST_BEARING_RAD = 3e-3  # the same with poses from the wheels
_NEAR_M, _FAR_M, _GUESS_M = 0.3, 25.0, 4.0


@dataclass(frozen=True, slots=True, eq=False)
class Slam:
    """Robot poses (T, 3) with the first one as given, landmarks, and what was found out about the robot.

    constants: (4,) as in `factors.CONSTANTS`. camera: with the mount's yaw as found. built: landmarks with covariances
    that include the poses'. before: (T, 3) poses before loops were closed.
    """

    poses: Array
    before: Array
    constants: Array
    camera: Camera
    built: Built
    sigma: Array

    def text(self) -> str:
        """Return in words what was found out about the robot."""
        scale, rotation, veer, yaw = self.constants
        moved = np.hypot(*(self.poses - self.before)[:, :2].T).max()
        return (
            f"Wheels say {100 * scale:+.1f} % of the distance and {100 * rotation:+.1f} % of the turns, "
            f"and {np.rad2deg(veer):+.2f}° of turn a metre that is none; "
            f"the camera's yaw is {np.rad2deg(yaw):+.2f}° from what is stated.\n"
            f"Closing loops moved the robot's path by up to {moved:.2f} m."
        )


def build_from_log(
    sightings: Sightings,
    wheels: Wheels,
    prior: Prior,
    first_pose: Array,
    camera: Camera,
    parameters: MappingParameters,
) -> Slam:
    """Return poses and landmarks of T frames from their edges and the wheels' motion between them.

    prior: of the constant errors of wheels and mount. first_pose: (3,) where the robot began.
    """
    sigma = _REPEATED * measured_sigma(sightings, camera.focal_px, parameters)
    solver = _Solver(sightings, wheels, prior, camera, parameters, sigma)
    nowhere = np.full((len(sightings), 2), np.nan)
    state = _Estimate(dead_reckoned(wheels), np.zeros(4), prior, camera, nowhere)
    turn = np.concatenate([[_TRUE_TURN_RAD], wheels.turn_sigma])
    noise = _FIRST_BEARING_RAD
    for narrowing in _NARROWING:
        track = solver.follow(state, np.maximum(narrowing * turn, _TRUE_TURN_RAD))
        state, built, smoothed = solver.solve(state, numbered(long_enough(track)), noise, converged=_ROUGHLY)
        noise = _POSE_BEARING_RAD
    before = state.poses
    for _ in range(_CONSTELLATION_ROUNDS):
        joined = recognised(smoothed.points, built, sightings.frame[built.used])
        if (joined == np.arange(len(built))).all():
            break
        of = numbered(np.where(built.of >= 0, joined[built.of], -1))
        # Drift looks like wrong bearings to a robust cost: it must see it as noise first.
        for loose in _LOOSE:
            state, built, smoothed = solver.solve(state, of, noise, loose, converged=_ROUGHLY)
        state, built, smoothed = solver.open_wrong_loops(state, built, smoothed, track)
    state, built, smoothed = solver.close_loops(state, built, smoothed, track, _LOOP_ROUNDS)
    for _ in range(_ASSOCIATION_ROUNDS):
        previous = built.of
        track = solver.follow(state, np.full(sightings.frames, _TRUE_TURN_RAD))
        of = reassociate(sightings, built, state.cameras, np.hypot(solver.sigma, _POSE_BEARING_RAD), parameters)
        state, built, smoothed = solver.solve(state, with_leftovers(of, track), noise)
        state, built, smoothed = solver.close_loops(state, built, smoothed, track, _LAST_LOOP_ROUNDS)
        if same_groups(built.of, previous):
            break
    return _in_map(solver, state, built, smoothed, before, first_pose)


@dataclass(frozen=True, slots=True, eq=False)
class _Estimate:
    """What is believed so far: poses (T, 3) from the first one at the origin, constants, their prior, the camera.

    places: (S, 2) where the landmark of each sighting stands; nan where it has none.
    """

    poses: Array
    constants: Array
    prior: Prior
    camera: Camera
    places: Array

    @property
    def cameras(self) -> Array:
        return self.camera.pose_in_map(self.poses)


@dataclass(frozen=True, slots=True, eq=False)
class _Solver:
    """What is measured; see `build_from_log`."""

    sightings: Sightings
    wheels: Wheels
    prior: Prior
    camera: Camera
    parameters: MappingParameters
    sigma: Array

    def follow(self, state: _Estimate, turn_sigma: Array) -> Index:
        """Return the tracks (S,) of the edges by the poses as they are believed to be."""
        return follow(self.sightings, state.cameras, turn_sigma, self.parameters.tracks)

    def solve(
        self, state: _Estimate, of: Index, noise_rad: float, loose: float = 1.0, converged: float = CONVERGED
    ) -> tuple[_Estimate, Built, Smoothed]:
        """Return the smoothed estimate when `of` (S,) says which landmark each sighting is of."""
        s = self.sightings
        built = fitted(s, of, state.cameras, np.hypot(self.sigma, noise_rad))
        problem = self._problem(state, built, loose)
        smoothed = smooth(problem, state.poses, self._start(built, state), state.constants, converged=converged)
        yaw = self.camera.mount.yaw_rad + float(smoothed.constants[3])
        places = np.full((len(s), 2), np.nan)
        places[built.used] = smoothed.points[built.of[built.used]]
        camera = self.camera.with_mount(yaw_rad=yaw)
        moved = _Estimate(smoothed.poses, smoothed.constants, state.prior, camera, places)
        return replace(moved, prior=self._prior(moved, built, smoothed)), built, smoothed

    def close_loops(
        self, state: _Estimate, built: Built, smoothed: Smoothed, track: Index, rounds: int
    ) -> tuple[_Estimate, Built, Smoothed]:
        """Return the estimate after joining landmarks that are one, and solving again, until no more are."""
        for _ in range(rounds):
            joined = same_landmarks(smoothed.points, smoothed.difference_cov, built, self.sightings.frame[built.used])
            if (joined == np.arange(len(built))).all():
                break
            of = numbered(np.where(built.of >= 0, joined[built.of], -1))
            before = built.of
            state, built, smoothed = self.solve(state, of, _POSE_BEARING_RAD)
            state, built, smoothed = self.open_wrong_loops(state, built, smoothed, track)
            if same_groups(built.of, before):
                break
        return state, built, smoothed

    def open_wrong_loops(
        self, state: _Estimate, built: Built, smoothed: Smoothed, track: Index
    ) -> tuple[_Estimate, Built, Smoothed]:
        """Return the estimate after parting tracks and visits from landmarks that they do not fit, until all fit."""
        for _ in range(_PARTING_ROUNDS):
            parted = without_outvoted_tracks(built, smoothed.weight, track)
            if (parted == built.of).all():
                parted = without_contradicting_visits(self._problem(state, built), smoothed, built.of, built.used)
            if (parted == built.of).all():
                break
            of = numbered(long_enough(parted))
            state, built, smoothed = self.solve(state, of, _POSE_BEARING_RAD, converged=_ROUGHLY)
        return state, built, smoothed

    def _problem(self, state: _Estimate, built: Built, loose: float = 1.0) -> Problem:
        """Return what is measured when landmarks are as built, with bearings taken to be `loose` times as bad."""
        s, used = self.sightings, built.used
        bearings = Bearings(s.frame[used], built.of[used], s.bearing[used], loose * self.sigma[used])
        return Problem(self.wheels, bearings, self.camera, state.prior)

    def _start(self, built: Built, state: _Estimate) -> Array:
        """Return the places (L, 2) to start from, each the one that its bearings fit best.

        Of where it was believed to be, where its rays meet, and a likely distance along the first of them.
        """
        s, landmark = self.sightings, built.of[built.used]
        first = np.zeros(len(built), dtype=np.int64)
        first[landmark[::-1]] = built.used[::-1]
        pose = state.cameras[s.frame[first]]
        guess = np.where(np.isfinite(s.foot_m[first]), np.clip(s.foot_m[first], 0.5, 8.0), _GUESS_M)
        ray = pose[:, :2] + guess[:, None] * forward(pose[:, 2] - s.bearing[first])
        depth = np.bincount(landmark, built.fit.depth_m, len(built)) / np.bincount(landmark, minlength=len(built))
        placed = (built.parallax > np.deg2rad(2.0)) & (depth > _NEAR_M) & (depth < _FAR_M)
        met = np.where(placed[:, None], built.fit.points, ray)
        before = np.where(np.isfinite(state.places[first]), state.places[first], ray)
        starts = np.stack([ray, met, before])
        seen_from = state.cameras[s.frame[built.used]]
        direction = wrap_angle(seen_from[:, 2] - s.bearing[built.used])
        cost = [misfit(start, landmark, seen_from, direction, self.sigma[built.used]) for start in starts]
        return np.asarray(starts[np.argmin(cost, axis=0), np.arange(len(built))])

    def _prior(self, state: _Estimate, built: Built, smoothed: Smoothed) -> Prior:
        """Return the prior of the constants with what feet say of the scale."""
        present = np.log1p(state.constants[0])
        # Distances that grow by a factor make the wheels' scale fall by it; the wheels are taken to be about right.
        known = Scale(float(present), float(self.prior.sigma[0]))
        # A foot tells the scale only where parallax tells the distance, too.
        placed = built.parallax >= np.deg2rad(self.parameters.parallax_min_deg)
        of = np.where((built.of >= 0) & placed[built.of], built.of, -1)
        scale = scale_by_floor_contacts(self.sightings, of, smoothed.points, state.cameras, known)
        if not np.isfinite(scale.sigma):
            return self.prior
        mean, sigma = self.prior.mean.copy(), self.prior.sigma.copy()
        mean[0], sigma[0] = np.expm1(present - scale.log), scale.sigma
        return Prior(mean, sigma)


def _in_map(
    solver: _Solver, state: _Estimate, built: Built, smoothed: Smoothed, before: Array, first_pose: Array
) -> Slam:
    """Return the result moved so that the first pose is as given (3,)."""
    from localiser.geometry import compose, map_from_robot

    cos, sin = np.cos(first_pose[2]), np.sin(first_pose[2])
    turn = np.array([[cos, sin], [-sin, cos]])
    cov = turn @ smoothed.landmark_cov() @ turn.T
    points = map_from_robot(first_pose, smoothed.points)
    poses = compose(first_pose, state.poses)
    moved = fitted(solver.sightings, built.of, state.camera.pose_in_map(poses), solver.sigma)
    fit = replace(moved.fit, points=points, information=np.linalg.inv(cov), weight=smoothed.weight)
    fit = replace(fit, residual=wrap_angle(smoothed.residual), chi2=(smoothed.residual / solver.sigma[built.used]) ** 2)
    return Slam(
        poses, compose(first_pose, before), state.constants, state.camera, replace(moved, fit=fit), solver.sigma
    )
