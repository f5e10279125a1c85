"""Images that are too dark or washed out are told from others."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from folders import ROOT

from localiser.edges import light_of

IMAGES = sorted((ROOT / "logs" / "corridor" / "images").iterdir())[::20]


@pytest.mark.parametrize(("gain", "verdict"), [(0.25, "dark"), (0.6, ""), (1.0, ""), (1.2, ""), (2.5, "washed out")])
def test_images_of_the_corridor_in_other_light(gain, verdict):
    found = set()
    for path in IMAGES:
        image = np.clip(gain * cv2.imread(str(path), cv2.IMREAD_GRAYSCALE), 0, 255).astype(np.uint8)
        light = light_of(image)
        found.add("dark" if light.is_dark else "washed out" if light.is_washed_out else "")
    assert found == {verdict}


def test_colour_counts_as_grey_does():
    grey = np.full((48, 64), 20, dtype=np.uint8)
    assert light_of(np.dstack([grey] * 3)) == light_of(grey)
    assert light_of(grey).bright_grey == 20 and light_of(grey).saturated == 0
