"""Send the pose of a robot to all listeners."""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from localiser.errors import InputError
from localiser.live.sources import Network
from localiser.replay import given_pose
from localiser.storage.bags import Messages

_PATIENCE_S = 3.0  # until a session that has just begun knows who listens
_REPEATS, _PAUSE_S = 5, 0.3  # of the same message, which a live run takes once


def send_pose(pose: str, sigma: str, connect: Sequence[str], topic: str, zenoh_config: Path | None = None) -> None:
    """Publish a pose `x,z,heading_deg` with sigmas `m,deg`. Raises InputError, also when nobody listens."""
    mean = given_pose(pose)
    try:
        sigma_m, sigma_deg = (float(part) for part in sigma.split(","))
    except ValueError:
        sigma_m = sigma_deg = -1.0
    if not (0 < sigma_m <= 1000 and 0 < sigma_deg <= 360):
        raise InputError(f"expected M,DEG above 0, such as 0.1,3, found {sigma!r}", field="--sigma")
    cov = np.diag([sigma_m, sigma_m, np.deg2rad(sigma_deg)]) ** 2
    make = Messages()
    content = make.encode(make.pose_in_map(time.time_ns(), mean, cov))
    with Network(connect, client=True, config_file=zenoh_config) as network:
        end = time.monotonic() + _PATIENCE_S
        while not network.is_heard(topic):
            if time.monotonic() > end:
                raise InputError(f"expected a live run that listens to {topic}, found none at {', '.join(connect)}")
            time.sleep(0.05)
        for _ in range(_REPEATS):  # who has just joined a network is not reached by all at once
            network.publish(topic, content)
            time.sleep(_PAUSE_S)
