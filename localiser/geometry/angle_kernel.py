"""Cosine, sine and arctangent in loops, compiled by numba when this module is imported and its loop is first called."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from localiser.geometry.compiled import entry, inlined

_QUARTER = np.pi / 2
_QUARTER_REST = 6.123233995736766e-17  # what a float64 leaves of π/2


@inlined
def cos_sin_near(quarter: float, d: float) -> tuple[float, float]:
    """Return cosine and sine of quarter · π/2 + d, |d| at most an eighth of a turn: series to the last digits."""
    q = d * d
    odd = 1 + q / -110 * (1 + q / -156 * (1 + q / -210))
    odd = d * (1 + q / -6 * (1 + q / -20 * (1 + q / -42 * (1 + q / -72 * odd))))
    even = 1 + q / -90 * (1 + q / -132 * (1 + q / -182 * (1 + q / -240)))
    even = 1 + q / -2 * (1 + q / -12 * (1 + q / -30 * (1 + q / -56 * even)))
    quarter -= 4 * np.floor(quarter / 4)
    crossed = (quarter == 1) | (quarter == 3)
    sin, cos = (even if crossed else odd), (odd if crossed else even)
    cos = -cos if (quarter == 1) | (quarter == 2) else cos
    sin = -sin if quarter >= 2 else sin
    return cos, sin


@inlined
def arctan(u: float) -> float:
    """Return the arctangent of u, 0 … 1, to 2e-8 [Abramowitz, Stegun 1964, 4.4.49].

    The series is added up by halves, which do not wait for each other.
    """
    v = u * u
    v2 = v * v
    low_half = (1 - 0.3333314528 * v) + v2 * (0.1999355085 - 0.1420889944 * v)
    high_half = (0.1065626393 - 0.0752896400 * v) + v2 * (0.0429096138 - 0.0161657367 * v + 0.0028662257 * v2)
    return u * (low_half + v2 * v2 * high_half)


@entry
def cos_sin_of(angle: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return cosine and sine (2, N) of angles (N,) of a few turns at most."""
    result = np.empty((2, len(angle)))
    for n in range(len(angle)):
        quarter = np.floor(angle[n] / _QUARTER + 0.5)
        d = angle[n] - quarter * _QUARTER - quarter * _QUARTER_REST
        result[0, n], result[1, n] = cos_sin_near(quarter, d)
    return result
