"""`localiser pose`: tell a live run where the robot is."""

from __future__ import annotations

import time
from contextlib import closing
from typing import TYPE_CHECKING, Annotated

import typer

from localiser.commands.options import ConfigFile, Overrides
from localiser.errors import InputError

if TYPE_CHECKING:
    from localiser.config import LiveParameters

pose_app = typer.Typer(no_args_is_help=True, help="Tell a live run where the robot is.")
PATIENCE_S = 3.0  # until a session that has just begun knows who listens
REPEATS, PAUSE_S = 5, 0.3  # of the same message, which a live run takes once


@pose_app.command("set", epilog="Example: `localiser pose set 1.5,-2,90 --sigma 0.5,10`")
def pose_set(
    pose: Annotated[str, typer.Argument(metavar="x,z,heading_deg", help="In the map: metres and degrees.")],
    sigma: Annotated[
        str, typer.Option(metavar="M,DEG", help="How far that may be off, one sigma: metres and degrees.")
    ] = "0.1,3",
    config: ConfigFile = None,
    overrides: Overrides = None,
) -> None:
    """Publish where the robot is, as a PoseWithCovarianceStamped; put a value that begins with a minus after `--`.

    The settings `live.*` say where, as for `localiser live`.
    """
    from localiser.config import read_config

    typer.echo(f"sent to {send_pose(pose, sigma, read_config(config, overrides or []).live)}", err=True)


def send_pose(pose: str, sigma: str, live: LiveParameters) -> str:
    """Publish a pose `x,z,heading_deg` with sigmas `m,deg`, and return on which topic.

    Raises InputError, also when nobody listens.
    """
    import numpy as np

    from localiser.live import Topic, input_topics, network_of, open_transport, prefix_of
    from localiser.replay import given_pose
    from localiser.storage.bags import Messages, RosType

    mean = given_pose(pose)
    try:
        sigma_m, sigma_deg = (float(part) for part in sigma.split(","))
    except ValueError:
        sigma_m = sigma_deg = -1.0
    if not (0 < sigma_m <= 1000 and 0 < sigma_deg <= 360):
        raise InputError(f"expected M,DEG above 0, such as 0.1,3, found {sigma!r}", field="--sigma")
    cov = np.diag([sigma_m, sigma_m, np.deg2rad(sigma_deg)]) ** 2
    make = Messages()
    content = make.encode(make.pose_in_map(time.time_ns(), mean, cov, live.map_frame))
    topic = Topic(input_topics(live.topics, prefix_of(live))["initialpose"], RosType.POSE)
    with closing(open_transport(live, "localiser_pose_set", wait=False)) as transport:
        end = time.monotonic() + PATIENCE_S
        while not transport.is_heard(topic):
            if time.monotonic() > end:
                raise InputError(f"expected a live run that listens to {topic.name}, found none at {network_of(live)}")
            time.sleep(0.05)
        for _ in range(REPEATS):  # who has just joined a network is not reached by all at once
            transport.publish(topic, content)
            time.sleep(PAUSE_S)
    return topic.name
