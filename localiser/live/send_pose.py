"""Send the pose of a robot to all listeners."""

from __future__ import annotations

import time
from contextlib import closing

import numpy as np

from localiser.errors import InputError
from localiser.live.transports import NetworkOptions, Topic, open_transport
from localiser.replay import given_pose
from localiser.storage.bags import MAP, POSE, Messages

_PATIENCE_S = 3.0  # until a session that has just begun knows who listens
_REPEATS, _PAUSE_S = 5, 0.3  # of the same message, which a live run takes once


def send_pose(pose: str, sigma: str, network: NetworkOptions, name: str, frame: str = MAP) -> None:
    """Publish a pose `x,z,heading_deg` with sigmas `m,deg` on the topic `name`. frame: the map's.

    Raises InputError, also when nobody listens.
    """
    mean = given_pose(pose)
    try:
        sigma_m, sigma_deg = (float(part) for part in sigma.split(","))
    except ValueError:
        sigma_m = sigma_deg = -1.0
    if not (0 < sigma_m <= 1000 and 0 < sigma_deg <= 360):
        raise InputError(f"expected M,DEG above 0, such as 0.1,3, found {sigma!r}", field="--sigma")
    cov = np.diag([sigma_m, sigma_m, np.deg2rad(sigma_deg)]) ** 2
    make = Messages()
    content = make.encode(make.pose_in_map(time.time_ns(), mean, cov, frame))
    topic = Topic(name, POSE)
    with closing(open_transport(network, "localiser_pose_set", wait=False)) as transport:
        end = time.monotonic() + _PATIENCE_S
        while not transport.is_heard(topic):
            if time.monotonic() > end:
                raise InputError(
                    f"expected a live run that listens to {name}, found none at {', '.join(network.connect)}"
                )
            time.sleep(0.05)
        for _ in range(_REPEATS):  # who has just joined a network is not reached by all at once
            transport.publish(topic, content)
            time.sleep(_PAUSE_S)
