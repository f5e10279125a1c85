"""`localiser odometry`: how good a robot's odometry is, from its drives with a truth or with a map."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from localiser.commands.options import ConfigFile, Overrides, is_quiet, open_with_settings, progress, show, warn
from localiser.errors import InputError

if TYPE_CHECKING:
    from localiser.calibration import ClockOffset, Drive, OdometryFit
    from localiser.config import Config
    from localiser.storage import Log

TRUTH, FILTER = "truth", "filter"
_BIAS = ("distance_sigma", "turn_sigma", "veer_sigma_deg_per_m")

odometry_app = typer.Typer(
    no_args_is_help=True, help="Find out how good the robot's odometry is.", rich_markup_mode="markdown"
)


@odometry_app.command(
    epilog="""Examples:

`localiser odometry fit logs/corridor`

`localiser odometry fit monday tuesday -o robot.yaml`, then `localiser replay wednesday --config robot.yaml`"""
)
def fit(
    logs: Annotated[list[Path], typer.Argument(metavar="LOG…", help="Logs of one robot, with a truth, or with a map.")],
    out: Annotated[
        Path | None, typer.Option("--out", "-o", metavar="FILE", help="Write a new configuration with what was found.")
    ] = None,
    map_file: Annotated[
        Path | None, typer.Option("--map", metavar="MAP", help="Landmark map, in place of the logs' own.")
    ] = None,
    config: ConfigFile = None,
    overrides: Overrides = None,
) -> None:
    """Find the noise of a robot's odometry and its constant errors from LOGS, and say what they would change."""
    from localiser.calibration import fit_odometry
    from localiser.config import read_config
    from localiser.storage import require_new_file, write_text

    if out is not None:
        require_new_file(out)
    settings = read_config(config, overrides or [])
    drives = []
    with progress("Reading", len(logs)) as advance:
        for path in logs:
            drives.append(drive_of(*open_with_settings(path, config, overrides), map_file))
            advance()
    found = fit_odometry([checked.drive for checked in drives], settings.motion)
    if found is None:
        names = ", ".join(checked.drive.name for checked in drives)
        raise InputError(f"expected ten metres or ten radians of driving at least, found less in {names}", field="LOG")
    if not is_quiet():
        _show(drives, found)
    if out is not None:
        write_text(out, to_yaml(drives, found))
        typer.echo(f"Written to {out}; use it with --config {out}")


@dataclass(frozen=True, slots=True, eq=False)
class Checked:
    """A drive on the clock of its wheels. by: what its path is from. clock: how much later that was stamped."""

    drive: Drive
    by: str
    clock: ClockOffset


def drive_of(log: Log, config: Config, map_file: Path | None = None) -> Checked:
    """Return the drive of a log, its path from the truth or the filter, on the clock of the wheels. Raises InputError.

    The filter's path is by the clocks of both.
    """
    from itertools import groupby

    import numpy as np

    from localiser.calibration import ClockOffset, Drive, on_one_clock, smooth_path
    from localiser.filter import SURE
    from localiser.geometry import Trajectory
    from localiser.replay import prepare
    from localiser.storage import require_odometry

    require_odometry(log, "fitting it")
    if log.groundtruth is not None:
        drive, clock = on_one_clock(Drive(log.name, log.odometry, log.groundtruth))
        return Checked(drive, TRUTH, clock)
    ready = prepare(log, config, map_files=[map_file] if map_file else ())
    ready.run()
    runs = [
        list(run)
        for sure, run in groupby((frame.located for frame in ready.frames), lambda at: at.p_correct > SURE)
        if sure
    ]
    located = max(runs, key=len, default=[])
    if len(located) < 2:
        raise InputError("the robot was not found on the map, so its path is not known", path=log.path)
    poses = np.array([at.estimate.pose for at in located])
    covs = np.array([at.estimate.pose_cov for at in located])
    path, cov = smooth_path(poses, covs, [at.increment for at in located[1:]], config.motion)
    times = np.array([at.t_ns for at in located], dtype=np.int64)
    drive = Drive(log.name, log.odometry, Trajectory(times, path), cov)
    return Checked(drive, FILTER, ClockOffset(0.0, np.inf, 0.0, 0))


def to_yaml(drives: list[Checked], found: OdometryFit) -> str:
    """Return the configuration file: what was found, and nothing else."""
    from localiser.calibration import ALPHAS
    from localiser.documents import dump

    names = ", ".join(f"{checked.drive.name} ({checked.by})" for checked in drives)
    bias = {name: float(f"{getattr(found.motion.bias, name):.4g}") for name in _BIAS}
    values = {name: float(f"{getattr(found.motion, name):.4g}") for name in ALPHAS}
    return f"# Odometry, fitted to: {names}\n{dump({'motion': {**values, 'bias': bias}})}"


def _show(drives: list[Checked], found: OdometryFit) -> None:
    import numpy as np

    from localiser.calibration import ALPHAS
    from localiser.evaluate import new_table

    columns = ("drive", "by", "metres", "turned (°)", "distance (%)", "turn (%)", "veer (°/m)")
    table = new_table("", *columns, texts=2)
    units = np.array([100.0, 100.0, np.rad2deg(1.0)])
    for index, checked in enumerate(drives):
        own = found.pieces.drive == index
        path_m, turned_deg = found.pieces.path_m[own].sum(), np.rad2deg(found.pieces.turned_rad[own].sum())
        pairs = zip(found.constants[index] * units, found.sigmas[index] * units, strict=True)
        cells = [f"{value:+.2f} ± {sigma:.2f}" for value, sigma in pairs]
        table.add_row(checked.drive.name, checked.by, f"{path_m:.1f}", f"{turned_deg:.0f}", *cells)
    show(table)
    typer.echo()
    table = new_table("", "motion.", "now", "found", "1σ")
    for name, factor in zip(ALPHAS, found.factor, strict=True):
        values = (getattr(motion, name) for motion in (found.before, found.motion))
        table.add_row(name, *(f"{value:.2e}" for value in values), f"×/÷ {factor:.2f}")
    for name in _BIAS:
        values = (getattr(motion.bias, name) for motion in (found.before, found.motion))
        table.add_row(f"bias.{name}", *(f"{value:.4f}" for value in values), "")
    show(table)
    before, after = (found.pieces.consistency(motion) for motion in (found.before, found.motion))
    typer.echo("\nSquared error of a metre or a radian over what is expected (above 1 odometry is trusted too much):")
    for index, name in enumerate(("distance", "turn")):
        typer.echo(f"{name}: {before[index]:.2f} now, {after[index]:.2f} as found")
    for checked in drives:
        if checked.clock.disagrees():
            warn(f"{checked.drive.name}: the truth is stamped {checked.clock.text} than the wheels; this was undone.")
