"""What takes seconds when it is done for the first time, done before the first image waits for it."""

from __future__ import annotations

import numpy as np

from localiser.camera import Camera, Mount
from localiser.config import Config
from localiser.landmarks import LandmarkMap
from localiser.localiser import Localiser
from localiser.storage import encode_image

_CAMERA = Camera(320, 240, 280.0, 280.0, 159.5, 119.5, Mount(tilt_rad=0.35, height_m=1.0), "plumb_bob", (-0.1,) * 5)


def warm_up(landmark_map: LandmarkMap, config: Config) -> None:
    """Take a localiser of its own through images of stripes: libraries are loaded, loops compiled."""
    stripes = np.where(np.arange(_CAMERA.width) // 40 % 2, 200, 50).astype(np.uint8)
    file = encode_image(np.tile(stripes, (_CAMERA.height, 1)), ".jpg", 95)
    localiser = Localiser(landmark_map, _CAMERA, config)
    localiser.warm_up()
    localiser.start([*landmark_map.points.mean(axis=0), 0.0], np.eye(3))
    for number, t_ns in enumerate((1, 100_000_000, 200_000_000)):
        localiser.odometry(t_ns, [0.0, -0.1 * number, 0.0])
        localiser.image(t_ns, file, by_wheels=number < 2)
