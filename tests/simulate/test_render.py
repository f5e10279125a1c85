"""Rendered images: edges are where the camera projects them, near hides far, a sensor errs as stated."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from plain_room import CORNERS, plain_room

from localiser.camera import Camera
from localiser.geometry import Array, Trajectory
from localiser.simulate.render import Scene, expose, radiance, render, scene_of
from localiser.simulate.surfaces import look_up
from localiser.simulate.world import world_of


def world_data(**changes: Any) -> dict[str, Any]:
    """Return a dark room of 8 m with a bright square post in it, all in plain colours.

    Dark floors, since the shadow at the foot of a wall is a gradient of its own.
    """
    plain = {"texture": "plain", "contrast": 0.0}
    own = {
        "materials": {
            name: plain | {"colour": [grey] * 3} for name, grey in (("wall", 90), ("floor", 4), ("post", 230))
        },
        "floor": {"material": "floor"},
        "ceiling": {"material": "floor"},
        "light": {"ambient": 1.0, "directional": 0.2},
        "walls": [{"from": CORNERS[k - 1], "to": CORNERS[k]} for k in range(4)],
        "posts": [{"x": 0.0, "z": -1.0, "width_m": 0.5, "rotation_deg": 20.0, "material": "post"}],
        "camera": {
            "focal_px": 554.0,
            "distortion_model": "plumb_bob",
            "distortion": [-0.25, 0.05, 0.001, -0.002],
            "mount": {"tilt_deg": 20.0, "roll_deg": 3.0, "height_m": 0.9, "yaw_deg": 2.0, "back_m": -0.1},
        },
    }
    return plain_room(**(own | changes))


@pytest.fixture(scope="module")
def scene() -> Scene:
    return scene_of(world_of(world_data()))


def measured_u(image: Array, expected_u: Array, rows: Array, half: int = 4) -> Array:
    """Return where grey values change, per row: the centroid of the gradient within a window."""
    found = []
    for u, row in zip(expected_u, rows, strict=True):
        first = round(u) - half
        profile = image[row, first : first + 2 * half + 1].astype(float)
        gradient = np.abs(np.diff(profile))
        found.append(first + 0.5 + (gradient * np.arange(2 * half)).sum() / gradient.sum())
    return np.array(found)


def projected_u(camera: Camera, pose: Array, point: Array, rows: Array) -> Array:
    heights = np.linspace(-0.5, 3.0, 4000)
    column = np.stack([np.full(4000, point[0]), heights, np.full(4000, point[1])], axis=-1)
    u, v = camera.project(pose, column).T
    return np.interp(rows, v[::-1], u[::-1])


@pytest.mark.parametrize("pose", [(0.0, 2.0, 0.0), (0.5, 1.5, 0.4), (-0.7, 1.2, -0.15), (0.3, 0.9, -0.1)])
def test_edges_are_where_the_camera_projects_them(scene: Scene, pose: tuple[float, float, float]) -> None:
    robot, camera = np.array(pose), scene.camera
    image = radiance(scene, robot)[..., 0]
    post = scene.structure.solids.corners[-1]
    at_floor = camera.project(robot, np.stack([post[:, 0], np.zeros(4), post[:, 1]], axis=-1))
    errors = []
    for silhouette in (at_floor[:, 0].argmin(), at_floor[:, 0].argmax()):
        rows = np.arange(8, min(camera.height - 8, int(at_floor[silhouette, 1]) - 8), 3)
        expected = projected_u(camera, robot, post[silhouette], rows)
        shown = (expected > 10) & (expected < camera.width - 10)
        errors.append(measured_u(image, expected[shown], rows[shown]) - expected[shown])
    error = np.concatenate(errors)
    assert len(error) > 60
    assert np.sqrt((error**2).mean()) < 0.05
    assert abs(error.mean()) < 0.02, "a shift of the pixel grid would move all edges alike"


def test_every_pixel_shows_the_nearest_surface() -> None:
    """A low box, a lintel and a hanging box, against a plain loop over rays and faces."""
    data = world_data(
        furniture=[
            {"x": 0.8, "z": 0.5, "width_m": 0.6, "depth_m": 0.8, "rotation_deg": 15.0, "top_m": 0.5, "material": "low"},
            {
                "x": -1.0,
                "z": -0.5,
                "width_m": 1.0,
                "depth_m": 0.5,
                "bottom_m": 1.1,
                "top_m": 1.4,
                "material": "hanging",
            },
        ],
        light={"ambient": 1.0, "directional": 0.0},
    )
    plain = {"texture": "plain", "contrast": 0.0}
    data["materials"] |= {
        "low": {**plain, "colour": [250, 10, 10]},
        "hanging": {**plain, "colour": [10, 10, 250]},
        "wall": {**plain, "colour": [10, 250, 10]},
    }
    data["camera"]["mount"]["tilt_deg"] = 5.0
    scene = scene_of(world_of(data))
    robot = np.array([0.0, 3.0, 0.0])
    image = radiance(scene, robot)
    pixels = np.stack(np.meshgrid(np.arange(15, 640, 20), np.arange(15, 480, 20)), axis=-1).reshape(-1, 2)
    expected = [first_solid(scene, robot, pixel) for pixel in pixels]
    colours = {name: np.array(material.colour, dtype=float) for name, material in scene.world.materials.items()}
    wrong, names = 0, set()
    for (u, v), name in zip(pixels, expected, strict=True):
        patch = image[v - 1 : v + 2, u - 1 : u + 2].reshape(-1, 3)
        if np.ptp(patch, axis=0).max() > 20:
            continue  # on an edge, where colours mix
        hue = patch.mean(axis=0)
        nearest = min(colours, key=lambda n: 1 - hue @ colours[n] / np.linalg.norm(hue) / np.linalg.norm(colours[n]))
        same_hue = {"floor", "post"}
        wrong += nearest != name and not {nearest, name} <= same_hue
        names.add(name)
    assert wrong == 0 and names == {"low", "hanging", "wall", "floor", "post"}


def first_solid(scene: Scene, robot: Array, pixel: Array) -> str:
    """Return the material that a ray through the pixel meets first, found by small steps along it."""
    camera = scene.camera
    x, y, z = camera.level_rays(pixel)
    pose = camera.pose_in_map(robot)
    cos, sin = np.cos(pose[2]), np.sin(pose[2])
    step = np.array([cos * x + sin * z, y, -sin * x + cos * z]) / np.linalg.norm([x, y, z])
    points = np.array([pose[0], camera.mount.height_m, pose[1]]) + np.arange(0.05, 12, 0.002)[:, None] * step
    normals, offsets = scene.structure.solids.half_planes()
    inside = (np.einsum("pkd,td->tpk", normals, points[:, [0, 2]]) <= offsets).all(axis=2)
    inside &= (points[:, 1:2] >= scene.structure.solids.bottom_m) & (points[:, 1:2] <= scene.structure.solids.top_m)
    outside = (points[:, 1] <= 0) | (points[:, 1] >= scene.world.ceiling_m)
    hit = int((inside.any(axis=1) | outside).argmax())
    return scene.structure.solids.material[int(inside[hit].argmax())] if inside[hit].any() else "floor"


def test_the_same_generator_gives_the_same_image_and_noise_has_its_sigma(scene: Scene) -> None:
    scene = replace(scene, world=world_of(world_data(image={"noise_sigma": 2.0, "colour": False})))
    robot = np.array([0.0, 2.0, 0.0])
    one, two, other = (render(scene, robot, np.random.default_rng(seed)) for seed in (1, 1, 2))
    assert one.shape == (480, 640) and one.dtype == np.uint8
    np.testing.assert_array_equal(one, two)
    difference = one.astype(float) - other
    assert abs(difference.std() - np.sqrt(2) * np.hypot(2.0, 1 / np.sqrt(12))) < 0.05


def test_vignette_darkens_as_stated(scene: Scene) -> None:
    robot = np.array([0.0, 2.0, 0.0])
    spec = {"noise_sigma": 0.0, "vignette": 0.4, "colour": True}
    dimmed = replace(scene, world=world_of(world_data(image=spec)))
    image = render(dimmed, robot, np.random.default_rng(0)).astype(float)
    bright = radiance(scene, robot)[..., ::-1]  # images are BGR
    np.testing.assert_allclose(image[239:241, 319:321], bright[239:241, 319:321], atol=0.51)
    np.testing.assert_allclose(
        image[[0, 0, -1, -1], [0, -1, 0, -1]], 0.6 * bright[[0, 0, -1, -1], [0, -1, 0, -1]], atol=0.51
    )


@pytest.mark.slow
def test_exposure_blurs_edges_by_the_motion_and_leaves_them_in_place() -> None:
    scene = scene_of(world_of(world_data(image={"noise_sigma": 0.0, "exposure_s": 0.02, "colour": False})))
    turning = Trajectory(np.array([0, 100_000_000]), np.array([[0.0, 2.0, -0.03], [0.0, 2.0, 0.03]]))
    blurred = expose(scene, turning, 50_000_000, np.random.default_rng(0)).astype(float)
    sharp = render(scene, np.array([0.0, 2.0, 0.0]), np.random.default_rng(0)).astype(float)
    post = scene.structure.solids.corners[-1]
    rows = np.arange(20, 200, 5)
    expected = projected_u(scene.camera, np.array([0.0, 2.0, 0.0]), post[post[:, 0].argmin()], rows)
    error = measured_u(blurred, expected, rows, half=10) - expected
    assert np.sqrt((error**2).mean()) < 0.15
    steepest = [np.abs(np.diff(image[rows], axis=1)).max(axis=1).mean() for image in (sharp, blurred)]
    # The post's edge moves by 554 px · 0.6 rad/s · 0.02 s = 6.6 px while the shutter is open.
    assert steepest[1] < steepest[0] / 4


def test_a_camera_that_looks_straight_down_is_refused() -> None:
    data = world_data()
    data["camera"] |= {"width": 160, "height": 120, "focal_px": 138.5}  # the same field of view in fewer pixels
    data["camera"]["mount"]["tilt_deg"] = 60.0
    with pytest.raises(ValueError, match="straight down"):
        scene_of(world_of(data))


def test_looking_up_nothing_gives_nothing() -> None:
    nowhere = np.zeros(0, dtype=np.float32)
    assert look_up(np.ones((4, 5, 3), dtype=np.float32), nowhere, nowhere).shape == (0, 3)
