"""What takes seconds when it is done for the first time, done before the first image waits for it."""

from __future__ import annotations

import numpy as np

from localiser.camera import Camera, Mount
from localiser.config import Config
from localiser.filter import Odometry, Start
from localiser.landmarks import LandmarkMap
from localiser.live.located import Filter
from localiser.live.timeline import Frame
from localiser.observation import EdgeObservation
from localiser.storage import encode_image
from localiser.storage.bags import Messages

_CAMERA = Camera(320, 240, 280.0, 280.0, 159.5, 119.5, Mount(tilt_rad=0.35, height_m=1.0), "plumb_bob", (-0.1,) * 5)


def warm_up(landmark_map: LandmarkMap, config: Config) -> None:
    """Take a filter of its own through two images of stripes: libraries are loaded, kernels compiled."""
    stripes = np.where(np.arange(_CAMERA.width) // 40 % 2, 200, 50).astype(np.uint8)
    file = encode_image(np.tile(stripes, (_CAMERA.height, 1)), ".jpg", 95)
    filter_ = Filter(
        _CAMERA,
        landmark_map,
        config,
        [],
        np.random.default_rng(0),
        EdgeObservation(_CAMERA, config.observation),
    )
    filter_.start(Start(0, np.array([*landmark_map.points.mean(axis=0), 0.0]), np.eye(3)))
    make = Messages()
    for number, t_ns in enumerate((1, 100_000_000, 200_000_000)):
        frame = Frame(number, t_ns, t_ns, 0, make.compressed(t_ns, file), by_wheels=number < 2)
        filter_.find_edges(frame)
        filter_.weigh(frame, [Odometry(t_ns, np.array([0.0, -0.1 * number, 0.0]))])
