"""Check what a saved state holds: numbers that can be true, and arrays that belong together."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np

from localiser.edges import Edges
from localiser.filter import Odometry
from localiser.geometry import Increment
from localiser.observation import NearLandmarks, Visibility
from localiser.particles import Particles

_LARGEST = 1e12  # metres, radians, pixels, weights, and squares of what a file may state
_LATEST_NS = 2**62


def require_sound(value: Any) -> None:
    """Raise ValueError, with what was expected, where a part of a state cannot have been saved by a run.

    nan and infinity may be: they stand for what is not known, and for a weight of nothing.
    """
    if type(value) in _FITTING:
        _FITTING[type(value)](value)
    if isinstance(value, np.ndarray) and value.dtype.kind == "f":
        if (np.abs(value[np.isfinite(value)]) > _LARGEST).any():
            raise ValueError(f"expected numbers within ±{_LARGEST:g}, found another")
    elif isinstance(value, float) and np.isfinite(value) and abs(value) > _LARGEST:
        raise ValueError(f"expected a number within ±{_LARGEST:g}, found {value}")
    elif isinstance(value, int) and abs(value) > _LATEST_NS:
        raise ValueError(f"expected an integer within ±{_LATEST_NS}, found {value}")
    for part in _parts(value):
        require_sound(part)


def _parts(value: Any) -> Iterator[Any]:
    if is_dataclass(value) and not isinstance(value, type):
        yield from (getattr(value, field.name) for field in fields(value))
    elif isinstance(value, (tuple, list, deque)):
        yield from value
    elif isinstance(value, dict):
        yield from value.values()


def _particles(value: Particles) -> None:
    columns, errors = (len(value.names), len(value.log_weight)), len(value.names) - 3
    fits = value.columns.shape == columns and value.constant_error_cov.shape == (errors, errors)
    if not fits or not columns[1] or not np.isfinite(value.columns).all():
        raise ValueError(f"expected particles of {columns} finite numbers, found {value.columns.shape} or others")
    if not np.isfinite(value.log_weight.max()):
        raise ValueError("expected particles of some weight, found none")


def _edges(value: Edges) -> None:
    count, common = len(value.bearing), value.common
    parts = [getattr(value, field.name) for field in fields(value) if field.name != "rejected_px"]
    fits = all(len(part) == count for part in parts if isinstance(part, np.ndarray))
    fits &= value.ends_px.shape == (count, 2, 2) and value.profile.ndim == 2
    terms = len(common.names)
    fits &= common.cov.shape == (terms, terms)
    fits &= common.bearing_from_lean.shape == common.bearing_from_line.shape == (count, terms)
    if not fits:
        raise ValueError(f"expected columns of {count} edges, found others")


def _increment(value: Increment) -> None:
    if value.mean.shape != (3,) or value.cov.shape != (3, 3) or value.by_delay.shape != (3,):
        raise ValueError("expected a motion of three numbers and its covariance, found another")
    if not all(number >= 0 for number in (value.path_m, value.turned_rad, *np.diag(value.cov))):
        raise ValueError("expected a path, a turn and variances of 0 or more, found others")


def _visibility(value: Visibility) -> None:
    landmark, probability = value.landmark, value.probability
    if landmark.ndim != 1 or landmark.dtype.kind != "i" or landmark.shape != probability.shape:
        raise ValueError("expected a probability for each landmark, found others")
    if not (np.diff(landmark, prepend=-1) > 0).all() or not ((probability > 0) & (probability < 1)).all():
        raise ValueError("expected ascending landmarks and probabilities between 0 and 1, found others")


def _near_landmarks(value: NearLandmarks) -> None:
    landmark, scenes, matched = value.landmark, value.scenes, value.matched
    if landmark.ndim != 1 or landmark.dtype.kind != "i" or not landmark.shape == scenes.shape == matched.shape:
        raise ValueError("expected two numbers of scenes for each near landmark, found others")
    fits = np.isfinite(scenes) & (scenes > 0) & (matched >= 0) & (matched <= scenes)
    if not (np.diff(landmark, prepend=-1) > 0).all() or not fits.all():
        raise ValueError("expected ascending landmarks, tested in at least as many scenes as matched, found others")
    if not -_LARGEST <= value.before <= 0.0:
        raise ValueError(f"expected log-odds of at most 0 from the places before, found {value.before}")


def _odometry(value: Odometry) -> None:
    if value.pose.shape != (3,) or not np.isfinite(value.pose).all():
        raise ValueError("expected a pose of three finite numbers, found another")


_FITTING: dict[type, Callable[[Any], None]] = {
    Particles: _particles,
    Edges: _edges,
    Increment: _increment,
    Visibility: _visibility,
    NearLandmarks: _near_landmarks,
    Odometry: _odometry,
}
"""What raises ValueError where the parts of a value of this type do not fit each other."""
