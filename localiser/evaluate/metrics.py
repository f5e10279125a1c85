"""The figures of one run as a plain dictionary: the content of `metrics.json`.

In addition to the errors of all images there are three groups: `seen_2s`, images with an edge at most 2 s ago;
`after_pause_10s`, images within 10 s after a pause of more than 3 s without edges; `steady`, those of the first group
that are not in the second. `pauses` lists each pause. `own_figures` has those that need no truth. Unknown figures are
null.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from localiser.evaluate.accuracy import Errors, Track, errors_against
from localiser.evaluate.bound import rms_position
from localiser.evaluate.consistency import fraction_inside
from localiser.evaluate.own_figures import found_index, own_figures
from localiser.evaluate.pauses import Pause, after_pauses, find_pauses, recovery_s, seen_recently
from localiser.filter import CORRECT_M, CORRECT_RAD, SURE
from localiser.geometry import Array, Trajectory

DECIMALS = 6
ABOUT = ("observation", "association", "odometry", "start", "map", "inputs", "particles", "seed")
"""What a run was made from, apart from its log: only runs that differ by nothing but the seed may be summed up."""


def metrics(
    track: Track,
    truth: Trajectory | None,
    *,
    log: str,
    about: Mapping[str, Any] | None = None,
    bound: Array | None = None,
    sighted: NDArray[np.bool_] | None = None,
    reasons: Sequence[str] = (),
    distance_scale: float = 0.0,
) -> dict[str, Any]:
    """Return the figures of a run; those that need the truth are None without it.

    about: what the run was made from; see `ABOUT`. bound: (T, 3, 3) posterior Cramér-Rao bound of the poses, for logs
    with true associations. sighted: (T,) whether a landmark was seen; by default, whether there was any edge (always,
    where edges are not known). reasons: (T,) why p_correct was low, "" where it was not. distance_scale: see
    `own_figures`. Raises InputError when truth and run share no time.
    """
    errors = errors_against(track, truth) if truth is not None else None
    return {
        "log": log,
        **{key: (about or {}).get(key) for key in ABOUT},
        "frames": len(track),
        **_position(errors),
        "heading_rmse_deg": _figure(np.degrees(rms(errors.heading_rad))) if errors else None,
        "odometry_position_rmse_m": _figure(rms(errors.odometry_m)) if errors else None,
        "nees_mean": _figure(mean(errors.nees)) if errors else None,
        "nees_inside_95": _figure(fraction_inside(errors.nees)) if errors else None,
        **_limit(errors, bound),
        "edges_per_frame": _figure(mean(track.edges)),
        **own_figures(track, distance_scale),
        "confidence": _confidence(track, errors, reasons),
        **_by_sightings(track, errors, track.sighted if sighted is None else sighted),
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


def _position(errors: Errors | None) -> dict[str, Any]:
    position = errors.position_m[np.isfinite(errors.position_m)] if errors else np.zeros(0)
    return {
        "position_rmse_m": _figure(rms(position)),
        "position_median_m": _figure(quantile(position, 0.5)),
        "position_max_m": _figure(quantile(position, 1.0)),
        "position_end_m": _figure(position[-1]) if len(position) else None,
    }


def _limit(errors: Errors | None, bound: Array | None) -> dict[str, Any]:
    if errors is None or bound is None:
        return {"pcrb_position_m": None, "efficiency": None}
    judged = np.isfinite(errors.position_m)
    limit = rms_position(bound[judged])
    return {"pcrb_position_m": _figure(limit), "efficiency": _figure(rms(errors.position_m) / limit)}


def _confidence(track: Track, errors: Errors | None, reasons: Sequence[str]) -> dict[str, Any]:
    """Return how sure the run was of its poses, and how rightly.

    `found_s`: from when on it was sure, and position_rmse_found_m the error from then on. `sure`: share of images with
    p_correct > 0.9, `sure_and_wrong`: with p_correct > 0.9 and not within 0.5 m and 10°.
    """
    sure = track.p_correct > SURE
    found = found_index(track)
    known, wrong = np.zeros(len(track), dtype=bool), np.zeros(len(track), dtype=bool)
    if errors is not None:
        known = np.isfinite(errors.position_m)
        wrong = (errors.position_m > CORRECT_M) | (np.abs(errors.heading_rad) > CORRECT_RAD)
    return {
        "p_correct_mean": _figure(mean(track.p_correct)),
        "p_correct_min": _figure(quantile(track.p_correct, 0.0)),
        "sure": _figure(sure.mean()) if np.isfinite(track.p_correct).any() else None,
        "correct": _figure(1.0 - wrong[known].mean()) if known.any() else None,
        "sure_and_wrong": _figure((sure & wrong)[known].mean()) if known.any() else None,
        "found_s": None if found is None else _figure(track.seconds[found]),
        "position_rmse_found_m": None if found is None or not errors else _figure(rms(errors.position_m[found:])),
        "reasons": {reason: int(count) for reason, count in sorted(Counter(reasons).items()) if reason},
    }


def _by_sightings(track: Track, errors: Errors | None, sighted: NDArray[np.bool_]) -> dict[str, Any]:
    pauses = find_pauses(track.t_ns, sighted)
    seen, after = seen_recently(track.t_ns, sighted), after_pauses(track.t_ns, pauses)
    groups = {"seen_2s": seen, "after_pause_10s": after, "steady": seen & ~after}
    ends_ns = [*(pause.start_ns for pause in pauses[1:]), None]
    return {
        **{name: _group(errors, chosen) for name, chosen in groups.items()},
        "pauses": [_pause(track, errors, *pause) for pause in zip(pauses, ends_ns, strict=False)],
    }


def _group(errors: Errors | None, chosen: NDArray[np.bool_]) -> dict[str, Any]:
    position = errors.position_m[chosen] if errors else np.zeros(0)
    return {
        "frames": int(chosen.sum()),
        "position_rmse_m": _figure(rms(position)),
        "position_median_m": _figure(quantile(position, 0.5)),
        "nees_mean": _figure(mean(errors.nees[chosen])) if errors else None,
    }


def _pause(track: Track, errors: Errors | None, pause: Pause, until_ns: int | None) -> dict[str, Any]:
    position = errors.position_m[after_pauses(track.t_ns, (pause,))] if errors else np.zeros(0)
    return {
        "start_s": _figure((pause.start_ns - track.t_ns[0]) / 1e9),
        "duration_s": _figure(pause.duration_s),
        "position_end_m": _figure(position[0]) if len(position) else None,
        "position_rmse_after_m": _figure(rms(position)),
        "recovery_s": _figure(recovery_s(track.t_ns, errors.position_m, pause, until_ns)) if errors else None,
    }


def _figure(value: float, decimals: int = DECIMALS) -> float | None:
    # JSON has no nan: null says that a figure is not known.
    return round(float(value), decimals) if np.isfinite(value) else None
