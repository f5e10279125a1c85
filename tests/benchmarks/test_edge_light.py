"""Images in another light: which edges a matched filter could find, and that the noise of an image is measured."""

from __future__ import annotations

import numpy as np
import pytest
from edge_light import LIGHTS, Light, has_own_peak, matched_snr, noise_of, profiles_of, rendered_anew
from edge_scenes import Difficulty

from localiser.edges import find_edges


def step_image(step):
    image = np.full((120, 160), 100.0)
    image[:, 80:] += step
    return image


ENDS_PX = np.array([[[79.5, 110.0], [79.5, 10.0]]])


def test_the_matched_ratio_of_a_step_is_that_of_its_pixels():
    profile = profiles_of(step_image(10.0), ENDS_PX)
    # Six columns 5 grey levels off the middle, and one on it; 100 rows; noise 2.
    expected = np.sqrt(100 * 6 * 5.0**2) / 2
    np.testing.assert_allclose(matched_snr(profile, np.array([100.0]), 2.0), expected, rtol=0.02)


@pytest.mark.parametrize(("off_px", "is_own"), [(0.0, True), (3.0, False)])
def test_an_edge_counts_where_the_picture_is_steepest(off_px, is_own):
    blurred = Light(blur_px=2.0).of(step_image(40.0))
    assert has_own_peak(profiles_of(blurred, ENDS_PX + np.array([off_px, 0.0])))[0] == is_own


@pytest.mark.parametrize("sigma", [1.0, 5.0, 20.0])
def test_noise_is_measured_beside_the_edges(sigma):
    image = step_image(60.0) + np.random.default_rng(0).normal(0, sigma, (120, 160))
    np.testing.assert_allclose(noise_of(image), sigma, rtol=0.15)


@pytest.mark.parametrize(
    "name",
    ["gain 0.15", *(pytest.param(each, marks=pytest.mark.slow) for each in ("noise 20", "gain 0.3", "blur 2 px"))],
)
def test_nine_of_ten_edges_that_a_matched_filter_finds_are_found_in_any_light(name):
    counted = found = 0
    for scene in rendered_anew(Difficulty(noise_sigma=1.0), LIGHTS[name], 3):
        edges = find_edges(scene.image, scene.camera)
        apart = np.abs(edges.bearing - scene.camera.bearing_of_segments(scene.truth_px)[:, None])
        counted += scene.counted.sum()
        found += (scene.counted & (apart.min(axis=1) < 0.004)).sum()
    assert counted > 20
    assert found >= 0.9 * counted
