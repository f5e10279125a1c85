"""Whether the lower end of an edge stands on the floor."""

from __future__ import annotations

import numpy as np
import pytest
from edge_images import SUPERSAMPLING, camera_of, supersampled_directions, wall_image

from localiser.camera import Camera
from localiser.edges import Edges, find_edges
from localiser.edges.foot import BORDER_PX, foot_of_edges, foot_probability

CAMERA = camera_of(tilt_deg=20.0, roll_deg=1.0)
WALL_M = 2.5


def image_of(*, hung_m: float | None = None, hidden_by_m: float | None = None) -> np.ndarray:
    """Return the image of a wall with a panel, to the floor or hung above it, or with its foot behind a low box."""
    k = SUPERSAMPLING
    right, up = supersampled_directions(CAMERA)
    height = CAMERA.mount.height_m
    fine = np.full(right.shape, 150.0)
    panel_from = -height / WALL_M if hung_m is None else (hung_m - height) / WALL_M
    fine[(np.abs(right) < np.tan(np.deg2rad(8.0))) & (up > panel_from)] = 70.0
    fine[up < -height / WALL_M] = 210.0
    if hidden_by_m is not None:
        # A box 0.4 m high, from side to side.
        fine[up < (0.4 - height) / hidden_by_m] = 110.0
        fine[up < -height / hidden_by_m] = 210.0
    image = fine.reshape(CAMERA.height, k, CAMERA.width, k).mean(axis=(1, 3))
    image += np.random.default_rng(0).normal(0.0, 2.0, image.shape)
    return np.clip(np.rint(image), 0, 255).astype(np.uint8)


def panel(image: np.ndarray, camera: Camera = CAMERA) -> Edges:
    edges = find_edges(image, camera, with_probabilities=True)
    return edges.take(np.abs(np.abs(np.rad2deg(edges.bearing)) - 8.0) < 0.5)


def test_a_panel_that_stands_on_the_floor_likely_does() -> None:
    edges = panel(image_of())
    assert len(edges) == 2
    assert np.all(edges.foot_probability > 0.6)
    expected = WALL_M / np.cos(edges.bearing)
    assert np.all(np.abs(edges.foot_range_m - expected) < 3 * edges.foot_range_sigma_m)


@pytest.mark.parametrize("not_on_the_floor", [{"hung_m": 0.3}, {"hidden_by_m": 1.6}], ids=["hung", "hidden"])
def test_a_panel_with_something_else_below_its_end_likely_does_not_stand_there(not_on_the_floor: dict) -> None:
    edges, standing = panel(image_of(**not_on_the_floor)), panel(image_of())
    assert len(edges) == 2
    assert np.all(edges.foot_range_m > WALL_M * 1.2)
    assert np.all(edges.foot_probability < 0.5)
    assert edges.foot_probability.max() < 0.6 * standing.foot_probability.min()


def test_an_edge_that_may_be_cut_off_by_the_border_has_no_foot() -> None:
    last = CAMERA.height - 1
    bottom = np.array([[300.0, last - BORDER_PX + 1.0], [300.0, last - BORDER_PX - 1.0], [BORDER_PX - 1.0, 300.0]])
    range_m, _ = foot_of_edges(bottom, CAMERA)
    np.testing.assert_array_equal(np.isnan(range_m), [True, False, True])
    probability = foot_probability(bottom, range_m, np.full((480, 640), 90, np.uint8), CAMERA)
    assert probability[0] == probability[2] == 0.0
    assert 0.0 < probability[1] < 1.0


def test_an_edge_that_ends_above_the_horizon_has_no_foot() -> None:
    camera = camera_of(tilt_deg=5.0)
    image = wall_image(camera, [5.0], [70.0, 150.0])
    image[150:] = 110
    assert camera.level_rays(np.array([330.0, 150.0]))[1] > 0
    edges = find_edges(image, camera, with_probabilities=True)
    assert len(edges) == 1
    assert np.isnan(edges.foot_range_m[0])
    assert edges.foot_probability[0] == 0.0


@pytest.mark.parametrize(
    "camera",
    [CAMERA, camera_of(tilt_deg=60.0), camera_of(k1=-0.3, tilt_deg=45.0), camera_of(176, 144), camera_of(tilt_deg=0.0)],
    ids=["plain", "nadir in view", "bent", "small", "level"],
)
def test_any_place_in_any_image_has_a_probability(camera: Camera) -> None:
    rng = np.random.default_rng(0)
    image = rng.integers(0, 255, (camera.height, camera.width), dtype=np.uint8)
    bottom = rng.uniform(0, [camera.width - 1, camera.height - 1], (400, 2))
    range_m, sigma_m = foot_of_edges(bottom, camera)
    probability = foot_probability(bottom, range_m, image, camera)
    assert np.all((probability >= 0) & (probability <= 1))
    np.testing.assert_array_equal(probability == 0, np.isnan(range_m))
    assert np.all(sigma_m[np.isfinite(range_m)] > 0)


def test_the_flag_is_by_what_is_likelier() -> None:
    from localiser.commands.edge_picture import foot_flag

    unknown = np.full(4, np.nan)
    edges = Edges.from_columns(
        unknown, unknown, unknown, unknown,
        foot_range_m=np.array([2.0, 2.0, np.nan, np.nan]), foot_probability=np.array([0.8, 0.2, 0.0, np.nan]),
    )  # fmt: skip
    assert foot_flag(edges).tolist() == ["floor", "hidden", "outside", ""]
