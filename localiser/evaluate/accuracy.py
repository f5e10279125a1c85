"""Errors of an estimated track against the truth at every image, and whether they are as large as the filter says.

Nothing is aligned: the map fixes the frame. Consistency is told by the normalised estimation error squared, NEES
[Bar-Shalom, Li, Kirubarajan 2001, section 5.4.2], and without a truth by the residuals of matched edges.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from localiser.errors import InputError
from localiser.filter import LEAST_SURE, SURE
from localiser.geometry import Array, Trajectory, between, bridged, compose, wrap_angle
from localiser.observation import Matches

# -- consistency ------------------------------------------------------------------------------------------------------


def nees(error: Array, cov: Array) -> Array:
    """Return eᵀ P⁻¹ e (T,) of errors (T, D), angles wrapped, under covariances (T, D, D).

    About D when the filter is consistent, more when it is overconfident. nan where the error is not known or the
    covariance is not positive definite: a start that is known exactly, or particles that have become one.
    """
    result = np.full(len(error), np.nan)
    known = np.isfinite(error).all(axis=-1) & np.isfinite(cov).all(axis=(-2, -1))
    variance, axes = np.linalg.eigh(cov[known])
    # Positive definite beyond rounding: a collapsed direction would make the figure a matter of the last bit.
    sound = variance[:, 0] > 1e-12 * variance[:, -1]
    across = np.einsum("tij,ti->tj", axes[sound], error[known][sound])
    result[np.flatnonzero(known)[sound]] = (across**2 / variance[sound]).sum(axis=-1)
    return result


# -- errors against the truth -----------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, eq=False)
class Track:
    """What a run says at each of its T images; nan where something is not known (a TUM file knows poses only).

    t_ns: (T,) strictly increasing. poses: (T, 3) x, z, heading in the map. covs: (T, 3, 3) of the poses.
    odometry: (T, 3) poses in the odometry's own frame. edges, matched: (T,) number of edges measured, and of those
    that were matched with a landmark. p_correct: (T,) probability of being within 0.5 m and 10°, as the filter has it.
    residuals: (T, 3) how far matched edges are from their landmarks, see `residual_sums`. found: (T,) whether the pose
    is an ordinary one, see `LocatedFrame.is_found`; true where that is not known.
    """

    t_ns: NDArray[np.int64]
    poses: Array
    covs: Array
    odometry: Array
    edges: Array
    matched: Array
    p_correct: Array
    residuals: Array
    found: NDArray[np.bool_]

    def __len__(self) -> int:
        return len(self.t_ns)

    @classmethod
    def from_poses(cls, t_ns: ArrayLike, poses: ArrayLike, **known: ArrayLike) -> Track:
        """Return a track with what is known by the names of its columns."""
        count = len(np.asarray(t_ns))
        shapes = {"covs": (3, 3), "odometry": (3,), "edges": (), "matched": (), "p_correct": (), "residuals": (3,)}
        columns: dict[str, Any] = {name: np.full((count, *shape), np.nan) for name, shape in shapes.items()}
        columns |= {name: np.asarray(given, dtype=np.float64) for name, given in known.items()}
        columns["found"] = np.asarray(known.get("found", np.ones(count)), dtype=bool)
        times, at = np.asarray(t_ns, dtype=np.int64), np.asarray(poses, dtype=np.float64).reshape(count, 3)
        return cls(times, at, **columns)

    @property
    def seconds(self) -> Array:
        """Time (T,) s since the first image."""
        return np.asarray((self.t_ns - self.t_ns[:1]) / 1e9)

    @property
    def first_found(self) -> int | None:
        """The first image with an ordinary pose, None where there is none."""
        return int(np.argmax(self.found)) if self.found.any() else None

    @property
    def since_found(self) -> NDArray[np.bool_]:
        """Whether (T,) the robot was found by then, even if it was lost again."""
        return np.logical_or.accumulate(self.found)

    @property
    def driven(self) -> Array:
        """Poses (T, 3) of the odometry, without the jumps of a base that restarted; see `geometry.bridged`."""
        if not np.isfinite(self.odometry).all():
            return self.odometry
        return bridged(Trajectory(self.t_ns, self.odometry))[0].poses

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
    nees: (T,) normalised estimation error squared of x, z and heading, of ordinary poses. odometry: (T, 3) where
    odometry alone would have led from the true pose where the robot was found first. odometry_m: (T,) its distance from
    the truth.
    """

    truth: Array
    position_m: Array
    heading_rad: Array
    nees: Array
    odometry: Array
    odometry_m: Array


def errors_against(track: Track, truth: Trajectory) -> Errors:
    """Return the errors of `track` against the truth, interpolated along the arc at every image time.

    Images outside the time of the truth have no error (nan), nor have those before the robot was found. Raises
    InputError when the truth has no image's time.
    """
    known = np.array([truth.covers(int(t)) for t in track.t_ns], dtype=bool)
    if not known.any():
        during, found = _span(track.t_ns), _span(truth.t_ns)
        problem = f"expected truth during the run ({during}), found {found}: no image in common"
        raise InputError(problem, field="groundtruth")
    true_poses = np.where(known[:, None], truth.sampled(track.t_ns).poses, np.nan)
    error = track.poses - true_poses
    error[:, 2] = wrap_angle(error[:, 2])
    judged = known & track.since_found
    error[~judged] = np.nan
    first = int(np.argmax(judged if judged.any() else known))
    odometry = dead_reckoning(track.driven[first:], true_poses[first])
    odometry = np.concatenate([np.full((first, 3), np.nan), odometry])
    return Errors(
        truth=true_poses,
        position_m=np.hypot(error[:, 0], error[:, 1]),
        heading_rad=error[:, 2],
        nees=np.where(track.found, nees(error, track.covs), np.nan),
        odometry=odometry,
        odometry_m=np.hypot(*(odometry - true_poses)[:, :2].T),
    )


def found_images(p_correct: Array, *, is_found: bool) -> NDArray[np.bool_]:
    """Return which images (T,) have an ordinary pose, by p_correct (T,); see `LocatedFrame.is_found`.

    is_found: whether the start was stated.
    """
    found = []
    for probability in p_correct:
        is_found = (is_found or bool(probability > SURE)) and not probability < LEAST_SURE
        found.append(is_found)
    return np.array(found, dtype=bool)


def dead_reckoning(odometry: Array, start: Array) -> Array:
    """Return the poses (T, 3) that the motion of `odometry` (T, 3), in its own frame, reaches from `start` (3,)."""
    return compose(start, between(odometry[0], odometry))


def _span(t_ns: NDArray[np.int64]) -> str:
    return f"{t_ns[0] / 1e9:.3f} s to {t_ns[-1] / 1e9:.3f} s" if len(t_ns) else "no time at all"


# -- residuals --------------------------------------------------------------------------------------------------------

_LARGEST_GATE, _SMALLEST_GATE = 40.0, 1e-2  # beyond the one nothing is cut off; below the other rounding prevails


def residual_sums(matches: Matches) -> Array:
    """Return Σ z², its expectation and its variance (3,) over the matched edges of one image.

    nan where nothing is matched.
    """
    residual, sigma, gate = matches.residual, matches.sigma, matches.gate
    known = np.isfinite(residual) & (sigma > 0) & (gate > 0)
    if not known.any():
        return np.full(3, np.nan)
    from scipy.special import erf

    # Mean and variance of z², z standard normal and cut off at ±g.
    g = np.clip(gate[known], _SMALLEST_GATE, _LARGEST_GATE)
    ratio = 2 * np.exp(-0.5 * g**2) / np.sqrt(2 * np.pi) / erf(g / np.sqrt(2))
    mean = 1 - g * ratio
    variance = np.maximum(3 - (g**3 + 3 * g) * ratio - mean**2, 0.0)
    return np.array([np.square(residual[known] / sigma[known]).sum(), mean.sum(), variance.sum()])


def consistency(sums: Array) -> Array:
    """Return Σ z² / Σ E[z²] (T,) of images, from `residual_sums` (T, 3)."""
    return np.asarray(sums[:, 0] / sums[:, 1])


def consistency_band(sums: Array) -> tuple[Array, Array]:
    """Return the band (T,), (T,) that the consistency of an image lies in with 95 % probability, errors independent.

    The sum is taken as a gamma variable of its mean and variance, which it is exactly, a χ², where nothing is cut off.
    """
    from scipy.special import gammaincinv

    shape = sums[:, 1] ** 2 / sums[:, 2]
    low, high = (gammaincinv(shape, tail) / shape for tail in (0.025, 0.975))
    return np.asarray(low), np.asarray(high)
