"""How an image is exposed: too dark or washed out, by its grey levels."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from localiser.edges.undistort import Image
from localiser.image_files import decode

DARK_GREY = 64.0
"""Where 95 % of the pixels are darker than this, noise covers faint edges."""
SATURATED_GREY = 250
WASHED_OUT = 0.4
"""Fraction of saturated pixels from which on whole edges vanish in white."""
_EVERY = 8  # pixel counts


@dataclass(frozen=True, slots=True)
class Light:
    """bright_grey: the grey level that 95 % of the pixels are below. saturated: fraction of pixels at the top."""

    bright_grey: float
    saturated: float

    @property
    def is_dark(self) -> bool:
        """Whether too little light came in."""
        return self.bright_grey < DARK_GREY

    @property
    def is_washed_out(self) -> bool:
        """Whether too much light came in."""
        return self.saturated > WASHED_OUT


def light_of(image: Image | bytes) -> Light:
    """Return how an image (H, W) or (H, W, 3), uint8, or as a file, is exposed, at an eighth of its size."""
    if isinstance(image, bytes):
        some = np.asarray(decode(image, cv2.IMREAD_REDUCED_GRAYSCALE_8))
    else:
        some = image[::_EVERY, ::_EVERY]
    return Light(float(np.percentile(some, 95)), float((some >= SATURATED_GREY).mean()))
