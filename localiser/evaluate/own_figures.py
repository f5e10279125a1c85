"""What a run knows of itself, without the truth: uncertainty, distance, matched edges, consistency of residuals."""

from __future__ import annotations

from typing import Any

import numpy as np

from localiser.evaluate.accuracy import Track
from localiser.evaluate.residuals import residual_figures
from localiser.filter import SURE
from localiser.geometry import Array

DECIMALS = 6


def own_figures(track: Track, distance_scale: float = 0.0) -> dict[str, Any]:
    """Return the figures of a run that need no truth; None where something is not known.

    distance_scale: the learnt error of the odometry's distances, see `fit_wheels`. The 3σ figures are of the images
    since the run was first sure of its pose, or of all where it never was: position_3sigma_m is three times
    `Track.position_sigma_m`. edges_matched: fraction of all edges that matched a landmark.
    """
    duration_s, distance_m = float(track.seconds[-1]), distance_m_of(track, distance_scale)
    since = found_index(track) or 0
    figures = {
        "duration_s": duration_s,
        "distance_m": distance_m,
        "speed_mean_m_s": distance_m / duration_s if duration_s > 0 else np.nan,
        "edges_matched": _fraction(track.matched, track.edges),
    }
    spreads = {
        "position_3sigma_{}_m": track.position_sigma_m,
        "heading_3sigma_{}_deg": np.degrees(track.heading_sigma_rad),
    }
    for name, sigma in spreads.items():
        known = 3 * sigma[since:][np.isfinite(sigma[since:])]
        figures[name.format("median")] = float(np.median(known)) if len(known) else np.nan
        figures[name.format("max")] = float(known.max()) if len(known) else np.nan
    rounded = {name: round(value, DECIMALS) if np.isfinite(value) else None for name, value in figures.items()}
    return rounded | {"residuals": residual_figures(track.residuals)}


def found_index(track: Track) -> int | None:
    """Return the first image at which the run was sure of its pose, None where it never was or that is not known."""
    sure = track.p_correct > SURE
    return int(np.argmax(sure)) if sure.any() else None


def distance_m_of(track: Track, distance_scale: float = 0.0) -> float:
    """Return the length of the path: by odometry, corrected by its learnt scale, or of the estimates without it.

    Estimates move a little in each image while the robot stands, and jump when it is found elsewhere.
    """
    if np.isfinite(track.odometry).all():
        return _length(track.odometry) * (1 + distance_scale)
    return _length(track.poses)


def _length(poses: Array) -> float:
    return float(np.hypot(*np.diff(poses[:, :2], axis=0).T).sum())


def _fraction(part: Array, whole: Array) -> float:
    known = np.isfinite(part) & np.isfinite(whole)
    total = whole[known].sum()
    return float(part[known].sum() / total) if total > 0 else float("nan")
