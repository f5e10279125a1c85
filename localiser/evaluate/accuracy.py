"""Errors of an estimated track against the truth at every image. Nothing is aligned: the map fixes the frame."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from localiser.errors import InputError
from localiser.evaluate.consistency import nees
from localiser.geometry import Array, Trajectory, between, compose, wrap_angle


@dataclass(frozen=True, slots=True, eq=False)
class Track:
    """What a run says at each of its T images; nan where something is not known (a TUM file knows poses only).

    t_ns: (T,) strictly increasing. poses: (T, 3) x, z, heading in the map. covs: (T, 3, 3) of the poses.
    odometry: (T, 3) poses in the odometry's own frame. edges, matched: (T,) number of edges measured, and of those
    that were matched with a landmark. p_correct: (T,) probability of being within 0.5 m and 10°, as the filter has it.
    residuals: (T, 3) how far matched edges are from their landmarks, see `residual_sums`.
    """

    t_ns: NDArray[np.int64]
    poses: Array
    covs: Array
    odometry: Array
    edges: Array
    matched: Array
    p_correct: Array
    residuals: Array

    def __len__(self) -> int:
        return len(self.t_ns)

    @classmethod
    def from_poses(
        cls,
        t_ns: ArrayLike,
        poses: ArrayLike,
        *,
        covs: ArrayLike | None = None,
        odometry: ArrayLike | None = None,
        edges: ArrayLike | None = None,
        matched: ArrayLike | None = None,
        p_correct: ArrayLike | None = None,
        residuals: ArrayLike | None = None,
    ) -> Track:
        """Return a track with what is given; the rest is unknown."""
        count = len(np.asarray(t_ns))

        def column(given: ArrayLike | None, *shape: int) -> Array:
            return np.full((count, *shape), np.nan) if given is None else np.asarray(given, dtype=np.float64)

        return cls(
            np.asarray(t_ns, dtype=np.int64),
            np.asarray(poses, dtype=np.float64).reshape(count, 3),
            column(covs, 3, 3),
            column(odometry, 3),
            column(edges),
            column(matched),
            column(p_correct),
            column(residuals, 3),
        )

    @property
    def seconds(self) -> Array:
        """Time (T,) s since the first image."""
        return np.asarray((self.t_ns - self.t_ns[:1]) / 1e9)

    @property
    def sighted(self) -> NDArray[np.bool_]:
        """Whether (T,) any edge was measured; true where that is not known."""
        return np.asarray(self.edges != 0)

    @property
    def position_sigma_m(self) -> Array:
        """Square root of the trace of the position's covariance (T,): the RMS distance the filter expects to be off."""
        return np.asarray(np.sqrt(np.trace(self.covs[:, :2, :2], axis1=1, axis2=2)))

    @property
    def heading_sigma_rad(self) -> Array:
        """Standard deviation of the heading (T,)."""
        return np.asarray(np.sqrt(self.covs[:, 2, 2]))


@dataclass(frozen=True, slots=True, eq=False)
class Errors:
    """Errors at each of T images; nan where the truth is not known.

    truth: (T, 3) true poses. position_m: (T,) distance. heading_rad: (T,) estimate - truth, wrapped.
    nees: (T,) normalised estimation error squared of x, z and heading. odometry: (T, 3) where odometry alone would
    have led from the first true pose. odometry_m: (T,) its distance from the truth.
    """

    truth: Array
    position_m: Array
    heading_rad: Array
    nees: Array
    odometry: Array
    odometry_m: Array


def errors_against(track: Track, truth: Trajectory) -> Errors:
    """Return the errors of `track` against the truth, interpolated along the arc at every image time.

    Images outside the time of the truth have no error (nan). Raises InputError when there is no other image.
    """
    known = np.array([truth.covers(int(t)) for t in track.t_ns], dtype=bool)
    if not known.any():
        during, found = _span(track.t_ns), _span(truth.t_ns)
        problem = f"expected truth during the run ({during}), found {found}: no image in common"
        raise InputError(problem, field="groundtruth")
    true_poses = np.where(known[:, None], truth.sampled(track.t_ns).poses, np.nan)
    error = track.poses - true_poses
    error[:, 2] = wrap_angle(error[:, 2])
    first = int(np.argmax(known))
    odometry = dead_reckoning(track.odometry[first:], true_poses[first])
    odometry = np.concatenate([np.full((first, 3), np.nan), odometry])
    return Errors(
        truth=true_poses,
        position_m=np.hypot(error[:, 0], error[:, 1]),
        heading_rad=error[:, 2],
        nees=nees(error, track.covs),
        odometry=odometry,
        odometry_m=np.hypot(*(odometry - true_poses)[:, :2].T),
    )


def dead_reckoning(odometry: Array, start: Array) -> Array:
    """Return the poses (T, 3) that the motion of `odometry` (T, 3), in its own frame, reaches from `start` (3,)."""
    return compose(start, between(odometry[0], odometry))


def _span(t_ns: NDArray[np.int64]) -> str:
    return f"{t_ns[0] / 1e9:.3f} s to {t_ns[-1] / 1e9:.3f} s" if len(t_ns) else "no time at all"
