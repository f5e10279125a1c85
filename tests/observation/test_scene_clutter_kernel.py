"""The compiled loop of `scene_clutter`, compared with its equations written with arrays."""

from __future__ import annotations

import numpy as np
import pytest

from localiser.camera import Camera, Mount
from localiser.edges import Edges
from localiser.geometry import Array
from localiser.observation import Angle
from localiser.observation.endpoint_likelihood import ROW_PX, SIGMA_PX, endpoints_of
from localiser.observation.persistent_clutter import NEAR_M, errors_of_continuing
from localiser.observation.scene_clutter import GROUP_RAD, SHORT, EarlierEdges, continued_density, grouped_density


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


def normal(error: Array, variance: Array | float) -> Array:
    with np.errstate(invalid="ignore"):
        return np.nan_to_num(np.exp(-0.5 * error**2 / variance) / np.sqrt(2 * np.pi * variance))


def ends_alike(now: Camera, edges: Edges, then: Camera, others: Edges, approach: Array, sigma_px: float) -> Array:
    """Return how much likelier the ends of edges (E) are if they are those of others (B), (E, B)."""
    ends, earlier = endpoints_of(edges, now), endpoints_of(others, then)
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
    angle, before = Angle(now, kind), Angle(then, kind)
    edges, others = edges_of(now, 1, with_ends), edges_of(then, 2, with_ends)
    image = EarlierEdges(others, np.array([0.1, -0.3, 0.05]), 1e-4, then)
    (bearing, sigma), (earlier, earlier_sigma) = angle.bearings(edges), before.bearings(others)
    error, variance = errors_of_continuing(bearing, sigma, earlier, earlier_sigma, image.motion, image.turn_var)
    expected = normal(error, variance) * angle.span_at(bearing)[:, None]
    if with_ends:
        ahead = image.motion[0] * np.sin(earlier) - image.motion[1] * np.cos(earlier)
        expected *= ends_alike(now, edges, then, others, ahead / NEAR_M, SIGMA_PX)
    expected = np.nan_to_num(expected)
    assert (expected > 1.0).sum() > 10 and not expected[-1].any()
    np.testing.assert_allclose(continued_density(angle, edges, image), expected, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("with_ends", [True, False], ids=["ends", "no ends"])
def test_edges_of_one_image_stand_in_groups(with_ends):
    camera = camera_at(15.0, 1.0)
    edges, angle = edges_of(camera, 3, with_ends), Angle(camera, "line")
    bearing, sigma = edges.bearing, edges.bearing_sigma
    density = normal(bearing[:, None] - bearing, GROUP_RAD**2 + sigma[:, None] ** 2) * angle.span_at(bearing)[:, None]
    if with_ends:
        density *= ends_alike(camera, edges, camera, edges, np.zeros(len(edges)), ROW_PX)
    density = np.nan_to_num(density)
    np.fill_diagonal(density, 0.0)
    np.testing.assert_allclose(grouped_density(angle, edges), (1.0 + density.sum(axis=1)) / len(edges), rtol=1e-9)
