"""SLAM: a map from a log alone, with robot poses and landmarks both unknown.

The steps are those of docs/mapping.md: track, with gates that narrow until they are as narrow as true poses allow;
close loops, and open those that do not fit; associate again. After each solve, feet on the floor determine the scale.
"""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass, replace

import numpy as np

from localiser.camera import Camera
from localiser.geometry import Array, compose, forward, map_from_robot, wrap_angle
from localiser.mapping.factors import CONSTANTS, Bearings, Prior, Problem, Steps
from localiser.mapping.known_poses import reassociate, with_leftovers
from localiser.mapping.landmarks import Built, fit_landmarks, long_enough, measured_sigma, misfit, renumber, same_groups
from localiser.mapping.loop_closure import (
    contradicting_steps,
    contradiction,
    same_landmarks,
    without_contradicting_visits,
    without_outvoted_tracks,
)
from localiser.mapping.place_recognition import recognise_groups
from localiser.mapping.sightings import Index, Sightings
from localiser.mapping.smooth import CONVERGED, Scale, Smoothed, dead_reckoning, scale_by_floor_contacts, smooth
from localiser.mapping.tracks import MappingParameters, follow

_NARROWING = (1.0, 0.5, 0.25, 0.1, 0.05)  # of the wheels' turn error, in which edges are looked for
_CLEAR = 3.0  # log-likelihood by which an association must be better than any other, to be clear
_CONSTANTS_GATE = 16.3  # 99.7 % of a Gaussian of four dimensions
_TRUE_TURN_RAD = 7e-4  # how far turns of smoothed poses may be off between two frames
_ROUGHLY = 2e-3  # fall of the cost that ends a solution which is only a step on the way
_RECOGNITION_ROUNDS = 4
_SMALL_LOOP_M = 0.2  # drift that single landmarks can be told in spite of
_LOOSE = (100.0, 20.0, 4.0, 1.0)  # bearings are taken to be so much worse while a large loop is pulled together
_LOOP_ROUNDS, _LAST_LOOP_ROUNDS = 12, 4
_STILL_SHARE = 0.5  # of a landmark's own error: a round of small loops that moves the path (RMS) by less is the last
_PARTING_ROUNDS = 4
_REPEATED = 2.0  # errors of an edge repeat from frame to frame: four sightings say what one independent one would
_ASSOCIATION_ROUNDS = 3
_POSE_BEARING_RAD = 5e-4  # what remains of pose errors in bearings, while associating anew
_FIRST_BEARING_RAD = 3e-3  # the same with poses from the wheels
_NEAR_M, _FAR_M, _GUESS_M = 0.3, 25.0, 4.0


@dataclass(frozen=True, slots=True, eq=False)
class Slam:
    """Robot poses (T, 3) with the first one as given, landmarks, and what was found out about the robot.

    constants: (4,) as in `factors.CONSTANTS`. cameras: (T, 3) with the mount's yaw as found. built: landmarks with
    covariances that include the poses'. before: (T, 3) poses before loops were closed. clear_only: edges that could be
    of more than one landmark were left out. loops_left_out: why no loops were closed.
    """

    poses: Array
    before: Array
    constants: Array
    cameras: Array
    built: Built
    sigma: Array
    clear_only: bool = False
    loops_left_out: str | None = None

    def text(self) -> str:
        """Return in words what was found out about the robot."""
        scale, rotation, veer, yaw = self.constants
        moved = np.hypot(*(self.poses - self.before)[:, :2].T).max()
        closed = f"Closing loops moved the robot's path by up to {moved:.2f} m."
        if self.loops_left_out is not None:
            closed = f"No loops were closed, because with those found {self.loops_left_out}: the map drifts."
        clear = "Edges that could be of more than one landmark were left out: with them the wheels' scale was not as "
        clear += "clear edges say.\n"
        return (
            f"Wheels say {100 * scale:+.1f} % of the distance and {100 * rotation:+.1f} % of the turns, "
            f"and {np.rad2deg(veer):+.2f}° of turn a metre that is none; "
            f"the camera's yaw is {np.rad2deg(yaw):+.2f}° from what is stated.\n"
            f"{clear if self.clear_only else ''}{closed}"
        )


def build_from_log(
    sightings: Sightings, wheels: Steps, prior: Prior, first_pose: Array, camera: Camera, parameters: MappingParameters
) -> Slam:
    """Return poses and landmarks of T frames from their edges and the wheels' motion between them.

    prior: of the constant errors of wheels and mount. first_pose: (3,) where the robot began.
    """
    slam = _track(_Solver(sightings, wheels, prior, camera, parameters))
    clear = _track(_Solver(sightings, wheels, prior, camera, parameters, _CLEAR))
    if clear.contradicts(slam):
        slam = clear
    tracked = copy(slam)
    slam.close_all_loops()
    why = contradiction(wheels, prior, slam.poses, slam.constants)
    if why is not None:
        slam = tracked
    return slam.in_map(tracked.poses, first_pose, why)


def _track(slam: _Solver) -> _Solver:
    """Return the solver with edges tracked and poses smoothed, in gates that narrow as the poses get better."""
    turn = np.concatenate([[_TRUE_TURN_RAD], slam.wheels.turn_sigma])
    noise = _FIRST_BEARING_RAD
    for narrowing in _NARROWING:
        slam.follow(np.maximum(narrowing * turn, _TRUE_TURN_RAD))
        slam.solve(renumber(long_enough(slam.track)), noise, converged=_ROUGHLY)
        noise = _POSE_BEARING_RAD
    for _ in range(_PARTING_ROUNDS):
        steps = contradicting_steps(slam.wheels, slam.poses, slam.constants)
        if not len(steps):
            break
        slam.part_at(steps)
    return slam


class _Solver:
    """What is measured, and what is believed so far.

    poses: (T, 3) from the first one at the origin. constants, prior, robot_from_level: see `factors`.
    track: (S,) of each sighting. built, smoothed: landmarks with their sightings, and the last solution. places: (S, 2)
    where the landmark of each sighting stands; nan where it has none. margin: by which an association must be
    better than any other, see `assign`.
    """

    built: Built
    smoothed: Smoothed
    track: Index

    def __init__(
        self,
        sightings: Sightings,
        wheels: Steps,
        prior: Prior,
        camera: Camera,
        parameters: MappingParameters,
        margin: float = 0.0,
    ) -> None:
        self.margin = margin
        self.sightings, self.wheels, self.parameters = sightings, wheels, parameters
        self.robot_from_level, self.stated_prior = sightings.robot_from_level(camera), prior
        self.sigma = _REPEATED * measured_sigma(sightings, camera.focal_px, parameters)
        self.poses, self.constants = dead_reckoning(wheels), np.zeros(len(CONSTANTS))
        self.prior = prior
        self.places = np.full((len(sightings), 2), np.nan)

    @property
    def cameras(self) -> Array:
        """Camera poses (T, 3) as they are believed to be, with the yaw of the mount as found."""
        return self.cameras_of(self.poses)

    def cameras_of(self, poses: Array) -> Array:
        """Return the camera poses (T, 3) of robots at `poses` (T, 3)."""
        return compose(poses, self.robot_from_level + np.array([0.0, 0.0, self.constants[3]]))

    @property
    def frames_used(self) -> Index:
        """The frame (K,) of each sighting that has a landmark."""
        return self.sightings.frame[self.built.used]

    def contradicts(self, other: _Solver) -> bool:
        """Return whether the constants of another solution are not what this one allows [Hausman 1978]."""
        apart = other.constants - self.constants
        chi2 = apart @ np.linalg.solve(self.smoothed.constants_cov(), apart)
        return bool(chi2 > _CONSTANTS_GATE)

    def follow(self, turn_sigma: Array) -> None:
        """Follow the edges by the poses as they are believed to be."""
        self.track = follow(self.sightings, self.cameras, turn_sigma, self.parameters.tracks, self.margin)

    def solve(self, of: Index, noise_rad: float, loose: float = 1.0, converged: float = CONVERGED) -> None:
        """Smooth, when `of` (S,) says which landmark each sighting is of; bearings taken to be `loose` times as bad."""
        self.built = fit_landmarks(self.sightings, of, self.cameras, np.hypot(self.sigma, noise_rad))
        start = self._start()
        self.smoothed = smooth(self._problem(loose), self.poses, start, self.constants, converged=converged)
        self.poses, self.constants = self.smoothed.poses, self.smoothed.constants
        self.places = np.full((len(self.sightings), 2), np.nan)
        self.places[self.built.used] = self.smoothed.points[self.built.of[self.built.used]]
        self.prior = self._prior_with_scale()

    def part_at(self, steps: Index) -> None:
        """Part every landmark that is seen both before and after one of the steps (K,) between images, and smooth.

        Where the path contradicts the wheels from one image to the next, edges were taken for their neighbours. Those
        that are one all the same are joined again as loops are.
        """
        after = np.searchsorted(steps, self.sightings.frame, side="left")
        self.track = np.where(self.track >= 0, self.track * (len(steps) + 1) + after, -1)
        of = np.where(self.built.of >= 0, self.built.of * (len(steps) + 1) + after, -1)
        self.solve(renumber(long_enough(of)), _POSE_BEARING_RAD)

    def relabel(self, number: Index) -> Index | None:
        """Return the landmarks (S,) of sightings when each landmark becomes `number` (L,); None if all stay."""
        if (number == np.arange(len(self.built))).all():
            return None
        return renumber(np.where(self.built.of >= 0, number[self.built.of], -1))

    def close_all_loops(self) -> None:
        """Close large loops, then small ones, and associate all edges again, until nothing changes."""
        for _ in range(_RECOGNITION_ROUNDS):
            found = recognise_groups(self.smoothed.points, self.built, self.frames_used)
            of = self.relabel(found.number)
            if of is None or not found.far(self.smoothed.points, _SMALL_LOOP_M):
                break
            # From where drift left them, poses may end in a minimum of the cost that is not the least one.
            self.poses, self.places[:] = found.moved(self.poses), np.nan
            # Drift looks like wrong bearings to a robust cost: it must see it as noise first.
            for loose in _LOOSE:
                self.solve(of, _POSE_BEARING_RAD, loose, converged=_ROUGHLY)
            self.open_wrong_loops()
        self.close_loops(_LOOP_ROUNDS)
        for _ in range(_ASSOCIATION_ROUNDS):
            previous = self.built.of
            self.follow(np.full(self.sightings.frames, _TRUE_TURN_RAD))
            sigma = np.hypot(self.sigma, _POSE_BEARING_RAD)
            of = reassociate(self.sightings, self.built, self.cameras, sigma, self.parameters, self.margin)
            self.solve(with_leftovers(of, self.track), _POSE_BEARING_RAD)
            self.close_loops(_LAST_LOOP_ROUNDS)
            if same_groups(self.built.of, previous):
                break

    def close_loops(self, rounds: int) -> None:
        """Join landmarks that are one, and solve again, until no more are or the path stands still.

        In a long log each place is tied by many landmarks: joining one more of them changes nothing.
        """
        still_m = _STILL_SHARE * self.parameters.place_sigma_m
        for _ in range(rounds):
            before, path = self.built.of, self.poses[:, :2]
            of = self.relabel(same_landmarks(self.smoothed, self.built, self.frames_used))
            if of is None:
                break
            self.solve(of, _POSE_BEARING_RAD)
            self.open_wrong_loops()
            moved = np.sqrt(np.square(self.poses[:, :2] - path).sum(axis=1).mean())
            if same_groups(self.built.of, before) or moved < still_m:
                break

    def open_wrong_loops(self) -> None:
        """Part tracks and visits from landmarks that they do not fit, and solve again, until all fit."""
        for _ in range(_PARTING_ROUNDS):
            of, used = self.built.of, self.built.used
            parted = without_outvoted_tracks(self.built, self.smoothed.weight, self.track)
            if (parted == of).all():
                parted = without_contradicting_visits(self._problem(), self.smoothed, of, used)
            if (parted == of).all():
                break
            self.solve(renumber(long_enough(parted)), _POSE_BEARING_RAD, converged=_ROUGHLY)

    def _problem(self, loose: float = 1.0) -> Problem:
        s, used = self.sightings, self.built.used
        bearings = Bearings(s.frame[used], self.built.of[used], s.bearing[used], loose * self.sigma[used])
        return Problem(self.wheels, bearings, self.robot_from_level, self.prior)

    def _start(self) -> Array:
        """Return the places (L, 2) to start from, each the one that its bearings fit best.

        Of where it was believed to be, where its rays meet, and a likely distance along the first of them.
        """
        s, built = self.sightings, self.built
        landmark = built.of[built.used]
        first = np.zeros(len(built), dtype=np.int64)
        first[landmark[::-1]] = built.used[::-1]
        pose = self.cameras[s.frame[first]]
        guess = np.where(np.isfinite(s.foot_m[first]), np.clip(s.foot_m[first], 0.5, 8.0), _GUESS_M)
        ray = pose[:, :2] + guess[:, None] * forward(pose[:, 2] - s.bearing[first])
        depth = np.bincount(landmark, built.fit.depth_m, len(built)) / np.bincount(landmark, minlength=len(built))
        placed = (built.parallax > np.deg2rad(2.0)) & (depth > _NEAR_M) & (depth < _FAR_M)
        met = np.where(placed[:, None], built.fit.points, ray)
        before = np.where(np.isfinite(self.places[first]), self.places[first], ray)
        starts = np.stack([ray, met, before])
        seen_from = self.cameras[s.frame[built.used]]
        direction = wrap_angle(seen_from[:, 2] - s.bearing[built.used])
        cost = [misfit(start, landmark, seen_from, direction, self.sigma[built.used]) for start in starts]
        return np.asarray(starts[np.argmin(cost, axis=0), np.arange(len(built))])

    def _prior_with_scale(self) -> Prior:
        """Return the prior of the constants with what feet say of the scale."""
        built, present = self.built, np.log1p(self.constants[0])
        # Distances that grow by a factor make the wheels' scale fall by it; the wheels are taken to be about right.
        known = Scale(float(present), float(self.stated_prior.sigma[0]))
        # A foot tells the scale only where parallax tells the distance, too.
        placed = built.parallax >= np.deg2rad(self.parameters.parallax_min_deg)
        of = np.where(np.append(placed, False)[built.of], built.of, -1)  # -1 is none
        scale = scale_by_floor_contacts(self.sightings, of, self.smoothed.points, self.cameras, known)
        if not np.isfinite(scale.sigma):
            return self.stated_prior
        mean, sigma = self.stated_prior.mean.copy(), self.stated_prior.sigma.copy()
        mean[0], sigma[0] = np.expm1(present - scale.log), scale.sigma
        return Prior(mean, sigma)

    def in_map(self, before: Array, first_pose: Array, left_out: str | None) -> Slam:
        """Return the result moved so that the first pose is as given (3,); the rest is as in `Slam`."""
        cos, sin = np.cos(first_pose[2]), np.sin(first_pose[2])
        turn = np.array([[cos, sin], [-sin, cos]])
        cov = turn @ self.smoothed.landmark_cov() @ turn.T
        points = map_from_robot(first_pose, self.smoothed.points)
        poses = compose(first_pose, self.poses)
        cameras = self.cameras_of(poses)
        moved = fit_landmarks(self.sightings, self.built.of, cameras, self.sigma)
        fit = replace(moved.fit, points=points, information=np.linalg.inv(cov), weight=self.smoothed.weight)
        fit = replace(
            fit,
            residual=wrap_angle(self.smoothed.residual),
            chi2=(self.smoothed.residual / self.sigma[self.built.used]) ** 2,
        )
        return Slam(
            poses,
            compose(first_pose, before),
            self.constants,
            cameras,
            replace(moved, fit=fit),
            self.sigma,
            self.margin > 0,
            left_out,
        )
