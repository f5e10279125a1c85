"""A simulated camera that moves on the robot, or whose shutter rolls: what it sees, what the log states of it."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from plain_room import camera_data, plain_room

from localiser.camera import MountSigma, RollingShutter
from localiser.geometry import Array, Trajectory, arc_motion, compose
from localiser.simulate import simulated_log, world_of
from localiser.simulate.drive import mount_at
from localiser.simulate.render import Scene, expose, radiance, scene_of, sharp_image

SHUTTER = {"row_time_us": 250.0, "stamp_row": 80.0}
MIDDLE_NS = 100_000_000
T_NS = np.arange(0, 201) * 1_000_000
START = np.array([0.3, 2.0, 0.05])


def world_data(shutter: dict[str, Any] | None, motion: dict[str, Any] | None = None, **image: Any) -> dict[str, Any]:
    """Return the room with another, lower post, and a camera whose shutter rolls."""
    mount = {"tilt_deg": 20.0, "height_m": 0.9, "back_m": -0.1, "yaw_deg": 2.0}
    room = plain_room(camera=camera_data(mount, rolling_shutter=shutter, motion=motion))
    room["posts"].append({"x": 0.7, "z": 1.0, "width_m": 0.2, "material": "light", "top_m": 1.0})
    room["drive"] = {"path": [{"to": [-1.5, 3.0]}, {"to": [-1.5, 1.0]}], "image_hz": 10.0}
    room["image"] |= image
    return room


def driven(turn_rad_s: float, speed_m_s: float) -> Trajectory:
    velocity, since_s = np.array([0.0, -speed_m_s]), (T_NS - MIDDLE_NS) / 1e9
    return Trajectory(T_NS, np.array([compose(START, arc_motion(velocity, turn_rad_s * s, s)) for s in since_s]))


def row_by_row(scene: Scene, truth: Trajectory) -> Array:
    """Return every sixth row, each of an image from where the robot was then."""
    rows = []
    for row in range(0, scene.camera.height, 6):
        at_ns = MIDDLE_NS + round((row - SHUTTER["stamp_row"]) * SHUTTER["row_time_us"] * 1e3)
        rows.append(radiance(scene, truth.at(at_ns), scene.camera_at(at_ns))[row])
    return np.array(rows)


def crossings(image: Array) -> Array:
    """Return where the grey of each row above the low post is light, as a centroid: (R,) px."""
    level = np.clip((image[:7, :, 0] - 80.0) / 100.0, 0.0, 1.0)
    return np.asarray((level * np.arange(image.shape[1])).sum(axis=1) / level.sum(axis=1))


@pytest.mark.parametrize(
    ("turn_rad_s", "speed_m_s", "motion"),
    [(1.0, 0.5, None), (-2.0, 0.0, None), (0.3, 0.3, {"tilt_deg": {"amplitude": 6.0, "hz": 1.0}})],
)
def test_rows_are_those_of_images_from_where_the_robot_was_then(
    turn_rad_s: float, speed_m_s: float, motion: dict[str, Any] | None
) -> None:
    scene, truth = scene_of(world_of(world_data(SHUTTER, motion))), driven(turn_rad_s, speed_m_s)
    expected, found = row_by_row(scene, truth), sharp_image(scene, truth, MIDDLE_NS)[::6]
    at_once = radiance(scene, truth.at(MIDDLE_NS), scene.camera_at(MIDDLE_NS))[::6]
    assert found.shape == expected.shape
    off, without = (np.abs(image - expected).mean() for image in (found, at_once))
    assert off < 0.2 * without
    assert np.quantile(np.abs(crossings(found) - crossings(expected)), 0.9) < 0.15


def test_a_robot_that_stands_has_the_image_of_a_camera_that_takes_all_rows_at_once() -> None:
    rolling, plain = (scene_of(world_of(world_data(shutter, exposure_s=0.01))) for shutter in (SHUTTER, None))
    still = driven(0.0, 0.0)
    images = [expose(scene, still, MIDDLE_NS, np.random.default_rng(3)) for scene in (rolling, plain)]
    np.testing.assert_array_equal(*images)


def test_the_log_states_the_shutter() -> None:
    log = simulated_log(world_of(world_data(SHUTTER)), 0)
    assert log.camera.shutter == RollingShutter(250e-6, 80.0)
    assert log.scene.camera.shutter is not None
    first_s, last_s = log.scene.camera.readout_s
    assert log.drive.image_t_ns[0] >= round(-first_s * 1e9)
    assert log.drive.image_t_ns[-1] + round(last_s * 1e9) <= log.drive.truth.t_ns[-1]


MOTION: dict[str, Any] = {"tilt_deg": {"amplitude": 6.0, "hz": 1.0}, "yaw_deg": {"amplitude": 20.0, "hz": 0.5}}


def test_the_mount_sways_about_the_usual_one() -> None:
    world = world_of(
        plain_room(camera=camera_data(motion=MOTION | {"height_m": {"amplitude": 0.1, "hz": 1.0, "phase_deg": 90.0}}))
    )
    usual = world.camera.camera().mount
    at_start, later = (mount_at(usual, world.camera.motion, t_ns) for t_ns in (0, 250_000_000))
    assert at_start == replace(usual, height_m=pytest.approx(1.0))
    assert np.degrees(later.tilt_rad) == pytest.approx(26.0) and later.height_m == pytest.approx(0.9)
    assert np.degrees(later.yaw_rad) == pytest.approx(20.0 * np.sin(np.pi / 4))


def test_an_image_is_that_of_a_camera_mounted_so_and_blurs_while_it_tilts() -> None:
    world = world_of(plain_room(camera=camera_data(motion=MOTION)))
    scene, pose, t_ns = scene_of(world), np.array([0.0, 2.0, 0.1]), 250_000_000
    moved = scene.camera_at(t_ns)
    np.testing.assert_array_equal(radiance(scene, pose, moved), radiance(scene_of(world, moved), pose))
    still = Trajectory(np.array([0, 10**9]), np.stack([pose, pose]))
    image = world.image.model_copy(update={"exposure_s": 0.03})
    blurred = replace(scene, world=world.model_copy(update={"image": image}))
    turning, at_rest = (expose(blurred, still, t, np.random.default_rng(0)).astype(float) for t in (0, t_ns))
    sharp = expose(scene, still, 0, np.random.default_rng(0)).astype(float)
    steepest = [np.abs(np.diff(one, axis=0)).max() for one in (turning, sharp)]
    assert steepest[0] < 0.9 * steepest[1]  # 38°/s at time 0
    assert np.isfinite(at_rest).all()


@pytest.mark.parametrize("sigma_deg", [0.0, 0.5])
def test_the_log_states_the_mount_of_each_image(sigma_deg: float) -> None:
    data = plain_room(camera=camera_data(motion=MOTION | {"stated_sigma_deg": sigma_deg}))
    log = simulated_log(world_of(data), 3)
    true = [log.scene.camera_at(int(t_ns)).mount for t_ns in log.drive.image_t_ns]
    assert len(log.mounts) == len(log) == len(true)
    off = [stated.tilt_rad - mount.tilt_rad for stated, mount in zip(log.mounts, true, strict=True) if stated]
    assert len(off) == len(true)
    if sigma_deg == 0.0:
        assert list(log.mounts) == true
    else:
        assert 0.5 < np.degrees(np.std(off)) / sigma_deg < 1.5
        sigma = np.radians(sigma_deg)
        assert all(mount and mount.sigma == MountSigma(tilt_rad=sigma, roll_rad=sigma) for mount in log.mounts)
