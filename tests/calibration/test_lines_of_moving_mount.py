"""Lines of a camera that moves on the robot: the error of its usual mount is the same in every image."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from edge_images import camera_of, wall_image

from localiser.calibration import check_mount
from localiser.edges import find_edges


def test_edges_agree_with_mounts_that_move() -> None:
    camera, frames = camera_of(), []
    for tilt_deg, roll_deg in ((14.0, 2.0), (20.0, -1.0), (26.0, 0.0)):
        mount = replace(camera.mount, tilt_rad=np.radians(tilt_deg), roll_rad=np.radians(roll_deg))
        image = wall_image(camera.at(mount), [-20.0, -8.0, 3.0, 14.0], [60.0, 120.0, 70.0, 150.0, 110.0])
        frames.append(find_edges(image, camera, mount=mount))
    poses = np.arange(3.0)[:, None] * [0.0, -1.0, 0.5]
    check = check_mount(frames, poses, camera, np.radians([0.5, 0.3]))
    np.testing.assert_allclose(check.found, check.stated, atol=1e-3)
    assert not check.disagrees
    forgotten = [replace(edges, mount=None) for edges in frames]
    assert np.abs(check_mount(forgotten, poses, camera, np.radians([0.5, 0.3])).found - check.stated).max() > 1e-3
