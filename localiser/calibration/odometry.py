"""How good a robot's odometry is, from drives whose true path is known: noise (alphas) and constant errors.

A drive is cut into pieces of about a metre or a radian. Of each piece the wheels' motion is compared with the true one:

    true distance - distance = distance_scale · distance + N(0, alpha3 · path + alpha4 · turned + error of the truth)
    true turn - turn = turn_scale · turn + veer · distance + N(0, alpha1 · turned + alpha2 · path + error of the truth)

Each drive has constants of its own, as tyres and loads change. Noise is common to all drives. Both are fitted in turns:
the constants by weighted least squares, the logarithms of the alphas by maximum likelihood with a wide prior about the
values in force, so that an alpha of which the drives tell nothing keeps its value.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from localiser.calibration.clock import REACH_S, ClockOffset, offset_of_turns
from localiser.geometry import Array, Increment, Trajectory, between, compose, wrap_angle
from localiser.motion import MotionParameters, linearised

PIECE_M, PIECE_RAD = 1.0, 1.0
"""A turn this small leaves no doubt which way the robot drove."""
FEWEST_PIECES = 10
ALPHAS = ("alpha1", "alpha2", "alpha3", "alpha4")
SCALES = ("distance_scale", "turn_scale", "veer")
_STANDS_M = 1e-6
_LONGEST_NS = 1_000_000_000  # where poses are further apart than this a piece ends: nobody knows what the robot did
_TRUTH_SIGMA = np.array([1e-3, 1e-3])  # error of the truth at each end of a piece: m, rad
_PAIR_NS = 200_000_000
_PRIOR_SIGMA = np.log(10.0)  # of an alpha, as a logarithm: a factor of ten
_KNOWN_DRIVES = 2.0  # as many drives as the sigmas of the constant errors in force count for
_TURNS = 5


@dataclass(frozen=True, slots=True, eq=False)
class Drive:
    """A drive of a robot. truth: its path; truth_cov: (T, 3, 3) of its poses, None where they are true."""

    name: str
    odometry: Trajectory
    truth: Trajectory
    truth_cov: Array | None = None


def on_one_clock(drive: Drive) -> tuple[Drive, ClockOffset]:
    """Return a drive with its truth by the clock of the wheels where these surely differ, and the offset."""
    times = drive.truth.t_ns
    every = max(round(_PAIR_NS / float(np.median(np.diff(times)))), 1) if len(times) > 1 else 1
    kept = np.arange(0, len(times), every)
    reach_ns = int(REACH_S * 1e9)
    kept = kept[
        (times[kept] - reach_ns >= drive.odometry.t_ns[0]) & (times[kept] + reach_ns <= drive.odometry.t_ns[-1])
    ]
    pairs = np.stack([times[kept[:-1]], times[kept[1:]]], axis=-1)
    turns = wrap_angle(np.diff(drive.truth.poses[kept, 2]))
    near = np.diff(pairs, axis=1)[:, 0] <= _LONGEST_NS
    sigma = np.full(len(pairs), _TRUTH_SIGMA[1])
    found = offset_of_turns(pairs[near], np.stack([turns, sigma], axis=-1)[near], drive.odometry)
    if not found.disagrees():
        return drive, found
    earlier_ns = round(found.offset_s * 1e9)
    return replace(drive, truth=Trajectory(drive.truth.t_ns - earlier_ns, drive.truth.poses)), found


@dataclass(frozen=True, slots=True, eq=False)
class Pieces:
    """P pieces of drives.

    drive: (P,) which one. wheels, missing: (P, 2) distance (m) and turn (rad) by wheels, and what is missing to the
    true ones. path_m, turned_rad: (P,) driven and turned on the way. truth_var: (P, 2) of the true distance and turn.
    """

    drive: NDArray[np.int64]
    wheels: Array
    missing: Array
    path_m: Array
    turned_rad: Array
    truth_var: Array

    def __len__(self) -> int:
        return len(self.drive)

    @classmethod
    def of(cls, drive: Drive, index: int, piece_m: float = PIECE_M, piece_rad: float = PIECE_RAD) -> Pieces:
        """Return the pieces of one drive, each at least so long or with so much turning."""
        odometry, truth = drive.odometry, drive.truth
        known = _is_known(truth, odometry.t_ns)
        times, poses = odometry.t_ns[known], odometry.poses[known]
        if len(times) < 2:
            times, poses = odometry.t_ns[:1], odometry.poses[:1]
        step = between(poses[:-1], poses[1:])
        path, turned = (
            np.concatenate([[0.0], np.cumsum(part)]) for part in (np.hypot(*step[:, :2].T), abs(step[:, 2]))
        )
        broken = np.concatenate([[0], np.cumsum(np.diff(times) > _LONGEST_NS)])
        ends = _ends(path / piece_m, turned / piece_rad, broken)
        begin, end = ends.T
        by_wheels, by_truth = (
            between(*(track.sampled(times[side]).poses for side in (begin, end))).reshape(-1, 3)
            for track in (odometry, truth)
        )
        ahead = _ahead(by_wheels)
        wheels, true = (
            np.stack([(motion[:, :2] * ahead).sum(axis=1), motion[:, 2]], axis=-1) for motion in (by_wheels, by_truth)
        )
        var = np.tile(2 * _TRUTH_SIGMA**2, (len(ends), 1))
        if drive.truth_cov is not None:
            at = [np.searchsorted(truth.t_ns, times[side]).clip(0, len(truth) - 1) for side in (begin, end)]
            covs = sum((drive.truth_cov[one] for one in at), np.zeros((3, 3)))
            var = np.stack([np.trace(covs[:, :2, :2], axis1=1, axis2=2) / 2, covs[:, 2, 2]], axis=-1)
        return cls(
            np.full(len(ends), index), wheels, true - wheels, path[end] - path[begin], turned[end] - turned[begin], var
        )

    @classmethod
    def together(cls, parts: Sequence[Pieces]) -> Pieces:
        """Return the pieces of several drives."""
        names = ("drive", "wheels", "missing", "path_m", "turned_rad", "truth_var")
        return cls(*(np.concatenate([getattr(part, name) for part in parts]) for name in names))

    def noise_var(self, motion: MotionParameters) -> Array:
        """Return the variance (P, 2) of distance and turn by the noise of the wheels."""
        distance = motion.alpha3 * self.path_m + motion.alpha4 * self.turned_rad
        return np.stack([distance, motion.alpha1 * self.turned_rad + motion.alpha2 * self.path_m], axis=-1)

    def consistency(self, motion: MotionParameters) -> Array:
        """Return the mean squares (2,) of missing distance and turn over what is expected of them, 1 where honest.

        Expected are noise and constant errors together, as the filter reckons with them.
        """
        bias = motion.bias
        distance, turn = self.wheels.T
        veer = np.deg2rad(bias.veer_sigma_deg_per_m)
        doubt = [(bias.distance_sigma * distance) ** 2, (bias.turn_sigma * turn) ** 2 + (veer * distance) ** 2]
        expected = self.noise_var(motion) + np.stack(doubt, axis=-1) + self.truth_var
        return np.asarray((self.missing**2 / expected).mean(axis=0))


@dataclass(frozen=True, slots=True, eq=False)
class OdometryFit:
    """What D drives say of a robot's odometry.

    before, motion: the parameters in force, and as the drives have them. factor: (4,) one sigma of each alpha, as a
    factor. constants, sigmas: (D, 3) of `SCALES`, shares and rad/m. pieces: of all drives.
    """

    before: MotionParameters
    motion: MotionParameters
    factor: Array
    constants: Array
    sigmas: Array
    pieces: Pieces


def fit_odometry(drives: Sequence[Drive], before: MotionParameters) -> OdometryFit | None:
    """Return noise and constant errors that explain drives best; None where these have too few pieces."""
    pieces = Pieces.together([Pieces.of(drive, index) for index, drive in enumerate(drives)])
    if len(pieces) < FEWEST_PIECES:
        return None
    motion = before
    for _ in range(_TURNS):
        constants, sigmas = _constants(pieces, motion, len(drives))
        (distance, turn), own = pieces.wheels.T, constants[pieces.drive]
        explained = np.stack([own[:, 0] * distance, own[:, 1] * turn + own[:, 2] * distance], axis=-1)
        rest = pieces.missing - explained
        motion, factor = _noise(pieces, rest, motion, before)
    return OdometryFit(before, _with_bias(motion, constants, sigmas), factor, constants, sigmas, pieces)


def _ends(path: Array, turned: Array, broken: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return first and last pose (P, 2) of each piece, from ways and turns (T,) in units of a piece."""
    found, begin = [], 0
    for index in range(1, len(path)):
        if broken[index] != broken[begin]:
            begin = index
        elif path[index] - path[begin] >= 1.0 or turned[index] - turned[begin] >= 1.0:
            found.append((begin, index))
            begin = index
    return np.array(found, dtype=np.int64).reshape(-1, 2)


def _is_known(truth: Trajectory, t_ns: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Return whether (T,) the truth has poses around these times that are not far apart."""
    after = np.searchsorted(truth.t_ns, t_ns).clip(1, len(truth) - 1)
    inside = (t_ns >= truth.t_ns[0]) & (t_ns <= truth.t_ns[-1])
    return np.asarray(inside & (truth.t_ns[after] - truth.t_ns[after - 1] <= _LONGEST_NS))


def _ahead(motion: Array) -> Array:
    """Return the direction (P, 2), right and backward, that motions (P, 3) go along; at a stand the middle heading."""
    chord = np.hypot(*motion[:, :2].T)
    stands = chord < _STANDS_M
    middle = -np.stack([np.sin(motion[:, 2] / 2), np.cos(motion[:, 2] / 2)], axis=-1)
    along = motion[:, :2] / np.where(stands, 1.0, chord)[:, None]
    along *= np.where(motion[:, 1] > 0, -1.0, 1.0)[:, None]
    return np.asarray(np.where(stands[:, None], middle, along))


def _constants(pieces: Pieces, motion: MotionParameters, drives: int) -> tuple[Array, Array]:
    """Return the constant errors (D, 3) of each drive with their sigmas (D, 3), about what is usual of them."""
    bias = motion.bias
    usual = [
        max(bias.distance_sigma, 0.02),
        max(bias.turn_sigma, 0.03),
        np.deg2rad(max(bias.veer_sigma_deg_per_m, 0.5)),
    ]
    prior = np.square(10.0 * np.array(usual))
    var = pieces.noise_var(motion) + pieces.truth_var
    values, sigmas = np.zeros((2, drives, len(SCALES)))
    for drive in range(drives):
        own = pieces.drive == drive
        distance, turn = pieces.wheels[own].T
        for columns, design, axis in (([0], distance[:, None], 0), ([1, 2], np.stack([turn, distance], axis=-1), 1)):
            weighted = design / var[own, axis][:, None]
            cov = np.linalg.inv(design.T @ weighted + np.diag(1.0 / prior[columns]))
            values[drive, columns] = cov @ weighted.T @ pieces.missing[own, axis]
            sigmas[drive, columns] = np.sqrt(np.diag(cov))
    return values, sigmas


def _noise(
    pieces: Pieces, rest: Array, motion: MotionParameters, before: MotionParameters
) -> tuple[MotionParameters, Array]:
    """Return the alphas that make what is not explained (P, 2) most likely, and one sigma of each as a factor (4,)."""
    from scipy.optimize import minimize

    usual = np.log([max(getattr(before, name), 1e-6) for name in ALPHAS])

    def cost(logs: Array) -> float:
        var = pieces.noise_var(_with_alphas(motion, logs)) + pieces.truth_var
        fit = 0.5 * (np.log(var) + rest**2 / var).sum()
        return float(fit + 0.5 * (((logs - usual) / _PRIOR_SIGMA) ** 2).sum())

    start = np.log([max(getattr(motion, name), 1e-9) for name in ALPHAS])
    found = np.asarray(minimize(cost, start, method="L-BFGS-B", bounds=[(np.log(1e-9), 0.0)] * 4).x)
    # Fisher's information of the logarithms: ½ Σ (∂ ln var)(∂ ln var)ᵀ, and that of the prior.
    turned, path, none = pieces.turned_rad, pieces.path_m, np.zeros(len(pieces))
    by_alpha = np.exp(found)[:, None, None] * np.array([[none, turned], [none, path], [path, none], [turned, none]])
    by_log = (by_alpha / (pieces.noise_var(_with_alphas(motion, found)) + pieces.truth_var).T).reshape(4, -1)
    cov = np.linalg.inv(0.5 * by_log @ by_log.T + _PRIOR_SIGMA**-2 * np.eye(4))
    return _with_alphas(motion, found), np.exp(np.sqrt(np.diag(cov)))


def _with_alphas(motion: MotionParameters, logs: Array) -> MotionParameters:
    one, two, three, four = map(float, np.exp(logs))
    return replace(motion, alpha1=one, alpha2=two, alpha3=three, alpha4=four)


def _with_bias(motion: MotionParameters, constants: Array, sigmas: Array) -> MotionParameters:
    """Return parameters whose sigmas of constant errors cover those of the drives.

    A few drives say little of how far others will be off: the sigmas in force count as much as two of them.
    """
    bias = motion.bias
    squares = (constants**2 + sigmas**2).sum(axis=0)
    usual = np.array([bias.distance_sigma, bias.turn_sigma, np.deg2rad(bias.veer_sigma_deg_per_m)])
    distance, turn, veer = np.sqrt((_KNOWN_DRIVES * usual**2 + squares) / (_KNOWN_DRIVES + len(constants)))
    return replace(
        motion,
        bias=replace(
            bias, distance_sigma=float(distance), turn_sigma=float(turn), veer_sigma_deg_per_m=float(np.rad2deg(veer))
        ),
    )


# -- the path of a finished run, smoothed -----------------------------------------------------------------------------


def smooth_path(
    poses: Array, covs: Array, increments: Sequence[Increment], motion: MotionParameters
) -> tuple[Array, Array]:
    """Return poses (T, 3) and covariances (T, 3, 3) of a run with what came later [Rauch, Tung, Striebel 1965].

    increments: (T - 1) motions by odometry, from each image to the next. With F the derivative of a motion and Q its
    noise: gain = P_k Fᵀ (F P_k Fᵀ + Q)⁻¹, x_k ← x_k + gain (x_{k+1} - f(x_k)) and
    P_k ← P_k + gain (P_{k+1} - F P_k Fᵀ - Q) gainᵀ.
    """
    poses, covs = poses.copy(), covs.copy()
    for k in range(len(poses) - 2, -1, -1):
        by_pose, noise = linearised(poses[k], increments[k], motion)
        expected_cov = by_pose @ covs[k] @ by_pose.T + noise + 1e-12 * np.eye(3)
        gain = covs[k] @ by_pose.T @ np.linalg.inv(expected_cov)
        off = poses[k + 1] - compose(poses[k], increments[k].mean)
        off[2] = wrap_angle(off[2])
        poses[k] += gain @ off
        covs[k] += gain @ (covs[k + 1] - expected_cov) @ gain.T
    return poses, covs
