"""Whether the lower end of an edge stands on the floor."""

from __future__ import annotations

import numpy as np
from edge_images import SUPERSAMPLING, camera_of, supersampled_directions, wall_image

from localiser.edges import find_edges
from localiser.edges.foot import BORDER_PX, foot_of_edges

CAMERA = camera_of(tilt_deg=20.0, roll_deg=1.0)
WALL_M = 2.5


def panel_image() -> np.ndarray:
    """Return the image of a wall with a panel that stands on the floor."""
    k = SUPERSAMPLING
    right, up = supersampled_directions(CAMERA)
    on_floor = up < -CAMERA.mount.height_m / WALL_M
    fine = np.where(np.abs(right) < np.tan(np.deg2rad(8.0)), 70.0, 150.0)
    fine[on_floor] = 210.0
    image = fine.reshape(CAMERA.height, k, CAMERA.width, k).mean(axis=(1, 3))
    image += np.random.default_rng(0).normal(0.0, 2.0, image.shape)
    return np.clip(np.rint(image), 0, 255).astype(np.uint8)


def test_a_panel_that_stands_on_the_floor_is_as_far_as_its_foot_says() -> None:
    edges = find_edges(panel_image(), CAMERA)
    edges = edges.take(np.abs(np.abs(np.rad2deg(edges.bearing)) - 8.0) < 0.5)
    assert len(edges) == 2
    expected = WALL_M / np.cos(edges.bearing)
    assert np.all(np.abs(edges.foot_range_m - expected) < 3 * edges.foot_range_sigma_m)


def test_an_edge_that_may_be_cut_off_by_the_border_has_no_foot() -> None:
    last = CAMERA.height - 1
    bottom = np.array([[300.0, last - BORDER_PX + 1.0], [300.0, last - BORDER_PX - 1.0], [BORDER_PX - 1.0, 300.0]])
    range_m, _ = foot_of_edges(bottom, CAMERA)
    np.testing.assert_array_equal(np.isnan(range_m), [True, False, True])


def test_an_edge_that_ends_above_the_horizon_has_no_foot() -> None:
    camera = camera_of(tilt_deg=5.0)
    image = wall_image(camera, [5.0], [70.0, 150.0])
    image[150:] = 110
    assert camera.level_rays(np.array([330.0, 150.0]))[1] > 0
    edges = find_edges(image, camera)
    assert len(edges) == 1
    assert np.isnan(edges.foot_range_m[0])
