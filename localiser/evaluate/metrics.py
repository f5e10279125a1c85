"""The figures of one run as a plain dictionary: the content of `metrics.json`.

`pauses` lists each time of more than 3 s without edges. `own_figures` has those that need no truth. Unknown figures are
null. Figures are of the images since the robot was found, lost again or not; `confidence.not_found` is the share of the
others, which are left out. A stated start counts as found. Sigmas and NEES are of ordinary poses only
(`LocatedFrame.is_found`): while the robot is lost, the covariance says that it may be anywhere.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from localiser.evaluate.accuracy import Errors, Track, consistency, errors_against
from localiser.filter import CORRECT_M, CORRECT_RAD, SURE
from localiser.geometry import Array, Trajectory

# -- pauses without a sighting ----------------------------------------------------------------------------------------

PAUSE_LONGER_THAN_S = 3.0


@dataclass(frozen=True, slots=True)
class Pause:
    """No sighting between these two times: of the last sighting before and of the first after."""

    start_ns: int
    end_ns: int

    @property
    def duration_s(self) -> float:
        """Length of the pause."""
        return (self.end_ns - self.start_ns) / 1e9


def find_pauses(t_ns: NDArray[np.int64], sighted: NDArray[np.bool_]) -> tuple[Pause, ...]:
    """Return the pauses longer than `PAUSE_LONGER_THAN_S`, from image times (T,) and whether edges were seen (T,).

    A run that begins blind begins with a pause; blindness that lasts until the end is none, for nothing comes after.
    """
    times = np.concatenate([t_ns[:1], t_ns[sighted]])
    long = np.flatnonzero(np.diff(times) > PAUSE_LONGER_THAN_S * 1e9)
    return tuple(Pause(int(times[i]), int(times[i + 1])) for i in long)


# -- what a run knows of itself ---------------------------------------------------------------------------------------

DECIMALS = 6


def own_figures(track: Track, distance_scale: float = 0.0) -> dict[str, Any]:
    """Return the figures of a run that need no truth; None where something is not known.

    distance_scale: the learnt error of the odometry's distances. Distance and speed are of the whole
    drive. position_3sigma_m: three times `Track.position_sigma_m`. edges_matched: fraction of edges that matched a
    landmark.
    """
    # By odometry: estimates move a little in each image while the robot stands, and jump when it is found elsewhere.
    by_odometry = bool(np.isfinite(track.odometry).all())
    driven, scale = (track.driven, 1 + distance_scale) if by_odometry else (track.poses, 1.0)
    duration_s = float(track.seconds[-1])
    distance_m = scale * float(np.hypot(*np.diff(driven[:, :2], axis=0).T).sum())
    found = track.since_found
    counted = found & np.isfinite(track.matched) & np.isfinite(track.edges)
    edges = track.edges[counted].sum()
    figures = {
        "duration_s": duration_s,
        "distance_m": distance_m,
        "speed_mean_m_s": distance_m / duration_s if duration_s > 0 else np.nan,
        "edges_matched": track.matched[counted].sum() / edges if edges > 0 else np.nan,
    }
    spreads = {
        "position_3sigma_{}_m": track.position_sigma_m,
        "heading_3sigma_{}_deg": np.degrees(track.heading_sigma_rad),
    }
    for name, sigma in spreads.items():
        known = 3 * sigma[track.found & np.isfinite(sigma)]
        figures[name.format("median")] = float(np.median(known)) if len(known) else np.nan
        figures[name.format("max")] = float(known.max()) if len(known) else np.nan
    residuals = track.residuals[found & np.isfinite(track.residuals).all(axis=1)]
    over = consistency(residuals.sum(axis=0, keepdims=True))[0] if len(residuals) else np.nan
    return {name: _figure(value) for name, value in figures.items()} | {"residuals": {"consistency": _figure(over)}}


# -- all figures ------------------------------------------------------------------------------------------------------

ABOUT = ("observation", "association", "odometry", "start", "map", "inputs", "particles", "seed")
"""What a run was made from, apart from its log: only runs that differ by nothing but the seed may be summed up."""


def metrics(
    track: Track,
    truth: Trajectory | None,
    *,
    log: str,
    about: Mapping[str, Any] | None = None,
    sighted: NDArray[np.bool_] | None = None,
    reasons: Sequence[str] = (),
    distance_scale: float = 0.0,
) -> dict[str, Any]:
    """Return the figures of a run; those that need the truth are None without it.

    about: what the run was made from; see `ABOUT`. sighted: (T,) whether a landmark was seen; by default, whether there
    was any edge (always, where edges are not known). reasons: (T,) why p_correct was low, "" where it was not.
    distance_scale: see `own_figures`. Raises InputError when truth and run share no time.
    """
    errors = errors_against(track, truth) if truth is not None else None
    position = errors.position_m[np.isfinite(errors.position_m)] if errors else np.zeros(0)
    return {
        "log": log,
        **{key: (about or {}).get(key) for key in ABOUT},
        "frames": len(track),
        "position_rmse_m": _figure(rms(position)),
        "position_median_m": _figure(quantile(position, 0.5)),
        "position_max_m": _figure(quantile(position, 1.0)),
        "position_end_m": _figure(position[-1]) if len(position) else None,
        "heading_rmse_deg": _figure(np.degrees(rms(errors.heading_rad))) if errors else None,
        "odometry_position_rmse_m": _figure(rms(errors.odometry_m)) if errors else None,
        "nees_mean": _figure(mean(errors.nees)) if errors else None,
        "edges_per_frame": _figure(mean(track.edges)),
        **own_figures(track, distance_scale),
        "confidence": _confidence(track, errors, reasons),
        "pauses": [
            {"start_s": _figure((pause.start_ns - track.t_ns[0]) / 1e9), "duration_s": _figure(pause.duration_s)}
            for pause in find_pauses(track.t_ns, track.sighted if sighted is None else sighted)
        ],
    }


def timing_metrics(stage_ms: Mapping[str, ArrayLike]) -> dict[str, Any]:
    """Return the median and 95th percentile of the time of a frame, and each stage's median, from times (T,) in ms."""
    stages = {name: np.asarray(times, dtype=np.float64) for name, times in stage_ms.items()}
    frame = np.sum(list(stages.values()), axis=0) if stages else np.zeros(0)
    return {
        "frame_ms_median": _figure(quantile(frame, 0.5), 3),
        "frame_ms_p95": _figure(quantile(frame, 0.95), 3),
        "stage_ms": {name: _figure(quantile(times, 0.5), 3) for name, times in stages.items()},
    }


# -- means that leave out what is not known, and are nan when nothing is ----------------------------------------------


def rms(values: Array) -> float:
    """Return the root of the mean square of the finite values."""
    return float(np.sqrt(mean(np.square(values))))


def mean(values: Array) -> float:
    """Return the mean of the finite values."""
    values = values[np.isfinite(values)]
    return float(values.mean()) if len(values) else float("nan")


def quantile(values: Array, level: float) -> float:
    """Return the quantile of the finite values, level 0 … 1."""
    values = values[np.isfinite(values)]
    return float(np.quantile(values, level)) if len(values) else float("nan")


# -- groups of figures ----------------------------------------------------------------------------------------------


def _confidence(track: Track, errors: Errors | None, reasons: Sequence[str]) -> dict[str, Any]:
    """Return how sure the run was of its poses, and how rightly.

    `found_s`: when the robot was found, 0 for a stated start; `not_found`: share of the images that are left out of the
    figures. `sure`: share of all images with p_correct > 0.9. `sure_and_wrong`: share of the images that are not left
    out with p_correct > 0.9 and not within 0.5 m and 10°; `correct`: of those within.
    """
    sure = track.p_correct > SURE
    known, wrong = np.zeros(len(track), dtype=bool), np.zeros(len(track), dtype=bool)
    if errors is not None:
        known = np.isfinite(errors.position_m)
        wrong = (errors.position_m > CORRECT_M) | (np.abs(errors.heading_rad) > CORRECT_RAD)
    told, found = np.isfinite(track.p_correct).any(), track.first_found
    return {
        "sure": _figure(sure.mean()) if told else None,
        "correct": _figure(1.0 - wrong[known].mean()) if known.any() else None,
        "sure_and_wrong": _figure((sure & wrong)[known].mean()) if known.any() else None,
        "found_s": _figure(track.seconds[found]) if told and found is not None else None,
        "not_found": _figure(1.0 - track.since_found.mean()) if told else None,
        "reasons": {reason: int(count) for reason, count in sorted(Counter(reasons).items()) if reason},
    }


def _figure(value: float, decimals: int = DECIMALS) -> float | None:
    # JSON has no nan: null says that a figure is not known.
    return round(float(value), decimals) if np.isfinite(value) else None
