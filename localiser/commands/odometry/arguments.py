"""The command `odometry fit`: its arguments, and what it prints."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from localiser.commands.options import ConfigFile, Overrides, Quiet, progress, show

if TYPE_CHECKING:
    from rich.table import Table

    from localiser.calibration import OdometryFit
    from localiser.commands.odometry.fit import Checked

odometry_app = typer.Typer(
    no_args_is_help=True,
    help="Find out how good the robot's odometry is; make a truth of it and of marks.",
    rich_markup_mode="markdown",
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
    by_filter: Annotated[
        bool, typer.Option("--by-filter", help="Use the filter's own smoothed path even where a log has its truth.")
    ] = False,
    map_file: Annotated[
        Path | None, typer.Option("--map", metavar="MAP", help="Landmark map, in place of the logs' own.")
    ] = None,
    config: ConfigFile = None,
    overrides: Overrides = None,
    quiet: Quiet = False,
) -> None:
    """Find the noise of a robot's odometry and its constant errors from LOGS, and say what they would change."""
    from localiser.commands.odometry.fit import checked_drive, drive_of, fitted, to_yaml
    from localiser.config import read_config
    from localiser.storage import open_log, require_new_file, write_text

    if out is not None:
        require_new_file(out)
    settings = read_config(config, overrides or [])
    drives = []
    with progress("Reading", len(logs), quiet) as advance:
        for path in logs:
            log = open_log(path, sensor=settings.sensor)
            own = read_config(config, overrides or [], log.settings)
            drives.append(checked_drive(drive_of(log, own, by_filter=by_filter, map_file=map_file)))
            advance()
    found = fitted(drives, settings.motion)
    if not quiet:
        _show(drives, found)
    if out is not None:
        write_text(out, to_yaml(drives, found))
        typer.echo(f"Written to {out}; use it with --config {out}")


@odometry_app.command(
    epilog="""Example: `localiser odometry marks logs/drive marks.csv -o logs/drive/groundtruth.csv`, with marks.csv:

`t_s,x,z,heading_deg,sigma_m`

`0.0,0.00,0.00,90,0.01`

`31.5,4.25,-3.10,,`"""
)
def marks(
    log: Annotated[Path, typer.Argument(metavar="LOG", help="Log of the drive, with odometry.")],
    marks_file: Annotated[
        Path,
        typer.Argument(
            metavar="MARKS",
            help="CSV of when the robot stood on which mark: t_s (since the first odometry) or t_ns, x, z (metres), "
            "and where known heading_deg, sigma_m (0.01), sigma_deg (2).",
        ),
    ],
    out: Annotated[Path, typer.Option("--out", "-o", metavar="FILE", help="The poses, as `t_ns,x,z,heading`.")],
    config: ConfigFile = None,
    overrides: Overrides = None,
    quiet: Quiet = False,
) -> None:
    """Make the true poses of a drive over surveyed MARKS: odometry between them, corrected to meet them."""
    from localiser.calibration import drive_over_marks
    from localiser.commands.odometry.marks import named, shown_drive
    from localiser.config import read_config
    from localiser.storage import open_log, read_marks, require_new_file, require_odometry, write_poses

    require_new_file(out)
    recorded = open_log(log)
    require_odometry(recorded, "a drive over marks")
    settings = read_config(config, overrides or [], recorded.settings)
    table = read_marks(marks_file, int(recorded.odometry.t_ns[0]))
    with named(table):
        drive = drive_over_marks(recorded.odometry, table.marks, settings.motion)
    write_poses(drive.trajectory, out)
    if not quiet:
        typer.echo(shown_drive(drive))
        typer.echo(f"Written to {out}; a log has it as its truth by `groundtruth: {out.name}` in log.yaml.")


def _show(drives: list[Checked], found: OdometryFit) -> None:
    show(_drives(drives, found))
    typer.echo()
    show(_parameters(found))
    before, after = (found.pieces.consistency(motion) for motion in (found.before, found.motion))
    typer.echo("\nSquared error of a metre or a radian over what is expected (above 1 odometry is trusted too much):")
    for index, name in enumerate(("distance", "turn")):
        typer.echo(f"{name}: {before[index]:.2f} now, {after[index]:.2f} as found")
    for checked in drives:
        if checked.clock.disagrees():
            text = f"{checked.drive.name}: the truth is stamped {checked.clock.text} than the wheels; this was undone."
            typer.secho(text, fg="yellow", err=True)


def _drives(drives: list[Checked], found: OdometryFit) -> Table:
    import numpy as np
    from rich.table import Table

    table = Table("drive", "by", "metres", "turned (°)", "distance (%)", "turn (%)", "veer (°/m)", box=None)
    for column in table.columns[2:]:
        column.justify = "right"
    units = np.array([100.0, 100.0, np.rad2deg(1.0)])
    for index, checked in enumerate(drives):
        own = found.pieces.drive == index
        path_m, turned_deg = found.pieces.path_m[own].sum(), np.rad2deg(found.pieces.turned_rad[own].sum())
        pairs = zip(found.constants[index] * units, found.sigmas[index] * units, strict=True)
        cells = [f"{value:+.2f} ± {sigma:.2f}" for value, sigma in pairs]
        table.add_row(checked.drive.name, checked.by, f"{path_m:.1f}", f"{turned_deg:.0f}", *cells)
    return table


def _parameters(found: OdometryFit) -> Table:
    from rich.table import Table

    from localiser.calibration import ALPHAS

    table = Table("motion.", "now", "found", "1σ", box=None)
    for column in table.columns[1:]:
        column.justify = "right"
    for name, factor in zip(ALPHAS, found.factor, strict=True):
        values = (getattr(motion, name) for motion in (found.before, found.motion))
        table.add_row(name, *(f"{value:.2e}" for value in values), f"×/÷ {factor:.2f}")
    for name in ("distance_sigma", "turn_sigma", "veer_sigma_deg_per_m"):
        values = (getattr(motion.bias, name) for motion in (found.before, found.motion))
        table.add_row(f"bias.{name}", *(f"{value:.4f}" for value in values), "")
    return table
