"""Run `localiser map` in this process, and a log of edges to run it on."""

from pathlib import Path

import numpy as np
from mapping_worlds import world
from typer.testing import CliRunner, Result

from localiser.commands import app
from localiser.edges import Edges
from localiser.errors import LocaliserError
from localiser.filter import mcl
from localiser.geometry import Trajectory
from localiser.storage import write_log


def run(*arguments: object) -> Result:
    """Run a command; errors that a user sees become the output, as in `main`. Options of the program come first."""
    of_all = [argument for argument in arguments if argument == "-q"]
    rest = [str(argument) for argument in arguments if argument != "-q"]
    result = CliRunner().invoke(app, [*of_all, *rest])
    if result.exception is not None and not isinstance(result.exception, SystemExit | LocaliserError):
        raise result.exception
    return result


def refused(*arguments: object) -> str:
    """Return the message of a command that must be refused."""
    result = run(*arguments)
    assert isinstance(result.exception, LocaliserError), result.output
    assert result.exception.exit_code == 2
    return str(result.exception)


def edge_log(
    folder: Path, edges: list[Edges], poses: np.ndarray | None = None, truth: bool = True, frames: int | None = None
) -> Path:
    """Write a log of edges of the corridor's drive, perhaps with other poses than the true ones."""
    drive = world("corridor")
    frames = frames or len(edges)
    t_ns = drive.truth.t_ns[:frames]
    track = Trajectory(t_ns, drive.truth.poses[:frames] if poses is None else poses[:frames])
    write_log(
        folder,
        name="drive",
        camera=drive.camera,
        odometry=track,
        sightings=[mcl.Sighting(int(t), edge) for t, edge in zip(t_ns, edges, strict=False)],
        groundtruth=track if truth else None,
    )
    return folder
