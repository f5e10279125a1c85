"""The loop of `scene_clutter`, compiled by numba when this module is imported and its function is first called."""

from __future__ import annotations

import numpy as np

from localiser.geometry import Array
from localiser.geometry.compiled import compiled, part

# Columns of edges: bearing, its variance, cosine and sine, and the angle at which a density per rad is that of evenly
# spread clutter; of both ends the upright image height, its slope, the room that clutter has, whether the border made
# it; and 1 / length.
_BEARING, _VAR, _COS, _SIN, _SPAN, _E, _SLOPE, _ROOM, _CUT, _PER_LENGTH = 0, 1, 2, 3, 4, 5, 7, 9, 11, 13


@part
def _normal(error: float, variance: float) -> float:
    """Return the normal density, 0 where something is not known."""
    density = np.exp(-0.5 * error * error / variance) / np.sqrt(2 * np.pi * variance)
    return density if np.isfinite(density) else 0.0


@compiled
def continued(
    now: Array, then: Array, motion: Array, turn_var: float, mount: Array, end_var: float, near_m: float, short: float
) -> Array:
    """Return K (E, B), how dense edges (E, 14) are that continue earlier ones (B, 14), relative to an even density.

    motion: (3,) of the camera since, in its own frame then; turn_var: variance of its turn. mount: (3,) sine and cosine
    of the camera's tilt now, and by how much it was higher before, over `near_m`. end_var: variance of an end's height;
    infinite where nothing is known of ends. near_m: things are farther away. short: how often an end is not where the
    same edge ended before.

    The camera comes nearer to an edge by `approach` of the nearest distance. An end at upright height e of a thing at
    distance D has the slope t = (e c - s) / (c + e s), which grows by t · approach / D. A camera that was mounted
    higher by h sees it lower by h / D.
    """
    result = np.zeros((len(now), len(then)))
    right, back, turn = motion[0], motion[1], motion[2]
    s, c, rise = mount[0], mount[1], mount[2]
    for j in range(len(then)):
        across = (right * then[j, _COS] + back * then[j, _SIN]) / near_m
        approach = (right * then[j, _SIN] - back * then[j, _COS]) / near_m
        expected, variance = then[j, _BEARING] + turn - across / 2, then[j, _VAR] + turn_var + across * across / 12
        for i in range(len(now)):
            error = now[i, _BEARING] - expected
            error -= 2 * np.pi * np.floor((error + np.pi) / (2 * np.pi))
            density = _normal(error, variance + now[i, _VAR])
            if density == 0.0:
                continue
            density *= now[i, _SPAN]
            if np.isfinite(end_var):
                for end in range(2):
                    slope, room = then[j, _SLOPE + end], now[i, _ROOM + end]
                    shift = (slope * approach + rise) / (c - slope * s) ** 2
                    off = now[i, _E + end] - (slope * c + s) / (c - slope * s) - shift / 2
                    at = _normal(off, shift * shift / 12 + end_var)
                    alike = short * min(room * then[j, _PER_LENGTH], 1.0) + (1.0 - short) * room * at
                    if now[i, _CUT + end] > 0:  # the border ends an edge wherever the thing itself does
                        alike = 1.0 if then[j, _CUT + end] > 0 else short
                    density *= alike
            result[i, j] = density
    return result
