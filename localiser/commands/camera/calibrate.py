"""`localiser camera calibrate`: lens and focal length from images of a board, and a board to print."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from localiser.commands.options import is_quiet, progress, show, warn
from localiser.errors import InputError

if TYPE_CHECKING:
    from localiser.calibration import Board, BoardView, FloorMount, Intrinsics
    from localiser.camera import Camera

EPILOG = """Examples:

`localiser camera calibrate --draw-board board.png --board charuco --squares 8x6 --square-m 0.03`

`localiser camera calibrate images/*.png --board charuco --squares 8x6 --square-m 0.03 -o camera.yaml`

`localiser camera calibrate images/*.png --board chessboard --squares 9x7 --square-m 0.025 --floor floor.png`"""

_WELL_REACHED = 0.7
_DPI = 600
LensName = Literal["plumb_bob", "rational_polynomial", "equidistant", "none"]


def calibrate(
    images: Annotated[
        list[Path] | None,
        typer.Argument(
            metavar="IMAGE…", help="JPEG or PNG images that show the board; taken in the order of their names."
        ),
    ] = None,
    *,
    board: Annotated[Literal["charuco", "chessboard"], typer.Option(help="What is on the board.")],
    squares: Annotated[
        str,
        typer.Option(
            metavar="CxR", help="How many squares across and down, such as 8x6: one more than corners between them."
        ),
    ],
    square_m: Annotated[float, typer.Option(metavar="M", help="Side of a square, measured on the print (m).")],
    marker_m: Annotated[
        float | None, typer.Option(metavar="M", help="Side of a ChArUco marker (m); by default 0.75 of a square.")
    ] = None,
    dictionary: Annotated[
        str, typer.Option(metavar="NAME", help="Set of ChArUco markers, such as 4X4_50.")
    ] = "5X5_100",
    legacy: Annotated[bool, typer.Option("--legacy", help="ChArUco pattern of OpenCV before 4.6.")] = False,
    draw_board: Annotated[
        Path | None,
        typer.Option(metavar="FILE.png", help="Draw the board to print, in place of calibrating; a new file."),
    ] = None,
    floor: Annotated[
        Path | None,
        typer.Option(metavar="IMAGE", help="The board flat on the floor, camera on the robot: gives the mount too."),
    ] = None,
    lens: Annotated[
        LensName, typer.Option(metavar="MODEL", help="Distortion: plumb_bob, rational_polynomial, equidistant or none.")
    ] = "plumb_bob",
    out: Annotated[Path | None, typer.Option("--out", "-o", metavar="FILE", help="New camera file.")] = None,
) -> None:
    """Find focal length, principal point and lens distortion from IMAGES of a board; with --floor tilt and height."""
    from localiser.calibration import Board
    from localiser.storage import lens_problem, require_new_file

    try:
        columns, rows = (int(part) for part in squares.lower().split("x"))
    except ValueError:
        problem = f"expected columns x rows of squares, such as 8x6, found {squares!r}"
        raise InputError(problem, field="--squares") from None
    marker = 0.75 * square_m if marker_m is None else marker_m
    wanted = Board(board, columns, rows, square_m, marker, dictionary, legacy)
    if draw_board is not None:
        write_board(wanted, draw_board)
        width, height = wanted.picture_size_m()
        size = f"{1000 * width:.0f} mm × {1000 * height:.0f} mm"
        typer.echo(f"{draw_board}: {size}; print without scaling, measure a square, glue it to something flat")
        return
    if not images:
        raise InputError("expected images of the board, or --draw-board FILE", field="IMAGE")
    if out is not None:
        require_new_file(out)
    count = len({*images} if floor is None else {*images, floor})
    with progress("Looking for the board", count) as advance:
        found = calibrate_by(images, floor, wanted, lens, advance)
    if not is_quiet():
        _show(found)
    if problem := lens_problem(found.camera):
        raise InputError(f"{problem}, and images of the board near the border tell more", field="--lens")
    if out is not None:
        write_calibration(found, out, out.stem)
        typer.echo(f"Written to {out}")
        if found.floor is None:
            typer.echo("It has no mount yet: use --floor, or add tilt_deg, height_m, … by hand.", err=True)


@dataclass(frozen=True, slots=True, eq=False)
class Calibration:
    """What images of a board told. without_board: names of the images in which it was not found."""

    intrinsics: Intrinsics
    without_board: tuple[str, ...]
    floor: FloorMount | None

    @property
    def camera(self) -> Camera:
        """The camera, over the floor where that is known."""
        from localiser.camera import Mount

        if self.floor is None:
            return self.intrinsics.camera
        tilt, roll, height = (float(value) for value in self.floor.values)
        return replace(self.intrinsics.camera, mount=Mount(tilt_rad=tilt, height_m=height, roll_rad=roll))


def calibrate_by(
    images: Sequence[Path], floor: Path | None, board: Board, lens: str, advance: Callable[[], None]
) -> Calibration:
    """Return what images of a board tell, in the order of their names, and one of the board on the floor.

    Raises InputError.
    """
    from localiser.calibration import FEWEST_VIEWS, calibrate, mount_over_board
    from localiser.documents import plain_name, read_bytes
    from localiser.image_files import measure
    from localiser.storage import MAX_IMAGE_BYTES, read_image

    paths = sorted({*images, *([floor] if floor is not None else [])})
    try:
        size = measure(read_bytes(paths[0], MAX_IMAGE_BYTES))[0]
    except ValueError as error:
        raise InputError(str(error), path=paths[0]) from None
    found: dict[Path, BoardView | None] = {}
    for path in paths:
        found[path] = board.find(read_image(path, size), plain_name(path.name))
        advance()
    without = [path for path, view in found.items() if view is None]
    wanted = f"expected a {board.kind} of {board.size} squares"
    whole = "a chessboard must be seen whole" if board.kind == "chessboard" else "--dictionary must be the print's"
    advice = f"--squares counts squares, not the corners between them, and {whole}"
    if floor in without:
        raise InputError(f"{wanted}, found none; {advice}", path=floor)
    views = {path: view for path, view in found.items() if view is not None}
    if not views:
        raise InputError(f"{wanted} in the images, found it in none of them; {advice}", field="--squares")
    if without and len(views) < FEWEST_VIEWS:
        names = ", ".join(path.name for path in without)
        problem = f"{wanted} in at least {FEWEST_VIEWS} images, found it in {len(views)} and not in {names}"
        raise InputError(f"{problem}; {advice}")
    intrinsics = calibrate(list(views.values()), size, lens)
    return Calibration(
        intrinsics=intrinsics,
        without_board=tuple(plain_name(path.name) for path in without),
        floor=None if floor is None else mount_over_board(intrinsics, list(views).index(floor)),
    )


def write_calibration(calibration: Calibration, path: Path, name: str) -> None:
    """Write the file of a camera called `name`, with how good it is as a comment. Raises OutputError."""
    import numpy as np

    from localiser.storage import write_camera

    intrinsics = calibration.intrinsics
    names = zip(intrinsics.parameters, intrinsics.sigma, strict=True)
    comment = (
        f"Calibrated from {len(intrinsics.views)} images of a board, reprojection error {intrinsics.rms_px:.3f} px.\n"
        f"1 sigma: {', '.join(f'{name} {sigma:.2g}' for name, sigma in names)}"
    )
    if calibration.floor is not None:
        tilt, roll, height = (float(value) for value in calibration.floor.sigma)
        comment += (
            f"\nMount from a board on the floor; 1 sigma: tilt {np.rad2deg(tilt):.2g}°, roll {np.rad2deg(roll):.2g}°, "
            f"height {height:.2g} m. Not measured: right_m, back_m, yaw_deg."
        )
    camera = replace(calibration.camera, name=name)
    write_camera(camera, path, with_mount=calibration.floor is not None, comment=comment)


def write_board(board: Board, path: Path) -> None:
    """Draw a board to print at its true size, as PNG. Raises InputError, OutputError."""
    from matplotlib.image import imsave

    from localiser.documents import drafted
    from localiser.storage import require_new_file

    if path.suffix.lower() != ".png":
        raise InputError("expected a name that ends in .png", path=path)
    require_new_file(path)
    square_in = board.square_m / 0.0254
    square_px = max(min(round(square_in * _DPI), 6000 // max(board.columns, board.rows)), 40)
    with drafted(path) as draft:
        picture = board.picture(square_px)
        imsave(draft, picture, format="png", cmap="gray", vmin=0, vmax=255, dpi=square_px / square_in)


def _show(found: Calibration) -> None:
    import numpy as np

    from localiser.evaluate import new_table

    intrinsics = found.intrinsics
    outliers = intrinsics.outliers
    views = new_table("", "image", "corners", "error (px)", "")
    for view, rms in zip(intrinsics.views, intrinsics.view_rms_px, strict=True):
        views.add_row(view.name, str(len(view.corners_px)), f"{rms:.3f}", "outlier" if view.name in outliers else "")
    for name in found.without_board:
        views.add_row(name, "0", "", "no board found")
    views.add_row("all", str(sum(len(view.corners_px) for view in intrinsics.views)), f"{intrinsics.rms_px:.3f}", "")
    show(views)
    values = new_table("", "", "found", "1σ")
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
            warn(text)
