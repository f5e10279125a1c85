"""Values of the mount are changed in place: nothing else of a camera file is."""

from __future__ import annotations

import numpy as np
import pytest
import yaml

from localiser.errors import InputError
from localiser.storage import camera_file, read_camera, update_mount

HEAD = """# front camera
image_width: 640
image_height: 480   # VGA
camera_matrix: {rows: 3, cols: 3, data: [500.0, 0, 320, 0, 500.0, 240, 0, 0, 1]}
"""
MOUNTS = {
    "flow": "mount: {tilt_deg: 18.0, roll_deg: 0.5, height_m: 0.8}  # by hand\n",
    "flow without roll": "mount: {height_m: 0.8, tilt_deg: 18}\n",
    "flow over lines": "mount: {height_m: 0.8,\n  tilt_deg: 18.0,\n  yaw_deg: 2}\n",
    "block": "mount:\n  tilt_deg: 18.0  # by hand\n  height_m: 0.8\n  roll_deg: 0\n",
    "block without roll": "mount:\n  height_m: 0.8  # to the lens\n  tilt_deg: 18.0 # by hand\n  yaw_deg: 2\n",
    "block without roll, tilt last": "mount:\n  height_m: 0.8\n  tilt_deg: 18.0",
    "value on its own line": "mount:\n  height_m: 0.8\n  tilt_deg:\n    18.0\n",
}


@pytest.mark.parametrize("name", MOUNTS)
def test_only_tilt_and_roll_change(tmp_path, name):
    path = tmp_path / "camera.yaml"
    path.write_text(HEAD + MOUNTS[name])
    kept = update_mount(path, {"tilt_deg": 20.25, "roll_deg": -1.5})
    assert kept.read_text() == HEAD + MOUNTS[name]
    before, after = yaml.safe_load(kept.read_text()), yaml.safe_load(path.read_text())
    before["mount"] |= {"tilt_deg": 20.25, "roll_deg": -1.5}
    assert after == before
    np.testing.assert_allclose(np.rad2deg(read_camera(path).mount.tilt_rad), 20.25)
    if "own line" not in name:
        comments = [line.split("#")[1] for line in (HEAD + MOUNTS[name]).splitlines() if "#" in line]
        assert all(f"#{comment}" in path.read_text() for comment in comments)


def test_what_is_no_camera_is_left_alone(tmp_path):
    path = tmp_path / "camera.yaml"
    path.write_text(HEAD)
    with pytest.raises(InputError, match="mount"):
        update_mount(path, {"tilt_deg": 20.0})
    assert path.read_text() == HEAD and list(tmp_path.iterdir()) == [path]


def test_a_value_that_no_camera_has_is_refused(tmp_path):
    path = tmp_path / "camera.yaml"
    path.write_text(HEAD + MOUNTS["flow"])
    with pytest.raises(InputError, match="tilt_deg"):
        update_mount(path, {"tilt_deg": 95.0})
    assert path.read_text() == HEAD + MOUNTS["flow"] and list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("content", ["camera: ../camera.yaml\n", "camera: [1]\n", "name: x\n"])
def test_a_log_must_name_its_camera_file(tmp_path, content):
    (tmp_path / "log.yaml").write_text(content)
    with pytest.raises(InputError, match="camera"):
        camera_file(tmp_path)
