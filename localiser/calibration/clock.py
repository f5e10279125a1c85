"""The offset between the clocks of images and wheels: the turns that edges show, against those that wheels report.

A pair of images shows how far the robot turned between them. The wheels report the same turn, at their own times:

    turn by edges = (1 + scale) · (ψ(t₂ - offset) - ψ(t₁ - offset)) + veer · distance + noise

with ψ the heading by the wheels. For each offset of a grid, scale and veer are fitted within their usual tolerance, and
the noise of the wheels is averaged over. It is Student's t, so that a slipping wheel decides nothing. The scatter of
the results without each part of the drive is added (the delete-a-group jackknife [Efron, Tibshirani 1993]).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from localiser.camera import Camera
from localiser.edges import Edges
from localiser.geometry import Array, Trajectory, between
from localiser.motion import MotionParameters
from localiser.visual_odometry import Gaussian, TwoImages, VisualOdometryParameters, follow

REACH_S = 1.0
"""Offsets up to this are looked for."""
MOST_PAIRS = 120
_COARSE, _FINE = 101, 25
"""How many offsets are compared over the whole reach, and then in a window around the best of them."""
_WIDE_S, _NARROW_S, _CERTAIN_S = 0.15, 0.05, 0.02
"""Half of the windows, and the sigma below which the narrow one is used."""
_FLAT_SHARE = 0.5  # a parabola whose sigma is this share of its window is no peak
_FEW = 9
"""Offsets by which pairs are chosen."""
_LEAST_SIGMA_S = 0.001
_SHORTEST_S, _LONGEST_S = 0.15, 2.0
"""A pair closer in time turns too little to tell, one further apart has too few edges in common."""
_SCALE_SIGMA, _VEER_SIGMA = 0.05, np.deg2rad(1.0)  # tolerances of wheels: share of the turn, rad/m
_WHEEL_NOISE = np.geomspace(0.003, 0.1, 6)  # how noisy wheels may be: sigma of a turn by the root of that turn, √rad
_TURN_A_METRE = MotionParameters().alpha2 / MotionParameters().alpha1
"""A metre adds as much noise to a turn as this turn does (rad/m)."""
_LEAST_TURN_SIGMA = np.deg2rad(0.02)
_SIDEWAYS_SHARE, _WAY_SHARE, _LEAST_WAY_M = 0.05, 0.1, 0.01
"""How far a pair's way may be off that of the wheels, to the side and along it."""
_FREEDOM = 4.0  # degrees of freedom of Student's t: a residual of many sigmas counts little
_SWEEPS = 3
_PARTS, _FEWEST_PAIRS = 8, 16
_LEAST_TURNED_RAD = np.deg2rad(30.0)  # with less turning the noise of the wheels decides, and nothing is told
_CLEAR, _CLEAR_RAD = 3.0, np.deg2rad(1.0)
"""A pair counts as turning beyond so many sigmas, and beyond the errors of a bad pair."""
_WIDE_SHARE = 0.5
"""Of the parabola's width that counts as sigma, beside the scatter of parts: the window widens a narrow peak."""
_SURE = 3.3  # sigmas that chance exceeds in 0.1 % of the cases
TOLERABLE_S = 0.02
"""At a turn of 1 rad/s this is 1.1° of heading, which the filter bears."""
_BORDER_SHARE = 0.95
_VAGUE_S = 0.05  # an offset that is less certain tells little


@dataclass(frozen=True, slots=True)
class ClockOffset:
    """How much later images are stamped than wheels: offset_s, with sigma_s. turned_rad: by edges, in `pairs` pairs.

    With too few pairs their edges are not compared, and turned_rad is 0.
    A pose of the wheels at the time t - offset belongs to an image stamped t.
    """

    offset_s: float
    sigma_s: float
    turned_rad: float
    pairs: int

    @property
    def problem(self) -> str:
        """What is doubtful about the result, for people; empty when nothing is."""
        if self.sigma_s > _VAGUE_S:
            return "The drive hardly tells the offset: that needs turns, with edges in view, that begin and end."
        if abs(self.offset_s) > _BORDER_SHARE * REACH_S:
            return f"This is at the limit of the search, {REACH_S:g} s: write it, and look once more."
        return ""

    def disagrees(self, believed_sigma_s: float = 0.0) -> bool:
        """Whether the clocks surely differ, by more than is tolerable and than one sigma that is reckoned with."""
        off = abs(self.offset_s)
        return off > _SURE * self.sigma_s and off > max(TOLERABLE_S, believed_sigma_s)

    @property
    def text(self) -> str:
        """The offset with its sigma, such as "0.300 s ± 0.004 s later"."""
        return f"{abs(self.offset_s):.3f} s ± {self.sigma_s:.3f} s {'later' if self.offset_s >= 0 else 'earlier'}"

    def warning(self, log: Path, believed_sigma_s: float = 0.0) -> str | None:
        """Return what to tell people of the log at a path, None where the clocks agree."""
        if not self.disagrees(believed_sigma_s):
            return None
        return (
            f"The images are stamped {self.text} than the wheels, by {np.rad2deg(self.turned_rad):.0f}° of turning. "
            f"See `localiser camera sync {log}`."
        )


def clock_offset(
    t_ns: Sequence[int] | NDArray[np.int64],
    edges_of: Callable[[int], Edges],
    odometry: Trajectory,
    camera: Camera,
    *,
    most: int = MOST_PAIRS,
    progress: Callable[[], None] = lambda: None,
) -> ClockOffset:
    """Return the offset of the clock of F images, stamped t_ns (F,), against that of the odometry.

    edges_of: gives the edges of an image by its index; only images of pairs that tell something are asked for, in the
    order of time. most: how many pairs are looked at. progress: is called after each pair.
    """
    stamps = np.asarray(t_ns, dtype=np.int64)
    pairs = telling_pairs(stamps, odometry, most)
    if len(pairs) < _FEWEST_PAIRS:
        return _unknown_offset(0.0, len(pairs))
    times = stamps[pairs]
    turns = _turns_of(pairs, times, edges_of, odometry, camera, progress)
    return offset_of_turns(times, turns, odometry)


def telling_pairs(t_ns: NDArray[np.int64], odometry: Trajectory, most: int = MOST_PAIRS) -> NDArray[np.int64]:
    """Return at most `most` pairs (P, 2) of images in whose time the turn by wheels depends most on the offset.

    The odometry covers them for every offset that is looked for.
    """
    kept: list[int] = []
    for index, time_ns in enumerate(t_ns):
        if not kept or time_ns - t_ns[kept[-1]] >= _SHORTEST_S * 1e9:
            kept.append(index)
    pairs: NDArray[np.int64] = np.stack([kept[:-1], kept[1:]], axis=-1).astype(np.int64)
    if len(odometry) < 2 or not len(pairs):
        return np.zeros((0, 2), dtype=np.int64)
    reach_ns, times = int(REACH_S * 1e9), t_ns[pairs]
    inside = (times[:, 0] - reach_ns >= odometry.t_ns[0]) & (times[:, 1] + reach_ns <= odometry.t_ns[-1])
    pairs = pairs[inside & (np.diff(times, axis=1)[:, 0] <= _LONGEST_S * 1e9)]
    if not len(pairs):
        return pairs
    changes = wheel_turns(t_ns[pairs], unwrapped(odometry), np.linspace(-REACH_S, REACH_S, _FEW)).std(axis=1)
    return np.asarray(pairs[np.sort(np.argsort(-changes, kind="stable")[:most])])


def offset_of_turns(times: NDArray[np.int64], turns: Array, odometry: Trajectory) -> ClockOffset:
    """Return the offset that pairs of images tell, taken at times (P, 2), with turns (P, 2): value and sigma, rad."""
    pairs, count = _Pairs.of(times, turns, odometry), len(times)
    turn, sigma = np.abs(pairs.turns).T
    turned_rad = float(turn[turn > np.maximum(_CLEAR * sigma, _CLEAR_RAD)].sum())
    if count < _FEWEST_PAIRS or turned_rad < _LEAST_TURNED_RAD:
        return _unknown_offset(turned_rad, count)
    offset_s, sigma_s = pairs.offset()
    part = np.arange(count) * _PARTS // count
    without = np.array([pairs.take(part != one).offset()[0] for one in range(_PARTS)])
    sigma_s = float(np.hypot(_WIDE_SHARE * sigma_s, np.sqrt((_PARTS - 1) * without.var())))
    return ClockOffset(offset_s, max(sigma_s, _LEAST_SIGMA_S), turned_rad, count)


def _unknown_offset(turned_rad: float, pairs: int) -> ClockOffset:
    """Return an offset that is anywhere within the reach."""
    return ClockOffset(0.0, float(REACH_S / np.sqrt(3.0)), turned_rad, pairs)


@dataclass(frozen=True, slots=True, eq=False)
class _Pairs:
    """P pairs of images at times (P, 2), with turns (P, 2) by the edges, value and sigma; way_m (P,) by the wheels."""

    times: NDArray[np.int64]
    turns: Array
    way_m: Array
    wheels: Trajectory

    @classmethod
    def of(cls, times: NDArray[np.int64], turns: Array, odometry: Trajectory) -> _Pairs:
        """Return pairs with the headings of the wheels unwrapped."""
        step = between(*(odometry.sampled(times[:, k]).poses for k in (0, 1)))
        return cls(times, turns, np.hypot(*step[:, :2].T), unwrapped(odometry))

    def take(self, chosen: NDArray[np.bool_]) -> _Pairs:
        """Return some of the pairs."""
        return _Pairs(self.times[chosen], self.turns[chosen], self.way_m[chosen], self.wheels)

    def offset(self) -> tuple[float, float]:
        """Return mean and sigma of the offset.

        The wheels' noise makes the likelihood ragged, so a parabola over a window takes the place of the highest point:
        a wide one, and where that is narrow enough one around its peak. Where there is no such peak, mean and sigma are
        those of the posterior over the whole reach.
        """
        coarse = np.linspace(-REACH_S, REACH_S, _COARSE)
        log_density = self.log_posterior(coarse)
        wide = self._peak(self._peak((float(coarse[log_density.argmax()]), 0.0), _WIDE_S), _WIDE_S)
        if wide is None:
            weight = np.exp(log_density - log_density.max())
            mean = float(weight @ coarse / weight.sum())
            return mean, float(np.sqrt(weight @ (coarse - mean) ** 2 / weight.sum()))
        if wide[1] > _CERTAIN_S:
            return wide
        return self._peak(self._peak(wide, _NARROW_S), _NARROW_S) or wide

    def _peak(self, about: tuple[float, float] | None, reach_s: float) -> tuple[float, float] | None:
        """Return where a parabola through the posterior about an offset is highest, and its sigma; None: it is flat."""
        if about is None:
            return None
        offsets = np.linspace(-reach_s, reach_s, _FINE)
        bend, slope, _ = np.polyfit(offsets, self.log_posterior(about[0] + offsets), 2)
        if bend >= -0.5 / (_FLAT_SHARE * reach_s) ** 2:
            return None
        return about[0] + float(np.clip(-slope / (2 * bend), -reach_s, reach_s)), float((-2 * bend) ** -0.5)

    def log_posterior(self, offsets_s: Array) -> Array:
        """Return log p(turns by edges | offset) (G,), averaged over how noisy the wheels may be, up to a constant."""
        wheel, way_m = wheel_turns(self.times, self.wheels, offsets_s), self.way_m[:, None]
        turn, sigma = self.turns.T[:, :, None]
        each = []
        for noise in _WHEEL_NOISE:
            var = sigma**2 + _LEAST_TURN_SIGMA**2 + noise**2 * (np.abs(wheel) + _TURN_A_METRE * way_m)
            scale, veer = np.zeros((2, len(offsets_s)))
            for _ in range(_SWEEPS):  # reweighted least squares of scale and veer
                off = turn - wheel
                weight = (_FREEDOM + 1.0) / (_FREEDOM * var + (off - scale * wheel - veer * way_m) ** 2)
                ss = (weight * wheel * wheel).sum(axis=0) + _SCALE_SIGMA**-2
                sv = (weight * wheel * way_m).sum(axis=0)
                vv = (weight * way_m * way_m).sum(axis=0) + _VEER_SIGMA**-2
                s, v = (weight * wheel * off).sum(axis=0), (weight * way_m * off).sum(axis=0)
                determinant = ss * vv - sv**2
                scale, veer = (vv * s - sv * v) / determinant, (ss * v - sv * s) / determinant
            residual = turn - (1.0 + scale) * wheel - veer * way_m
            fit = -0.5 * np.log(var) - 0.5 * (_FREEDOM + 1.0) * np.log1p(residual**2 / (_FREEDOM * var))
            prior = -0.5 * ((scale / _SCALE_SIGMA) ** 2 + (veer / _VEER_SIGMA) ** 2)
            each.append(fit.sum(axis=0) + prior)
        return np.asarray(np.logaddexp.reduce(each, axis=0))


def unwrapped(odometry: Trajectory) -> Trajectory:
    """Return odometry with headings that do not jump at half a turn."""
    poses = odometry.poses.copy()
    poses[:, 2] = np.unwrap(poses[:, 2])
    return Trajectory(odometry.t_ns, poses)


def wheel_turns(times: NDArray[np.int64], wheels: Trajectory, offsets_s: Array) -> Array:
    """Return the turns (P, G) by wheels, headings unwrapped, between times (P, 2), each earlier by an offset (G,)."""
    if not len(times):
        return np.zeros((0, len(offsets_s)))
    since = wheels.t_ns[0]
    at_s = (times - since)[..., None] / 1e9 - offsets_s
    heading = np.interp(at_s, (wheels.t_ns - since) / 1e9, wheels.poses[:, 2])
    return np.asarray(heading[:, 1] - heading[:, 0])


def _turns_of(
    pairs: NDArray[np.int64],
    times: NDArray[np.int64],
    edges_of: Callable[[int], Edges],
    odometry: Trajectory,
    camera: Camera,
    progress: Callable[[], None],
) -> Array:
    """Return the turn (P, 2) of each pair by its edges, value and sigma, rad; the wheels say about how far it drove."""
    turn_sigma = np.deg2rad(VisualOdometryParameters().turn_deg_s)
    known: dict[int, Edges] = {}
    found, ways = np.zeros((len(pairs), 2)), []
    for offset_s in np.linspace(-REACH_S, REACH_S, _FEW):  # driven backward, earlier by a few offsets
        first, second = (odometry.sampled(times[:, k] - int(offset_s * 1e9)).poses for k in (0, 1))
        ways.append(between(first, second)[:, 1])
    for row, (pair, ways_m) in enumerate(zip(pairs.tolist(), np.stack(ways, axis=-1), strict=True)):
        known = {image: known[image] if image in known else edges_of(image) for image in pair}
        images = TwoImages.of(known[pair[0]], known[pair[1]], camera)
        way_m = ways_m.mean()
        seconds = (times[row, 1] - times[row, 0]) / 1e9
        sigma = [
            _SIDEWAYS_SHARE * abs(way_m) + _LEAST_WAY_M,
            ways_m.std() + _WAY_SHARE * abs(way_m) + _LEAST_WAY_M,
            turn_sigma * seconds,
        ]
        prior = Gaussian(np.array([0.0, way_m, 0.0]), np.diag(np.square(sigma)))
        motion = follow(images, [(prior, 0.0)])
        found[row] = motion.mean[2], np.sqrt(motion.cov[2, 2])
        progress()
    return found
