"""Check what a saved state holds: numbers that can be true, and arrays that belong together."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np

from localiser.edges import Edges
from localiser.filter import Odometry
from localiser.geometry import Increment
from localiser.particles import Particles

_LARGEST = 1e12  # metres, radians, pixels, weights, and squares of what a file may state
_LATEST_NS = 2**62


def require_sound(value: Any) -> None:
    """Raise ValueError, with what was expected, where a part of a state cannot have been saved by a run.

    nan and infinity may be: they stand for what is not known, and for a weight of nothing.
    """
    if is_dataclass(value) and not isinstance(value, type):
        _require_fitting(value)
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


def _require_fitting(value: Any) -> None:
    match value:
        case Particles():
            columns, errors = (len(value.names), len(value.log_weight)), len(value.names) - 3
            fits = value.columns.shape == columns and value.constant_error_cov.shape == (errors, errors)
            if not fits or not columns[1] or not np.isfinite(value.columns).all():
                raise ValueError(
                    f"expected particles of {columns} finite numbers, found {value.columns.shape} or others"
                )
            if not np.isfinite(value.log_weight.max()):
                raise ValueError("expected particles of some weight, found none")
        case Edges():
            count, terms = len(value.bearing), len(value.common.names)
            parts = [getattr(value, field.name) for field in fields(value) if field.name != "rejected_px"]
            common = value.common
            fits = all(len(part) == count for part in parts if isinstance(part, np.ndarray))
            fits &= value.ends_px.shape == (count, 2, 2)
            fits &= common.cov.shape == (terms, terms) and common.bearing_from_lean.shape == (count, terms)
            if not fits or common.bearing_from_line.shape != (count, terms) or value.profile.ndim != 2:
                raise ValueError(f"expected columns of {count} edges, found others")
        case Increment():
            if value.mean.shape != (3,) or value.cov.shape != (3, 3) or value.by_delay.shape != (3,):
                raise ValueError("expected a motion of three numbers and its covariance, found another")
            if not all(number >= 0 for number in (value.path_m, value.turned_rad, *np.diag(value.cov))):
                raise ValueError("expected a path, a turn and variances of 0 or more, found others")
        case Odometry():
            if value.pose.shape != (3,) or not np.isfinite(value.pose).all():
                raise ValueError("expected a pose of three finite numbers, found another")
