"""The commands `camera tilt`, `camera sync`, `camera calibrate` and `camera board`: their arguments."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from localiser.commands.options import (
    BagCamera,
    ConfigFile,
    Overrides,
    Quiet,
    Topics,
    opened,
    progress,
    show,
    topics_by_role,
)
from localiser.errors import InputError

if TYPE_CHECKING:
    from rich.table import Table

    from localiser.calibration import Board, ClockOffset
    from localiser.commands.camera.calibrate import Calibration
    from localiser.commands.camera.tilt import Tilt

_WELL_REACHED = 0.7


class BoardName(StrEnum):
    """What is on a board."""

    charuco = "charuco"
    chessboard = "chessboard"


class LensName(StrEnum):
    """Models of lens distortion."""

    plumb_bob = "plumb_bob"
    rational_polynomial = "rational_polynomial"
    equidistant = "equidistant"
    none = "none"


camera_app = typer.Typer(
    no_args_is_help=True, help="Find out where the camera looks, and what its lens does.", rich_markup_mode="markdown"
)


@camera_app.command(
    epilog="""Examples:

`localiser camera tilt logs/corridor`

`localiser camera tilt logs/corridor --plot tilt.png --write`"""
)
def tilt(
    log: Annotated[Path, typer.Argument(metavar="LOG", help="Log folder with images.")],
    write: Annotated[
        bool, typer.Option("--write", help="Write tilt and roll into the log's camera file; the old one is kept.")
    ] = False,
    plot: Annotated[
        Path | None, typer.Option(metavar="FILE.png", help="Draw tilt and roll, image by image, to a new file.")
    ] = None,
    images: Annotated[
        int, typer.Option(min=1, metavar="N", help="Use at most so many images, evenly spread over the log.")
    ] = 500,
    config: ConfigFile = None,
    overrides: Overrides = None,
    log_format: Annotated[
        str | None, typer.Option("--format", metavar="FORMAT", help="Format of the log; by default found out.")
    ] = None,
    quiet: Quiet = False,
) -> None:
    """Find tilt and roll from the vertical edges in a LOG's images; the stated tilt may be several degrees off."""
    from localiser.commands.camera.tilt import find_tilt, usable_images, write_plot, write_tilt
    from localiser.config import read_config
    from localiser.storage import open_log, require_new_file

    if plot is not None:
        require_new_file(plot)
    settings = read_config(config, overrides or [])
    recorded = open_log(log, format=log_format, sensor=settings.sensor)
    used = usable_images(recorded, images)
    with progress("Looking", len(used), quiet) as advance:
        found = find_tilt(recorded, used, settings, advance)
    if not quiet:
        _show_tilt(found)
    if plot is not None:
        write_plot(found, plot)
        typer.echo(f"Drawn in {plot}")
    if write:
        path, kept = write_tilt(found, settings)
        typer.echo(f"Written to {path}; what it was is in {kept}")


@camera_app.command(
    epilog="""Examples:

`localiser camera sync logs/corridor`

`localiser camera sync drive --write`"""
)
def sync(
    log: Annotated[Path, typer.Argument(metavar="LOG", help="Log with images and odometry, in which the robot turns.")],
    write: Annotated[
        bool,
        typer.Option("--write", help="Write the images' times by the clock of the wheels; the old table is kept."),
    ] = False,
    config: ConfigFile = None,
    overrides: Overrides = None,
    log_format: Annotated[
        str | None, typer.Option("--format", metavar="FORMAT", help="Format of the log; by default found out.")
    ] = None,
    topics: Topics = None,
    camera: BagCamera = None,
    quiet: Quiet = False,
) -> None:
    """Find the offset between the clocks of images and wheels, from the turns that both of them show."""
    from localiser.calibration import MOST_PAIRS
    from localiser.commands.camera.sync import find_offset, images_of, write_offset

    recorded, settings = opened(
        log, config, [*(overrides or [])], format=log_format, topics=topics_by_role(topics), camera=camera
    )
    images = images_of(recorded)
    with progress("Looking", MOST_PAIRS, quiet) as advance:
        found = find_offset(recorded, images, settings, advance)
    if not quiet:
        _show_offset(found)
    if write:
        path, kept = write_offset(recorded, found)
        typer.echo(f"Written to {path}; what it was is in {kept}")


BoardOption = Annotated[BoardName, typer.Option(help="What is on the board.")]
Squares = Annotated[
    str,
    typer.Option(
        metavar="CxR", help="How many squares across and down, such as 8x6: one more than corners between them."
    ),
]
SquareM = Annotated[float, typer.Option(metavar="M", help="Side of a square, measured on the print (m).")]
MarkerM = Annotated[
    float | None, typer.Option(metavar="M", help="Side of a ChArUco marker (m); by default 0.75 of a square.")
]
Dictionary = Annotated[str, typer.Option(metavar="NAME", help="Set of ChArUco markers, such as 4X4_50.")]
Legacy = Annotated[bool, typer.Option("--legacy", help="ChArUco pattern of OpenCV before 4.6.")]


@camera_app.command(
    epilog="""Examples:

`localiser camera calibrate images/*.png --board charuco --squares 8x6 --square-m 0.03 -o camera.yaml`

`localiser camera calibrate images/*.png --board chessboard --squares 9x7 --square-m 0.025 --floor floor.png`"""
)
def calibrate(
    images: Annotated[
        list[Path],
        typer.Argument(
            metavar="IMAGE…", help="JPEG or PNG images that show the board; taken in the order of their names."
        ),
    ],
    board: BoardOption,
    squares: Squares,
    square_m: SquareM,
    marker_m: MarkerM = None,
    dictionary: Dictionary = "5X5_100",
    legacy: Legacy = False,
    floor: Annotated[
        Path | None,
        typer.Option(metavar="IMAGE", help="The board flat on the floor, camera on the robot: gives the mount too."),
    ] = None,
    lens: Annotated[LensName, typer.Option(help="Model of the lens distortion, as ROS names it.")] = LensName.plumb_bob,
    out: Annotated[Path | None, typer.Option("--out", "-o", metavar="FILE", help="New camera file.")] = None,
    name: Annotated[
        str | None, typer.Option(metavar="NAME", help="Name of the camera in that file; by default the file's own.")
    ] = None,
    quiet: Quiet = False,
) -> None:
    """Find focal length, principal point and lens distortion from IMAGES of a board; with --floor tilt and height."""
    from localiser.commands.camera import calibrate as calibration
    from localiser.storage import require_new_file

    if out is not None:
        require_new_file(out)
    wanted = _board(board, squares, square_m, marker_m, dictionary, legacy)
    count = len({*images} if floor is None else {*images, floor})
    with progress("Looking for the board", count, quiet) as advance:
        found = calibration.calibrate(images, floor, wanted, lens.value, advance)
    if not quiet:
        _show_calibration(found)
    if out is not None:
        calibration.write_calibration(found, out, name or out.stem)
        typer.echo(f"Written to {out}")
        if found.floor is None:
            typer.echo("It has no mount yet: use --floor, or add tilt_deg, height_m, … by hand.", err=True)


@camera_app.command(
    name="board", epilog="Example: `localiser camera board board.pdf --board charuco --squares 8x6 --square-m 0.03`"
)
def draw(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="New picture, .pdf, .png or .svg.")],
    board: BoardOption,
    squares: Squares,
    square_m: SquareM,
    marker_m: MarkerM = None,
    dictionary: Dictionary = "5X5_100",
    legacy: Legacy = False,
) -> None:
    """Draw a board to print at its true size; measure a square on the print, printers scale."""
    from localiser.commands.camera.calibrate import draw_board

    wanted = _board(board, squares, square_m, marker_m, dictionary, legacy)
    draw_board(wanted, file)
    width, height = wanted.picture_size_m()
    typer.echo(
        f"{file}: {1000 * width:.0f} mm × {1000 * height:.0f} mm; print without scaling, glue it to something flat"
    )


def _board(
    kind: BoardName, squares: str, square_m: float, marker_m: float | None, dictionary: str, legacy: bool
) -> Board:
    from localiser.calibration import Board

    try:
        columns, rows = (int(part) for part in squares.lower().split("x"))
    except ValueError:
        problem = f"expected columns x rows of squares, such as 8x6, found {squares!r}"
        raise InputError(problem, field="--squares") from None
    marker = 0.75 * square_m if marker_m is None else marker_m
    return Board(kind.value, columns, rows, square_m, marker, dictionary, legacy)


def _show_calibration(found: Calibration) -> None:
    import numpy as np

    intrinsics = found.intrinsics
    outliers = intrinsics.outliers
    views = _table("image", "corners", "error (px)", "")
    for view, rms in zip(intrinsics.views, intrinsics.view_rms_px, strict=True):
        views.add_row(view.name, str(len(view.corners_px)), f"{rms:.3f}", "outlier" if view.name in outliers else "")
    for name in found.without_board:
        views.add_row(name, "0", "", "no board found")
    views.add_row("all", str(sum(len(view.corners_px) for view in intrinsics.views)), f"{intrinsics.rms_px:.3f}", "")
    show(views)
    values = _table("", "found", "1σ")
    for name, value, sigma in zip(intrinsics.parameters, intrinsics.values, intrinsics.sigma, strict=True):
        digits = 2 if name in ("fx", "fy", "cx", "cy") else 5
        values.add_row(f"{name} (px)" if digits == 2 else name, f"{value:.{digits}f}", f"{sigma:.{digits}f}")
    if found.floor is not None:
        for index, (name, unit) in enumerate((("tilt (°)", 180 / np.pi), ("roll (°)", 180 / np.pi), ("height (m)", 1))):
            values.add_row(name, *(f"{of[index] * unit:.4f}" for of in (found.floor.values, found.floor.sigma)))
    show(values)
    doubts = {
        f"Look at {', '.join(outliers)}: blurred, bent or not this board? Leave out what is.": outliers,
        f"No board was found in {', '.join(found.without_board)}: blurred, too small or, a chessboard, cut off?": (
            found.without_board
        ),
        f"Corners were seen up to {intrinsics.reach:.0%} of the way from the centre to the image's corners; "
        "further out the lens is a guess. Add images with the board there.": intrinsics.reach < _WELL_REACHED,
    }
    for text, is_so in doubts.items():
        if is_so:
            typer.secho(text, fg="yellow", err=True)


def _table(*columns: str) -> Table:
    from rich.table import Table

    table = Table(*columns, box=None, pad_edge=False)
    for column in table.columns[1:]:
        column.justify = "right"
    return table


def _show_tilt(tilt: Tilt) -> None:
    import numpy as np

    found = tilt.found
    table = _table("", "stated", "found", "1σ", "found - stated")
    rows = zip(("tilt (°)", "roll (°)"), *np.rad2deg([found.stated, found.mount, found.sigma]), strict=True)
    for name, stated, mean, sigma in rows:
        table.add_row(name, f"{stated:.3f}", f"{mean:.3f}", f"{sigma:.3f}", f"{mean - stated:+.3f}")
    show(table)
    share = found.vertical / found.lines if found.lines else 0.0
    typer.echo(
        f"{found.lines} lines in {len(tilt.seconds)} images, {share:.0%} of them vertical edges; "
        f"the images show {found.views} different views. Rows of things lean by {np.rad2deg(found.row_sigma):.2f}°."
    )
    if problem := found.problem:
        typer.secho(problem, fg="yellow", err=True)


def _show_offset(found: ClockOffset) -> None:
    import numpy as np

    typer.echo(
        f"Images are stamped {found.text} than wheels (1σ), by {np.rad2deg(found.turned_rad):.0f}° of turning in "
        f"{found.pairs} pairs of images."
    )
    if problem := found.problem:
        typer.secho(problem, fg="yellow", err=True)
