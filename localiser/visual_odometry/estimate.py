"""The motion between two images: find a start by votes, then pair edges and solve for the motion alternately.

The errors of edges of one thing are not independent: all edges of a poster end above the floor, and a moving chair
moves all of its edges. A covariance that treats them as independent is far too small. So the motion is estimated again
without the edges of each group in turn. The covariance is at least the scatter of these results (the delete-a-group
jackknife [Efron, Tibshirani 1993, chapter 11]). It is large where everything depends on one group.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from localiser.camera import Camera
from localiser.edges import Edges
from localiser.geometry import Array
from localiser.geometry.compiled import compiled
from localiser.landmarks import field_of_view_rad
from localiser.visual_odometry.sights import (
    FLOOR_SHARES,
    FOLLOWED_SHARE,
    FOOT_UNEVEN_SIGMA_M,
    HUNG_SHARE,
    NEIGHBOUR_SHARE,
    NEIGHBOUR_SIGMA_RAD,
    TYPICAL_INVERSE_RANGE,
    TYPICAL_SPREAD,
    Pairs,
    Sights,
    candidates,
    errs_apart,
    with_errors_apart,
)
from localiser.visual_odometry.twist import Gaussian, at_least, mixture, motion_gaussian

if TYPE_CHECKING:
    from localiser.visual_odometry import twist_kernel as kernel

_REACH = 2.5  # sigmas of the prior that are searched
_BIN_RAD = np.deg2rad(0.25)
_WIDTHS_RAD = np.deg2rad([0.3, 0.6, 1.2, 2.4, 4.8])
_GRID = np.linspace(-1.0, 1.0, 7)
_MOST_BINS = 1440
_KERNEL_REACH = 3.0  # sigmas


_PEAKS = 4
_HANGING_SHARE = 0.3
"""Of views in which no lower end is a foot: a wall close by and what hangs on it. All such edges seem far, their ends
near the horizon, and agree on a wrong motion, each as surely as a foot; taken one by one they would win."""
_APART_RAD = np.deg2rad(3.0)
"""Edges closer together than this are likely of one thing: a door, a poster, a shelf."""
_START_SIGMA = np.array([2e-3, 2e-3, 5e-4])
"""How far a start of the search may be off: right, backward (m), turn (rad)."""


@dataclass(frozen=True, slots=True, eq=False)
class Followed:
    """How the robot moved, by the edges of two frames.

    twist: of the motion, right (m), backward (m), turn (rad) in the robot frame of the first.
    first, second: (M,) indices of the edges that were followed.
    log_evidence: of how well the frames are explained, by Laplace's approximation.
    has_feet: whether any lower end was taken for a foot.
    """

    twist: Gaussian
    first: NDArray[np.int64]
    second: NDArray[np.int64]
    log_evidence: float
    has_feet: bool

    @property
    def motion(self) -> Gaussian:
        """The motion itself: right (m), backward (m), turn (rad)."""
        return motion_gaussian(self.twist)


@dataclass(frozen=True, slots=True, eq=False)
class Frames:
    """Two frames, made ready once to be followed under one belief or another.

    mount: (5,) of the camera, see `twist_kernel.camera_moved`.
    """

    sights: tuple[Sights, Sights]
    pairs: Pairs
    camera: Camera
    mount: Array

    @classmethod
    def of(cls, before: Edges, after: Edges, camera: Camera) -> Frames:
        """Return the frames with these edges, seen by one camera, whose mount may differ from one to the other."""
        sights = Sights.of(before, camera), Sights.of(after, camera)
        if len(before) and len(after) and errs_apart(before, after):
            sights = with_errors_apart(*sights)
        one, two = (camera.at(edges.mount).robot_from_level[:2] for edges in (before, after))
        mount = np.array([*one, camera.mount.yaw_rad, *(two - one)])
        return cls(sights, candidates(before, after), camera, mount)

    def model(self) -> kernel.Model:
        """Return what edges are like, as the compiled loops take it."""
        from localiser.visual_odometry import twist_kernel as kernel

        followed = FOLLOWED_SHARE / max(len(self.sights[0].bearing), 1)
        return kernel.Model(
            HUNG_SHARE,
            NEIGHBOUR_SHARE,
            NEIGHBOUR_SIGMA_RAD,
            TYPICAL_INVERSE_RANGE,
            TYPICAL_SPREAD,
            FOOT_UNEVEN_SIGMA_M / self.camera.mount.height_m,
            (1.0 - FOLLOWED_SHARE) / followed / field_of_view_rad(self.camera),
            *FLOOR_SHARES,
        )

    def arrays(self) -> tuple[kernel.Frame, kernel.Frame]:
        """Return both frames as the compiled loops take them."""
        from localiser.visual_odometry import twist_kernel as kernel

        one, two = (kernel.Frame(sight.measured, sight.sigma, sight.common) for sight in self.sights)
        return one, two

    def likely_motions(self, prior: Gaussian) -> list[Array]:
        """Return up to `_PEAKS` twists (3,) that most pairs agree on, of turns apart from one another, best first.

        A Hough transform: for a coarse grid of translations, among those that the prior allows, each pair votes for its
        change of bearing minus the parallax, blurred by the uncertainty of its range and of the grid.
        """
        from localiser.visual_odometry import twist_kernel as kernel

        (one, two), pairs = self.sights, self.pairs
        sigma = np.sqrt(np.diag(prior.cov))
        reach = min(_REACH * sigma[2], np.pi)
        bins = int(np.clip(2 * reach / _BIN_RAD, 3, _MOST_BINS)) | 1
        turns = prior.mean[2] + np.linspace(-reach, reach, bins)
        offset = np.stack(np.meshgrid(_GRID, _GRID), axis=-1).reshape(-1, 2) * _REACH * 0.8
        grid = prior.mean[:2] + offset * sigma[:2]
        cell = (_GRID[1] - _GRID[0]) * _REACH * 0.8 * sigma[:2] / 2
        moves = np.array([kernel.camera_moved(np.array([*step, 0.0]), self.mount)[:2] for step in grid])

        kernels = _kernels(turns[1] - turns[0])
        foot = one.inverse_range[pairs.first]
        foot = np.where(np.isnan(foot), two.inverse_range[pairs.second], foot)
        found = compiled(votes_loop)(
            two.bearing[pairs.second],
            np.where(np.isnan(foot), TYPICAL_INVERSE_RANGE, foot),
            np.where(np.isnan(foot), TYPICAL_SPREAD, 0.2 * TYPICAL_SPREAD),
            one.bearing[pairs.first],
            pairs.look,
            moves,
            cell,
            turns[0],
            turns[1] - turns[0],
            bins,
            _WIDTHS_RAD,
            kernels,
            (kernels > 0).sum(axis=1),
        )
        found = found * np.exp(-0.5 * (offset**2).sum(axis=-1)[:, None] / 4)
        return [np.array([*grid[row], turns[column]]) for row, column in _peaks(found, turns)]


@dataclass(frozen=True, slots=True, eq=False)
class Belief:
    """What may be believed of a twist before edges are followed.

    prior: of the twist. starts: twists (3,) to begin at. log_share: of how often the belief is right.
    """

    prior: Gaussian
    starts: Sequence[Array]
    log_share: float = 0.0


def follow(frames: Frames, beliefs: Sequence[Belief]) -> Followed:
    """Return the motion between two frames, given what may be believed of it.

    Each belief explains the edges more or less well, and Bayes' rule weighs them by that. Where contradicting motions
    explain them alike, the covariance reaches from the one to the other [Bar-Shalom, Li, Kirubarajan 2001, section
    1.4.16]: contradictions are never averaged into something certain, and the map decides.
    """
    found: list[tuple[_Solver, Followed]] = []
    for belief in beliefs:
        solver = _Solver(frames, belief)
        found += [(solver, followed) for followed in (solver.nothing(), *solver.explanations())]
    solver, best = max(found, key=lambda pair: pair[1].log_evidence)
    whole = mixture([other.twist for _, other in found], np.array([other.log_evidence for _, other in found]))
    return replace(best, twist=Gaussian(whole.mean, at_least(whole.cov, solver.fragility(best))))


class _Solver:
    """Pairs edges and solves for the motion in turns, under one belief."""

    def __init__(self, frames: Frames, belief: Belief) -> None:
        self._frames, self._belief = frames, belief
        self._pairs = np.stack([frames.pairs.first, frames.pairs.second], axis=-1)
        self._model = frames.model()
        self._one, self._two = frames.arrays()
        self._information: Array = np.asarray(np.linalg.inv(belief.prior.cov), dtype=np.float64)

    def explanations(self) -> list[Followed]:
        """Return the motions that explain the edges, with and without feet among them."""
        starts = self._belief.starts
        if len(self._pairs) == 0 or len(starts) == 0:
            return []
        standing = _distinct(self.refined(start) for start in starts)
        hanging = _distinct(self.refined(start, on_floor=False) for start in (standing[0].twist.mean, starts[0]))
        return standing + hanging

    def refined(self, start: Array, on_floor: bool = True, usable: NDArray[np.bool_] | None = None) -> Followed:
        """Return the motion found from the twist `start` (3,).

        on_floor: whether lower ends may be feet at all. usable: (P,) whether a pair is, by default all are.
        """
        from localiser.visual_odometry import twist_kernel as kernel

        pairs, prior = self._frames.pairs, self._belief.prior
        mean, cov, chosen, log_likelihood = kernel.refine(
            self._pairs,
            pairs.look,
            np.ones(len(self._pairs), dtype=np.bool_) if usable is None else usable,
            self._one,
            self._two,
            self._frames.mount,
            kernel.Belief(prior.mean, self._information, on_floor),
            start,
            _START_SIGMA**2,
            self._model,
        )
        if len(chosen) == 0:
            return self.nothing()
        group = self._groups(pairs.first[chosen])
        occam = prior.log_density(mean) + 0.5 * float(np.linalg.slogdet(2 * np.pi * cov)[1])
        share = self._belief.log_share + float(np.log(1.0 - _HANGING_SHARE if on_floor else _HANGING_SHARE))
        # Edges of one group are one piece of evidence, not many.
        evidence = float((log_likelihood / np.bincount(group)[group]).sum()) + occam + share
        return Followed(Gaussian(mean, cov), pairs.first[chosen], pairs.second[chosen], evidence, on_floor)

    def nothing(self) -> Followed:
        """Return what is believed when no edge can be followed."""
        none = np.zeros(0, dtype=np.int64)
        return Followed(self._belief.prior, none, none, self._belief.log_share, True)

    def fragility(self, followed: Followed) -> Array:
        """Return the covariance (3, 3) of what the twist changes by when one group of edges is left out."""
        first, second = self._pairs.T
        group = np.full(len(first), -1)
        for e, f, of_edge in zip(followed.first, followed.second, self._groups(followed.first), strict=True):
            group[(first == e) & (second == f)] = of_edge
        count = int(group.max(initial=-1)) + 1
        change = np.zeros((count, 3))
        for left_out in range(count):
            usable = (group >= 0) & (group != left_out)
            left = self.refined(followed.twist.mean, followed.has_feet, usable)
            change[left_out] = left.twist.mean - followed.twist.mean
        return np.asarray(change.T @ change) * max(count - 1, 1) / max(count, 1)

    def _groups(self, first: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return the group (M,) of each edge: those less than 3° from the next, as the sides of one thing."""
        bearing = self._frames.sights[0].bearing[first]
        order = np.argsort(bearing)
        group = np.empty(len(bearing), dtype=np.int64)
        group[order] = np.cumsum(np.diff(bearing[order], prepend=-np.inf) > _APART_RAD) - 1
        return group


def _distinct(followed: Iterable[Followed]) -> list[Followed]:
    """Return those that are not the same motion found once more, from another start; the best first."""
    kept: list[Followed] = []
    for new in sorted(followed, key=lambda new: -new.log_evidence):
        sigma = np.sqrt(np.diag(new.twist.cov))
        if all((np.abs(new.twist.mean - old.twist.mean) > 0.5 * sigma).any() for old in kept):
            kept.append(new)
    return kept


# -- votes -----------------------------------------------------------------------------------------------------------


def _kernels(step: float) -> Array:
    """Return what a vote of each of W widths gives to the bins at 0, 1, 2 … from it (W, R); 0 beyond its reach."""
    sigma = np.maximum(_WIDTHS_RAD, step)[:, None]
    apart = np.arange(int(_KERNEL_REACH * sigma.max() / step) + 1) * step / sigma
    return np.where(apart < _KERNEL_REACH, np.exp(-0.5 * apart**2) / sigma, 0.0)


def _peaks(votes: Array, turns: Array) -> list[tuple[int, int]]:
    """Return (row, column) of the highest votes, at turns at least twice the narrowest width apart."""
    best = votes.max(axis=0)
    found: list[tuple[int, int]] = []
    apart = 4 * _WIDTHS_RAD[0]
    while len(found) < _PEAKS and best.max() > 0:
        column = int(best.argmax())
        found.append((int(votes[:, column].argmax()), column))
        best = np.where(np.abs(turns - turns[column]) < apart, 0.0, best)
    return found


def votes_loop(
    offset_bearing: Array,
    inverse: Array,
    spread: Array,
    bearing: Array,
    look: Array,
    moves: Array,
    cell: Array,
    first_turn: float,
    turn_step: float,
    bins: int,
    widths: Array,
    kernels: Array,
    reaches: NDArray[np.int64],
) -> Array:
    """Return the votes (G, B) of P pairs for B turns under each of G moves (x, z of the camera).

    offset_bearing: change of bearing (P,) is that minus the first. kernels: (W, R) what a vote of each of W widths
    gives to its R next bins, of which `reaches` (W,) are not 0. cell: (2,) half of the distance between moves.
    """
    result = np.zeros((len(moves), bins))
    for p in range(len(look)):
        sin, cos = np.sin(bearing[p]), np.cos(bearing[p])
        by_cell = inverse[p] * np.sqrt((cos * cell[0]) ** 2 + (sin * cell[1]) ** 2) / 2.0
        for g in range(len(moves)):
            x, z = moves[g]
            expected = np.arctan2(sin - inverse[p] * x, cos + inverse[p] * z)
            parallax = spread[p] * (cos * x + sin * z)
            width = np.sqrt(parallax**2 + by_cell**2)
            kind = 0
            while kind < len(widths) - 1 and widths[kind] < width:
                kind += 1
            turn = offset_bearing[p] - expected
            turn -= 2.0 * np.pi * np.round(turn / (2.0 * np.pi))
            middle = int(np.round((turn - first_turn) / turn_step))
            reach = reaches[kind]
            for column in range(max(middle - reach + 1, 0), min(middle + reach, bins)):
                result[g, column] += look[p] * kernels[kind, abs(column - middle)]
    return result
