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
from localiser.landmarks import field_of_view_rad
from localiser.visual_odometry import pairs as pairing
from localiser.visual_odometry.pairs import Pairs, candidates
from localiser.visual_odometry.search import likely_motions
from localiser.visual_odometry.sights import FOOT_UNEVEN_SIGMA_M, Sights, errs_apart, with_errors_apart
from localiser.visual_odometry.twist import Gaussian, at_least, mixture, motion_gaussian

if TYPE_CHECKING:
    from localiser.visual_odometry import twist_kernel as kernel

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
    first, second: (M,) indices of the edges that were followed. weight: (M,) how surely they are the same, 0 … 1.
    on_floor: (M,) how surely their lower end is where they meet the floor.
    log_evidence: of how well the frames are explained, by Laplace's approximation.
    has_feet: whether any lower end was taken for a foot.
    """

    twist: Gaussian
    first: NDArray[np.int64]
    second: NDArray[np.int64]
    weight: Array
    on_floor: Array
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

        followed = pairing.FOLLOWED_SHARE / max(len(self.sights[0].bearing), 1)
        return kernel.Model(
            pairing.HUNG_SHARE,
            pairing.NEIGHBOUR_SHARE,
            pairing.NEIGHBOUR_SIGMA_RAD,
            pairing.TYPICAL_INVERSE_RANGE,
            pairing.TYPICAL_SPREAD,
            FOOT_UNEVEN_SIGMA_M / self.camera.mount.height_m,
            (1.0 - pairing.FOLLOWED_SHARE) / followed / field_of_view_rad(self.camera),
            *pairing.FLOOR_SHARES,
        )

    def arrays(self) -> tuple[kernel.Frame, kernel.Frame]:
        """Return both frames as the compiled loops take them."""
        from localiser.visual_odometry import twist_kernel as kernel

        one, two = (kernel.Frame(sight.measured, sight.sigma, sight.common) for sight in self.sights)
        return one, two

    def likely_motions(self, prior: Gaussian) -> list[Array]:
        """Return the twists (3,) that most pairs agree on, among those that the prior allows."""
        return likely_motions(self.pairs, self.sights, self.mount, prior.mean, prior.cov, _PEAKS)


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


def groups(bearing: Array) -> NDArray[np.int64]:
    """Return the group (M,) of each edge: those less than a few degrees from the next, as the sides of one thing."""
    order = np.argsort(bearing)
    group = np.empty(len(bearing), dtype=np.int64)
    group[order] = np.cumsum(np.diff(bearing[order], prepend=-np.inf) > _APART_RAD) - 1
    return group


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
        mean, cov, chosen, weight, floor, log_likelihood = kernel.refine(
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
        return Followed(
            Gaussian(mean, cov), pairs.first[chosen], pairs.second[chosen], weight, floor, evidence, on_floor
        )

    def nothing(self) -> Followed:
        """Return what is believed when no edge can be followed."""
        none, empty = np.zeros(0, dtype=np.int64), np.zeros(0)
        return Followed(self._belief.prior, none, none, empty, empty, self._belief.log_share, True)

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
        return groups(self._frames.sights[0].bearing[first])


def _distinct(followed: Iterable[Followed]) -> list[Followed]:
    """Return those that are not the same motion found once more, from another start; the best first."""
    kept: list[Followed] = []
    for new in sorted(followed, key=lambda new: -new.log_evidence):
        sigma = np.sqrt(np.diag(new.twist.cov))
        if all((np.abs(new.twist.mean - old.twist.mean) > 0.5 * sigma).any() for old in kept):
            kept.append(new)
    return kept
