"""`localiser map build A B`: one map of several logs."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from far_room import CAMERA, far_poses, images, room
from map_commands import refused, run

from localiser.camera import Camera
from localiser.filter import Sighting
from localiser.geometry import Trajectory
from localiser.storage import read_map, write_log

OTHER = replace(CAMERA, fx=500.0, fy=500.0, mount=replace(CAMERA.mount, right_m=0.1, height_m=1.2))


def room_log(folder: Path, camera: Camera, seed: int) -> Path:
    """Write a log of edges in 45 images that are far apart in one room."""
    poses = far_poses(45, seed)
    edges = images(*room(0), poses, seed + 1, clutter=2, camera=camera)
    track = Trajectory(np.arange(45, dtype=np.int64) * 10**9, poses)
    sightings = [Sighting(int(t_ns), edge) for t_ns, edge in zip(track.t_ns, edges, strict=True)]
    write_log(folder, name=folder.name, camera=camera, odometry=track, sightings=sightings, groundtruth=track)
    return folder


@pytest.fixture(scope="module")
def logs(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    folder = tmp_path_factory.mktemp("room")
    return room_log(folder / "monday", CAMERA, 1), room_log(folder / "tuesday", OTHER, 11)


def test_two_cameras_on_two_days_make_one_map(logs: tuple[Path, Path], tmp_path: Path) -> None:
    found = []
    for names in (logs[:1], logs):
        built = run("map", "build", *names, "--poses", "truth", "-o", tmp_path / f"{len(names)}.yaml", "-q")
        assert built.exit_code == 0
        landmark_map = read_map(tmp_path / f"{len(names)}.yaml")
        apart = np.linalg.norm(landmark_map.points[:, None] - room(0)[0][None], axis=-1)
        assert (apart.min(axis=1) < 0.06).mean() > 0.9
        found.append(int((apart.min(axis=0) < 0.03).sum()))
    assert found[1] > found[0]
    assert found[1] >= 18
    assert set(landmark_map.source) == {"monday + tuesday, poses: truth"}


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--poses", "odometry"), "must share one frame"),
        (("--poses", "slam"), "must share one frame"),
        (("--trajectory", "path.tum"), "--trajectory"),
    ],
)
def test_several_logs_need_their_truth_and_write_no_path(
    logs: tuple[Path, Path], tmp_path: Path, options: tuple[str, str], message: str
) -> None:
    out = tmp_path / "map.yaml"
    options = tuple(str(tmp_path / word) if word.endswith(".tum") else word for word in options)
    assert message in refused("map", "build", *logs, "-o", out, *options)
    assert not out.exists()
