"""`localiser pose`: tell a live run where the robot is."""

from __future__ import annotations

from typing import Annotated

import typer

from localiser.commands.options import (
    Connect,
    Dds,
    Distro,
    Domain,
    Interface,
    Namespace,
    ZenohConfig,
    network_of,
)

pose_app = typer.Typer(no_args_is_help=True, help="Tell a live run where the robot is.")


@pose_app.command("set", epilog="Example: `localiser pose set 1.5,-2,90 --sigma 0.5,10`")
def pose_set(
    pose: Annotated[str, typer.Argument(metavar="x,z,heading_deg", help="In the map: metres and degrees.")],
    sigma: Annotated[
        str, typer.Option(metavar="M,DEG", help="How far that may be off, one sigma: metres and degrees.")
    ] = "0.1,3",
    connect: Connect = None,
    topic: Annotated[
        str | None, typer.Option(metavar="NAME", help="Where live runs listen for poses; /initialpose.")
    ] = None,
    frame: Annotated[
        str, typer.Option(metavar="NAME", help="The map's frame, where live runs have another by `--frame map=NAME`.")
    ] = "map",
    domain: Domain = None,
    namespace: Namespace = "",
    distro: Distro = None,
    dds: Dds = None,
    interface: Interface = "lo",
    zenoh_config: ZenohConfig = None,
) -> None:
    """Publish where the robot is, as a PoseWithCovarianceStamped; put a value that begins with a minus after `--`."""
    from localiser.live import send_pose
    from localiser.ros import topic_in

    network = network_of(connect, None, zenoh_config, domain, namespace, distro, dds, interface)
    name = topic_in(network.prefix, topic or "initialpose")
    send_pose(pose, sigma, network, name, frame)
    typer.echo(f"sent to {name}", err=True)
