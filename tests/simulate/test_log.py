"""What images truly show, and whole simulated logs; cameras that move on the robot, or whose shutter rolls."""

import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from folders import ROOT
from plain_room import camera_data, plain_room

from localiser.camera import MountSigma, RollingShutter
from localiser.errors import InputError
from localiser.geometry import Array, Trajectory, arc_motion, compose
from localiser.simulate import World, simulated_log, structure_of, visible_landmarks, world_of
from localiser.simulate.drive import mount_at
from localiser.simulate.render import Scene, expose, radiance, scene_of, sharp_image

PLAIN = {"texture": "plain", "colour": [200, 200, 200]}
BOX = {"width_m": 0.3, "depth_m": 0.3, "material": "wall"}


def world(**changes: Any) -> World:
    camera = {
        "width": 160,
        "height": 120,
        "focal_px": 138.0,
        "mount": {"tilt_deg": 20.0, "height_m": 0.9},
        **changes.pop("camera", {}),
    }
    return world_of(
        {
            "format": "localiser-world/1",
            "name": "test",
            "materials": {"wall": PLAIN, "frame": PLAIN, "floor": PLAIN},
            "floor": {"material": "floor"},
            "ceiling": {"material": "floor"},
            "camera": camera,
            "drive": {"path": [{"to": [0.0, 0.0]}, {"to": [0.0, -1.0]}], "image_offset_s": 0.013},
            "odometry": {"heading_walk_deg_per_sqrt_m": 2.0},
            **changes,
        }
    )


def shown(scenery: World, pose: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> dict[tuple[float, float], float]:
    """Return the visible fraction of each landmark that is seen, by its place."""
    structure = structure_of(scenery)
    seen = visible_landmarks(structure, scenery.camera.camera(), np.array(pose))
    points = np.round(structure.landmark_map.points[seen.landmark], 3).tolist()
    return dict(zip(map(tuple, points), seen.fraction.tolist(), strict=True))


# -- what is visible --------------------------------------------------------------------------------------------------


def test_a_box_shows_its_near_edges_and_hides_its_far_ones() -> None:
    seen = shown(world(furniture=[{**BOX, "x": 0.0, "z": -3.0, "top_m": 1.0}]))
    assert set(seen) == {(-0.15, -2.85), (0.15, -2.85)}
    np.testing.assert_allclose(list(seen.values()), 1.0)


def test_of_a_higher_box_behind_a_lower_one_the_upper_part_is_seen() -> None:
    front = {**BOX, "x": 0.0, "z": -2.0, "width_m": 1.0, "top_m": 0.45}
    behind = {**BOX, "x": 0.0, "z": -4.0, "top_m": 0.9}
    seen = shown(world(furniture=[front, behind]))
    # The line of sight over the front box's far upper edge: from 0.9 m down to 0.45 m at 2.15 m, onwards to 3.85 m.
    hidden = 0.9 - 0.45 / 2.15 * 3.85
    assert seen[(0.15, -3.85)] == pytest.approx((0.9 - hidden) / 0.9, abs=0.02)


def test_ends_are_where_the_camera_projects_them() -> None:
    scenery = world(furniture=[{**BOX, "x": 0.4, "z": -3.0, "top_m": 0.8}])
    camera, pose = scenery.camera.camera(), np.array([0.1, 0.2, 0.1])
    structure = structure_of(scenery)
    seen = visible_landmarks(structure, camera, pose)
    assert len(seen) == 3
    for landmark, ends in zip(seen.landmark, seen.ends_px, strict=True):
        x, z = structure.landmark_map.points[landmark]
        np.testing.assert_allclose(ends, camera.project(pose, np.array([[x, 0.0, z], [x, 0.8, z]])), atol=1e-6)


# -- logs -------------------------------------------------------------------------------------------------------------

ROOM = {
    "walls": [{"from": [-1, 1], "to": [-1, -4]}, {"from": [-1, -4], "to": [1, -4]}, {"from": [1, -4], "to": [1, 1]}],
    "furniture": [{**BOX, "x": 0.5, "z": -2.5, "top_m": 0.5}],
}


def test_a_log_is_the_same_for_the_same_seed_and_another_for_another() -> None:
    one, two, other = (simulated_log(world(**ROOM), seed) for seed in (3, 3, 4))
    np.testing.assert_array_equal(one.drive.odometry.poses, two.drive.odometry.poses)
    np.testing.assert_array_equal(one.start, two.start)
    np.testing.assert_array_equal([one.image(index) for index in range(3)][2], two.image(2))
    assert (one.drive.odometry.poses[-1] != other.drive.odometry.poses[-1]).any()
    assert (one.start != other.start).all()
    assert (one.image(2) != other.image(2)).any()


def test_images_are_taken_at_their_rate_while_the_truth_is_known() -> None:
    log = simulated_log(world(**ROOM, image={"exposure_s": 0.03}), 0)
    times = log.drive.image_t_ns
    assert times[0] == 15_000_000, "the first exposure begins with the truth"
    assert (np.diff(times) == 200_000_000).all()
    assert log.drive.truth.covers(int(times[-1]) + 15_000_000)
    assert len(log) == len(log.visible) == 10
    with pytest.raises(InputError, match=r"drive.image_offset_s: expected a first image by 0.95 s"):
        simulated_log(world(**ROOM, image={"exposure_s": 2.1}), 0)


def test_the_map_holds_what_at_least_five_images_show() -> None:
    log = simulated_log(world(**ROOM), 0)
    count = np.bincount(np.concatenate([shown.landmark for shown in log.visible]))
    assert log.landmark_map.ids == tuple(np.flatnonzero(count >= 5).tolist())
    everything = structure_of(world(**ROOM)).landmark_map
    np.testing.assert_array_equal(log.landmark_map.points, everything.points[list(log.landmark_map.ids)])


@pytest.mark.slow
def test_the_stated_start_errs_by_its_stated_sigmas() -> None:
    scenery = world(camera={"width": 16, "height": 16}, drive={"path": [{"to": [0, 0]}, {"to": [0, -0.1]}]})
    logs = [simulated_log(scenery, seed) for seed in range(30)]
    first = logs[0].drive.truth.at(int(logs[0].drive.image_t_ns[0]))
    scores = np.array([(log.start - first) / np.sqrt(np.diag(log.start_cov)) for log in logs])
    np.testing.assert_allclose(scores.std(axis=0), 1.0, atol=0.4)
    np.testing.assert_allclose(np.sqrt(np.diag(logs[0].start_cov)), [0.1, 0.1, np.deg2rad(3)])


def test_a_drive_through_a_wall_is_refused_with_its_place() -> None:
    with pytest.raises(InputError, match=r"robot at least 0\.15 m .* x = 0\.00, z = -0\.70"):
        simulated_log(world(walls=[{"from": [-1, -0.7], "to": [1, -0.7]}]), 0)


@pytest.mark.skipif(os.name == "nt", reason="Windows ends a process without asking it")
@pytest.mark.slow
@pytest.mark.parametrize("name", ["SIGTERM", "SIGHUP"])
def test_simulation_that_is_terminated_leaves_nothing_behind(tmp_path: Path, name: str) -> None:
    world = ROOT / "configs" / "worlds" / "corridor.yaml"
    process = subprocess.Popen([sys.executable, "-m", "localiser", "simulate", world, "-q", "-o", tmp_path / "log"])
    try:
        while process.poll() is None and not any(tmp_path.glob(".*.part/images/*")):
            time.sleep(0.01)
        process.send_signal(getattr(signal, name))
        assert process.wait(60) == 128 + getattr(signal, name)
    finally:
        process.kill()
    assert list(tmp_path.iterdir()) == []


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
def test_rows_are_those_of_images_from_where_the_robot_was_then(turn_rad_s, speed_m_s, motion):
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
