"""What images truly show, and whole simulated logs."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from folders import ROOT

from localiser.errors import InputError
from localiser.simulate import World, simulated_log, structure_of, visible_landmarks, world_of

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
