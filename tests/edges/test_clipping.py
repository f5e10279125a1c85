"""Edges beside what is overexposed: where they appear, and how uncertain that is."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from edge_images import camera_of, wall_image

from localiser.edges import find_edges
from localiser.edges.clipping import AFTER_VARIANCE, MOST_GREY, displacement, stops_above

CAMERA = camera_of(tilt_deg=20.0)
BEARING_DEG = 3.0


def steepest(darker: float, lighter: float, blur_px: float) -> float:
    """Return where the gradient of a blurred, clipped and filtered step is steepest, by plain convolution (px)."""
    place = np.arange(-9, 9, 0.01)
    gradient = np.exp(-0.5 * (place / blur_px) ** 2)
    seen = darker + (lighter - darker) * np.cumsum(gradient) / gradient.sum() < MOST_GREY
    window = np.exp(-0.5 * np.arange(-6, 6.005, 0.01) ** 2 / AFTER_VARIANCE)
    return float(place[np.convolve(gradient * seen, window, "same").argmax()])


@pytest.mark.parametrize("blur_px", [0.5, 1.0, 2.0])
@pytest.mark.parametrize("darker", [30.0, 200.0])
def test_the_displacement_is_that_of_clipped_steps_with_a_lighter_side_so_many_stops_above(darker, blur_px) -> None:
    stops = 0.6
    above = stops * -np.log(1 - (np.arange(300) + 0.5) / 300)
    displaced = [-steepest(darker, MOST_GREY * 2**each, blur_px) for each in above]
    mean, sigma = displacement(np.array([darker]), blur_px, stops)
    np.testing.assert_allclose(mean, np.mean(displaced), atol=0.03 * blur_px)
    np.testing.assert_allclose(sigma, np.std(displaced), atol=0.05 * blur_px)


def test_the_lighter_side_is_as_far_above_as_the_histogram_goes_on() -> None:
    below, white = np.full(100, 180.0), np.full(30, 255.0)
    assert stops_above(np.concatenate([below, white])) == pytest.approx(0.3)
    assert stops_above(np.concatenate([below, np.full(1000, 10.0)])) < stops_above(np.concatenate([below, white]))
    assert stops_above(np.full(100, 255.0)) == 1.0


@pytest.mark.parametrize("greys", [[60.0, 200.0], [200.0, 60.0]], ids=["light on the right", "light on the left"])
@pytest.mark.parametrize("blur_px", [0.7, 1.5])
def test_an_edge_beside_clipped_white_is_where_it_says(greys, blur_px) -> None:
    light = 2.0 * cv2.GaussianBlur(wall_image(CAMERA, [BEARING_DEG], greys).astype(np.float64), (0, 0), blur_px)
    noisy = light + np.random.default_rng(0).normal(0, 1.0, light.shape)
    (edges,) = [find_edges(np.clip(np.rint(noisy), 0, 255).astype(np.uint8), CAMERA)]
    assert len(edges) == 1
    error = edges.bearing[0] - np.deg2rad(BEARING_DEG)
    per_px = CAMERA.bearing_sigma_of_segments(edges.ends_px, 1.0)[0]
    assert abs(error) < 2.5 * edges.bearing_sigma[0]
    assert abs(error) < 0.6 * per_px
    assert edges.bearing_sigma[0] > 0.15 * per_px
