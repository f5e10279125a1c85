"""A simulated camera that moves on the robot: what it sees, what the log states of it."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from plain_room import camera_data, plain_room

from localiser.camera import MountSigma
from localiser.geometry import Trajectory
from localiser.simulate import simulated_log, world_of
from localiser.simulate.drive import mount_at
from localiser.simulate.render import expose, radiance, scene_of

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


def test_a_camera_that_does_not_move_states_none() -> None:
    log = simulated_log(world_of(plain_room()), 3)
    assert set(log.mounts) == {None}
