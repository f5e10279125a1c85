"""`localiser map draw`: the floor plan of a simulated world."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated

import typer

from localiser.commands.map.options import Force, require_writable
from localiser.commands.options import Quiet


def draw(
    world: Annotated[Path, typer.Argument(metavar="WORLD", help="World file, such as configs/worlds/corridor.yaml.")],
    out: Annotated[Path, typer.Option("--out", "-o", metavar="PLAN", help="The plan: this YAML and a PGM beside it.")],
    resolution: Annotated[float, typer.Option(min=1e-3, max=1.0, metavar="M", help="Side of a cell.")] = 0.05,
    yaw_deg: Annotated[float, typer.Option(metavar="DEG", help="Turn of the grid, anticlockwise from ROS x.")] = 0.0,
    furniture: Annotated[bool, typer.Option("--furniture", help="Draw furniture, too.")] = False,
    force: Force = False,
    quiet: Quiet = False,
) -> None:
    """Draw the floor plan of a simulated WORLD for ROS map_server: walls, open doorways and pillars."""
    from localiser.commands.map.world_plan import draw_plan
    from localiser.storage import plan_picture, read_world, write_plan

    require_writable(out, plan_picture(out), overwrite=force)
    plan = draw_plan(read_world(world), resolution, math.radians(yaw_deg), furniture=furniture)
    picture = write_plan(plan, out)
    if not quiet:
        typer.echo(f"{plan.shape[1]}×{plan.shape[0]} cells of {resolution:g} m in {out} and {picture}")
