"""The compiled loop of `scene_clutter`, compared with its equations written with arrays."""

from __future__ import annotations

import numpy as np
import pytest

from localiser.camera import Camera, Mount
from localiser.edges import Edges
from localiser.geometry import Array, wrap_angle
from localiser.observation import Frame, ObservationParameters
from localiser.observation.clutter import GROUP_RAD, NEAR_M, SHORT, EarlierFrame, continued_density, grouped_density
from localiser.observation.frame import ROW_PX, SIGMA_PX


def camera_at(tilt_deg: float, height_m: float) -> Camera:
    return Camera(640, 480, 500.0, 500.0, 319.5, 239.5, Mount(np.radians(tilt_deg), height_m))


def edges_of(camera: Camera, seed: int, with_ends: bool) -> Edges:
    """Return edges all over the image, some of which its border ends, and one of which nothing is known."""
    rng = np.random.default_rng(seed)
    u, v = rng.uniform(30, 610, 25), np.sort(rng.uniform(-20, 500, (25, 2)), axis=1).clip(0, 479)[:, ::-1]
    bearing = np.arctan((u - camera.cx) / camera.fx)
    bearing[-1] = np.nan
    lean = np.arctan(np.sin(camera.mount.tilt_rad) * np.tan(bearing))
    ends_px = np.stack([np.stack([u, v[:, 0]], axis=1), np.stack([u, v[:, 1]], axis=1)], axis=1)
    sigma = rng.uniform(0.002, 0.02, 25)
    return Edges.from_columns(bearing, sigma, lean, sigma, ends_px=ends_px if with_ends else None)


def span_at(frame: Frame, bearing: Array) -> Array:
    """Return the angle (E,) at which a density per rad of bearing is that of clutter, even in the compared angle."""
    return frame.span_rad / frame.predicted(np.tan(bearing))[1]


def normal(error: Array, variance: Array | float) -> Array:
    with np.errstate(invalid="ignore"):
        return np.nan_to_num(np.exp(-0.5 * error**2 / variance) / np.sqrt(2 * np.pi * variance))


def ends_alike(edges: Frame, others: Frame, approach: Array, sigma_px: float) -> Array:
    """Return how much likelier the ends of edges (E) are if they are those of others (B), (E, B)."""
    (now, ends), (then, earlier) = (edges.camera, edges.ends), (others.camera, others.ends)
    s, c = np.sin(then.mount.tilt_rad), np.cos(then.mount.tilt_rad)
    slope = (earlier.e * c - s) / (c + earlier.e * s)
    s, c = np.sin(now.mount.tilt_rad), np.cos(now.mount.tilt_rad)
    rise = (then.mount.height_m - now.mount.height_m) / NEAR_M
    shift = (slope * approach[:, None] + rise) / (c - slope * s) ** 2
    variance = shift**2 / 12 + (sigma_px / now.focal_px) ** 2
    at = normal(ends.e[:, None] - (slope * c + s) / (c - slope * s) - shift / 2, variance)
    room = ends.room[:, None]
    alike = SHORT * np.minimum(room * earlier.per_length[:, None], 1.0) + (1.0 - SHORT) * room * at
    cut = np.where(earlier.cut, 1.0, SHORT)
    return np.asarray(np.where(ends.cut[:, None], cut, alike).prod(axis=2))


@pytest.mark.parametrize("kind", ["line", "slope"])
@pytest.mark.parametrize("with_ends", [True, False], ids=["ends", "no ends"])
@pytest.mark.parametrize("mount", [(15.0, 1.0), (17.0, 1.1)], ids=["same mount", "another mount"])
def test_edges_continue_those_of_an_earlier_image(kind, with_ends, mount):
    now, then = camera_at(15.0, 1.0), camera_at(*mount)
    edges, others = (
        Frame(edges_of(camera, seed, with_ends), camera, ObservationParameters(kind=kind))
        for seed, camera in ((1, now), (2, then))
    )
    image = EarlierFrame(others, np.array([0.1, -0.3, 0.05]), 1e-4)
    (bearing, sigma), (earlier, earlier_sigma), (right, back, turn) = edges.bearings, others.bearings, image.motion
    across = (right * np.cos(earlier) + back * np.sin(earlier)) / NEAR_M
    error = wrap_angle(bearing[:, None] - (earlier + turn - across / 2))
    variance = earlier_sigma**2 + image.turn_var + across**2 / 12 + sigma[:, None] ** 2
    expected = normal(error, variance) * span_at(edges, bearing)[:, None]
    if with_ends:
        ahead = image.motion[0] * np.sin(earlier) - image.motion[1] * np.cos(earlier)
        expected *= ends_alike(edges, others, ahead / NEAR_M, SIGMA_PX)
    expected = np.nan_to_num(expected)
    assert (expected > 1.0).sum() > 10 and not expected[-1].any()
    np.testing.assert_allclose(continued_density(edges, image), expected, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("with_ends", [True, False], ids=["ends", "no ends"])
def test_edges_of_one_image_stand_in_groups(with_ends):
    camera = camera_at(15.0, 1.0)
    edges = Frame(edges_of(camera, 3, with_ends), camera)
    bearing, sigma = edges.bearings
    density = normal(bearing[:, None] - bearing, GROUP_RAD**2 + sigma[:, None] ** 2) * span_at(edges, bearing)[:, None]
    if with_ends:
        density *= ends_alike(edges, edges, np.zeros(len(bearing)), ROW_PX)
    density = np.nan_to_num(density)
    np.fill_diagonal(density, 0.0)
    np.testing.assert_allclose(grouped_density(edges), (1.0 + density.sum(axis=1)) / len(bearing), rtol=1e-9)
