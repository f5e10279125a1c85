"""Where the camera's maximum cuts off the lighter side of an edge: how far that moves the edge, and how sure that is.

A step from a to b, blurred by a Gaussian of width w, is seen up to the maximum S only. What is left of its slope is the
part on the darker side, so the edge appears displaced to there, by the more the more of the step is cut off. The darker
side is seen. The lighter one may be anything above S, the more rarely the lighter: an exponential distribution of
stops, which continues the image's own distribution of brightness (`stops_above`). That gives the mean of the
displacement, by which the edge is corrected, and its standard deviation.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from localiser.edges.columns import SCALE_PX, WHITE_GREY
from localiser.geometry import Array

PIXEL_VARIANCE = 1 / 12
"""Of the square that a pixel is (px²): all that blurs an image of a perfect lens before it is clipped."""
AFTER_VARIANCE = SCALE_PX**2 + 0.66
"""Of all that blurs an image after it is clipped: the filter, and looking up and averaging pixels (px²).

A step that no lens blurs has a slope 1.32 px wide, its pixel included.
"""
MOST_GREY = 255.0
_LEAST_STOPS, _MOST_STOPS = 0.1, 1.0
"""Limits of the mean: a histogram that is nearly all white does not say how white."""
_QUANTILES = -np.log(1 - (np.arange(24) + 0.5) / 24)
PIXEL_SIGMA_PX = 1 / np.sqrt(12.0)
"""Where the lighter side is clipped, the fraction of the edge's pixel that it covers is unknown."""
_DARKER = np.linspace(0.0, 0.99 * MOST_GREY, 40)
_PLACES = np.linspace(-3.5, 0.0, 351)


def stops_above(grey: Array) -> float:
    """Return how many stops above the camera's maximum the clipped ones of grey levels (K,) are in the mean.

    An exponential distribution that has as many per stop at the maximum as the stop below it.
    """
    clipped, below = float((grey > WHITE_GREY).mean()), float(((grey > WHITE_GREY / 2) & (grey <= WHITE_GREY)).mean())
    return float(np.clip(clipped / max(below, 1e-9), _LEAST_STOPS, _MOST_STOPS))


def displacement(darker_grey: Array, blur_px: float, stops: float) -> tuple[Array, Array]:
    """Return how far (K,) edges appear on the darker side of where they are (px), and the standard deviation of that.

    darker_grey: (K,) grey level of the darker side. blur_px: width of the Gaussian that blurs edges in the image.
    stops: by how many the lighter side is above the camera's maximum, in the mean.
    """
    mean, sigma = _table(round(blur_px, 1), round(stops, 1))
    return np.interp(darker_grey, _DARKER, mean), np.interp(darker_grey, _DARKER, sigma)


@lru_cache(maxsize=256)
def _table(blur_px: float, stops: float) -> tuple[Array, Array]:
    """Return the mean (px) of the displacement at the grey levels `_DARKER`, and its standard deviation."""
    lighter = MOST_GREY * 2.0 ** (stops * _QUANTILES)
    share = (MOST_GREY - _DARKER[:, None]) / (lighter - _DARKER[:, None])
    displaced = -blur_px * _peak(share, blur_px)
    return displaced.mean(axis=1), displaced.std(axis=1)


def _peak(share: Array, blur_px: float) -> Array:
    """Return where the gradient of a step is steepest when only this share (A, B) of it is seen, over the blur's width.

    The Gaussian of the blur, cut off at t, is filtered by one of `AFTER_VARIANCE`. That is a Gaussian of both together,
    times the normal distribution function of the distance from t.
    """
    from scipy.special import log_ndtr, ndtri

    ratio = np.sqrt(AFTER_VARIANCE) / blur_px
    both = 1 + ratio**2
    place = _PLACES[:, None, None]
    steepness = -0.5 * place**2 / both + log_ndtr((ndtri(share) * both - place) / (ratio * np.sqrt(both)))
    return np.asarray(_PLACES[steepness.argmax(axis=0)])
