"""A mount that moves, and a shutter that rolls: one world gives one answer."""

from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from edge_images import camera_of, wall_image
from plain_likelihood import by_rate_plain

from localiser import open_log, replay_log
from localiser.camera import Camera, Mount, MountSigma, RollingShutter
from localiser.edges import CommonError, EdgeParameters, Edges, find_edges, foot_of_edges
from localiser.errors import InputError
from localiser.filter import Level, track_of
from localiser.geometry import UNKNOWN_TWIST, Array, Increment, compose
from localiser.landmarks import LandmarkMap
from localiser.live.timeline import Timeline
from localiser.localiser import Localiser
from localiser.observation import EdgeObservation, ObservationParameters, Sighting
from localiser.observation.clutter import EarlierFrame, persistent_clutter, scene_clutter
from localiser.particles import POSE, Particles
from localiser.simulate import world_of
from localiser.storage import ImageEvent, Log, simulate_log
from localiser.visual_odometry import Gaussian, TwoImages, follow

USUAL = camera_of(roll_deg=1.0, k1=-0.25)
MOVED = Mount(np.radians(26.0), 1.7, np.radians(-3.0), np.radians(15.0), 0.1, -0.3)
PLACES = np.array(
    [[x, z] for x, z in zip(np.linspace(-3.5, 3.5, 24), np.tile([-4.0, -3.0, -4.6, -3.4], 6), strict=True)]
)
MAP = LandmarkMap.from_points(PLACES, bottom_m=np.zeros(24), top_m=np.full(24, 0.9))


def seen(camera: Camera, mount: Mount | None, pose: Array, places: Array = PLACES) -> Edges:
    """Return the edges of all landmarks in view exactly as the camera sees them from a robot pose (3,)."""
    mounted = camera.at(mount)
    points = np.stack([places[:, [0, 0]], np.tile([0.0, 0.9], (len(places), 1)), places[:, [1, 1]]], axis=-1)
    ends_px = mounted.project(pose, points)
    inside = (ends_px > 3.0) & (ends_px < np.array([camera.width, camera.height]) - 4.0)
    ends_px = ends_px[inside.all(axis=(1, 2))]
    bearing = mounted.bearing_of_segments(ends_px)
    foot = foot_of_edges(ends_px[:, 0], mounted)
    jacobians = mounted.bearing_jacobians(bearing, mounted.upright_from_pixels(ends_px).mean(axis=1)[:, 1])
    edges = Edges.from_columns(
        bearing,
        np.full(len(bearing), 2e-3),
        mounted.lean_of_segments(ends_px),
        np.full(len(bearing), 2e-3),
        length_px=np.linalg.norm(ends_px[:, 1] - ends_px[:, 0], axis=-1),
        ends_px=ends_px,
        foot_range_m=foot[0],
        foot_range_sigma_m=foot[1],
        common=CommonError(("tilt", "roll"), np.diag([1e-8, 1e-8]), *jacobians),
    )
    assert len(edges) >= min(len(places), 5)
    return replace(edges, mount=mount)


def test_edges_of_an_image_are_those_of_a_camera_mounted_so() -> None:
    mounted = USUAL.at(MOVED)
    image = wall_image(mounted, [-20.0, -8.0, 3.0, 14.0], [60.0, 120.0, 70.0, 150.0, 110.0], noise_sigma=1.0)
    expected, found = find_edges(image, mounted), find_edges(image, USUAL, mount=MOVED)
    assert found.mount == MOVED and expected.mount is None
    np.testing.assert_array_equal(found.bearing, expected.bearing)
    np.testing.assert_array_equal(found.foot_range_m, expected.foot_range_m)
    assert len(find_edges(image, USUAL)) < len(found)


def test_the_usual_mount_is_the_camera_itself() -> None:
    assert USUAL.at(None) is USUAL and USUAL.at(replace(USUAL.mount)) is USUAL
    assert USUAL.at(MOVED) is USUAL.at(replace(MOVED))


def test_sigmas_of_the_mount_are_those_of_the_image() -> None:
    sigma = MountSigma(tilt_rad=0.001, yaw_rad=0.02, back_m=0.1)
    image = wall_image(USUAL, [-10.0, 5.0], [60.0, 120.0, 70.0])
    common = find_edges(image, USUAL, mount=replace(USUAL.mount, sigma=sigma)).common
    assert common.names == ("tilt", "roll", "yaw", "back")
    usual = np.radians(EdgeParameters().roll_sigma_deg)
    np.testing.assert_allclose(np.sqrt(np.diag(common.cov)), [0.001, usual, 0.02, 0.1])
    np.testing.assert_array_equal(common.bearing_from_line[:, 2], 1.0)


@pytest.mark.parametrize("kind", ["line", "slope"])
def test_particles_are_weighed_by_the_mount_of_the_image(kind) -> None:
    pose = np.array([0.1, -0.2, 0.1])
    observation = EdgeObservation(USUAL, ObservationParameters(kind=kind))
    cloud = Particles(
        POSE, np.stack([pose, pose + np.array([0.0, 0.0, 0.2]), pose + np.array([0.3, 0.0, 0.0])], axis=1), np.zeros(3)
    )
    sighting = Sighting(0, seen(USUAL, MOVED, pose))
    by_rate = observation.by_rate(cloud, sighting, MAP)
    np.testing.assert_allclose(by_rate, by_rate_plain(observation, cloud, sighting, MAP), atol=0.05)
    alone = EdgeObservation(USUAL.at(MOVED), observation.parameters)
    np.testing.assert_array_equal(by_rate, alone.by_rate(cloud, Sighting(0, replace(sighting.edges, mount=None)), MAP))
    assert by_rate[-2].argmax() == 0
    assert (observation.associate(pose, sighting, MAP).matches().landmark >= 0).all()


def test_edges_continue_those_of_an_image_under_another_mount() -> None:
    observation = EdgeObservation(USUAL, ObservationParameters())
    pose, move, few = np.zeros(3), np.array([0.0, -0.05, 0.05]), PLACES[[12]]
    turned = replace(USUAL.mount, tilt_rad=np.radians(22.0), roll_rad=MOVED.roll_rad, yaw_rad=MOVED.yaw_rad)
    before = seen(USUAL, turned, pose, few)
    now = observation.frame(seen(USUAL, None, compose(pose, move), few))
    increment = Increment(move, np.zeros((3, 3)), 0.05, 0.05)

    def densities(edges: Edges) -> list[float]:
        earlier = EarlierFrame.of(observation.frame(edges), now, increment, 1e-4)
        return [float(persistent_clutter(now, earlier).max()), *scene_clutter(now, [earlier])[0]]

    forgotten = replace(before, mount=None)  # as if the camera had not been turned
    for right, wrong in zip(densities(before), densities(forgotten), strict=True):
        assert right > 2.0 * wrong


def test_motion_between_images_under_two_mounts() -> None:
    move = np.array([0.05, -0.2, 0.1])
    later = replace(MOVED, height_m=1.4, yaw_rad=np.radians(-5.0), right_m=-0.1, tilt_rad=np.radians(20.0))
    images = TwoImages.of(seen(USUAL, MOVED, np.zeros(3)), seen(USUAL, later, move), USUAL)
    prior = Gaussian(np.array([0.0, -0.2, 0.0]), np.diag([0.1, 0.1, 0.2]) ** 2)
    found = follow(images, [(prior, 0.0)])
    np.testing.assert_allclose(found.mean, move, atol=0.02)


def test_a_tilt_that_was_measured_for_one_image_tells_nothing_of_the_next() -> None:
    off = replace(USUAL.mount, tilt_rad=USUAL.mount.tilt_rad + 0.01)
    edges = seen(USUAL, None, np.zeros(3))
    believed = USUAL.at(off)
    level = Level(believed, 0.005)
    wrong = replace(
        edges, bearing=believed.bearing_of_segments(edges.ends_px), lean=believed.lean_of_segments(edges.ends_px)
    )
    common = replace(wrong.common, cov=np.diag([0.01, 0.001]) ** 2)
    _, kept = level.levelled(None, replace(wrong, common=common), 0.0, 1.0)
    assert kept is not None and kept.mean[0] == pytest.approx(-0.01, abs=0.003)
    measured = replace(USUAL.mount, sigma=MountSigma(tilt_rad=0.01, roll_rad=0.001))
    _, renewed = level.levelled(kept, replace(edges, mount=measured, common=common), 0.0, 0.1)
    assert renewed is not None and renewed.mean[0] == pytest.approx(0.0, abs=0.003)
    stated = replace(edges, mount=USUAL.mount, common=common)  # another tilt than the usual one, without a sigma
    assert level.levelled(kept, stated, 0.1, 1.0) == (stated, kept)


def test_images_with_and_without_a_mount_are_located_by_one_localiser() -> None:
    localiser = Localiser(MAP, USUAL, seed=1)
    localiser.start(np.zeros(3), np.diag([0.05, 0.05, 0.02]) ** 2, 0)
    frames = []
    for index, mount in enumerate([None, MOVED, None, replace(MOVED, yaw_rad=-0.2)]):
        pose, t_ns = np.array([0.0, -0.1 * index, 0.0]), 10**8 * (index + 1)
        frames += localiser.odometry(t_ns, pose)
        frames += localiser.edges(t_ns, replace(seen(USUAL, mount, pose), mount=None), mount)
    assert [frame.located.edges.mount for frame in frames] == [None, MOVED, None, replace(MOVED, yaw_rad=-0.2)]
    for index, frame in enumerate(frames):
        error = frame.located.estimate.pose - [0.0, -0.1 * index, 0.0]
        assert np.hypot(*error[:2]) < 0.05 and abs(error[2]) < 0.02
    content = localiser.save()
    localiser.restore(content)
    assert localiser.state.seen is not None and localiser.state.seen.edges.mount == replace(MOVED, yaw_rad=-0.2)


@pytest.mark.parametrize(
    ("mount", "field"),
    [
        ("down", "mount"),
        (replace(MOVED, tilt_rad=np.nan), "mount.tilt_rad"),
        (replace(MOVED, tilt_rad=1.6), "mount.tilt_rad"),
        (replace(MOVED, height_m=0.0), "mount.height_m"),
        (replace(MOVED, sigma=MountSigma(roll_rad=-1.0)), "mount.sigma.roll_rad"),
    ],
)
def test_a_mount_that_cannot_be_is_refused(mount, field) -> None:
    with pytest.raises(InputError) as error:
        Localiser(MAP, USUAL, seed=1).measure(np.zeros((USUAL.height, USUAL.width), dtype=np.uint8), mount)
    assert error.value.field == field


ROOT = Path(__file__).resolve().parents[1]
SHUTTER = RollingShutter(30e-3 / 479)


@pytest.fixture(scope="module")
def log() -> Log:
    recorded = open_log(ROOT / "logs" / "corridor")
    return replace(recorded, camera=replace(recorded.camera, shutter=SHUTTER))


def test_a_log_and_a_live_run_tell_the_same_motion(log: Log) -> None:
    """Each knows the wheels' poses up to the first one at or after the image."""
    timeline = Timeline(lambda _: None)
    image = log.frames[20]
    until = int(np.searchsorted(log.odometry.t_ns, image.t_ns)) + 1
    for number, (t_ns, pose) in enumerate(zip(log.odometry.t_ns[:until], log.odometry.poses[:until], strict=True)):
        timeline.add_odometry(int(t_ns), number, pose, 0)
    told = log.twist_at(image.t_ns)
    assert told is not None and abs(told.backward_m_s) > 0.3
    assert log.camera.twist_at(timeline.track, image.t_ns) == told


def test_nothing_is_asked_of_the_wheels_where_all_rows_are_taken_at_once(log: Log) -> None:
    plain = replace(log, camera=replace(log.camera, shutter=None))
    assert plain.twist_at(log.frames[20].t_ns) is None


def test_an_image_is_measured_by_the_motion_that_the_wheels_tell(log: Log) -> None:
    assert log.landmark_map is not None
    robot = Localiser(log.landmark_map, log.camera, seed=0)
    image = log.frames[20]
    robot.start(log.start.mean, log.start.cov, int(log.odometry.t_ns[0]))
    for t_ns, pose in zip(log.odometry.t_ns, log.odometry.poses, strict=True):
        if t_ns < image.t_ns:
            robot.odometry(int(t_ns), pose)
    twist = log.camera.twist_at(track_of(robot.state.odometry), image.t_ns)
    assert twist is not None and twist != UNKNOWN_TWIST
    robot.image(image.t_ns, image.load())  # type: ignore[union-attr]
    (waiting,) = robot.state.waiting
    expected = find_edges(image.load(), log.camera, robot.config.edges, twist=twist)  # type: ignore[union-attr]
    np.testing.assert_array_equal(waiting.edges.bearing, expected.bearing)
    assert expected.common.names[-1] == "turn rate"


def bends(shutter: dict[str, Any] | None) -> Log:
    """Return the log of a short drive down the corridor that bends at 1 rad/s."""
    world = yaml.safe_load((ROOT / "configs" / "worlds" / "corridor.yaml").read_text())
    way = [(0.1, 0.7, 0.0), (-0.3, -0.9, 0.5), (0.3, -2.5, 0.5), (0.0, -4.0, 0.0)]
    world["drive"]["path"] = [{"to": [x, z], "corner_radius_m": radius} for x, z, radius in way]
    world["drive"] |= {"end_turn_deg": -90.0, "turn_deg_s": 57.3}
    world["image"] |= {"colour": False}
    world["camera"] |= {"width": 320, "height": 240, "focal_px": 277.0}
    world["camera"] |= {"rolling_shutter": shutter} if shutter else {}
    log = simulate_log(world_of(world), 0)
    frames = [replace(frame, load=cache(frame.load)) for frame in log.frames if isinstance(frame, ImageEvent)]
    return replace(log, frames=frames)  # rendered once for all replays


@pytest.mark.slow
def test_a_drive_is_as_accurate_as_with_all_rows_at_once_if_the_shutter_is_stated() -> None:
    row_time = {"row_time_us": 30e3 / 239}
    rows = bends(row_time)
    at_once = replace(rows, camera=replace(rows.camera, shutter=None))
    plain, stated = ([replay_log(drive, seed=seed).metrics for seed in range(12)] for drive in (bends(None), rows))

    def ratio(name: str) -> float:
        """Return how much larger the error is than with all rows at once; one seed alone says up to 0.15 more."""
        return float(np.mean([one[name] for one in stated]) / np.mean([one[name] for one in plain]))

    assert ratio("position_rmse_m") < 1.7 and ratio("heading_rmse_deg") < 1.3  # 1.35 and 1.29
    assert all(one["nees_mean"] < 2.0 and one["confidence"]["sure_and_wrong"] == 0.0 for one in stated)
    assert replay_log(at_once, seed=0).metrics["heading_rmse_deg"] > 1.5 * stated[0]["heading_rmse_deg"]
