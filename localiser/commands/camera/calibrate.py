"""Calibrate a camera from images of a board, and draw a board to print."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from localiser.calibration import FEWEST_VIEWS, Board, BoardView, FloorMount, Intrinsics, calibrated, mount_over_board
from localiser.camera import Camera, Mount
from localiser.documents import drafted, read_bytes
from localiser.errors import InputError
from localiser.image_files import measure
from localiser.storage import MAX_IMAGE_BYTES, read_image, require_new_file, write_camera

_DPI = 600
_MOST_LOOKED_AT = 3
"""In as many images another board is looked for when the one that was named is not there."""


@dataclass(frozen=True, slots=True, eq=False)
class Calibration:
    """What images of a board told. without_board: names of the images in which it was not found."""

    intrinsics: Intrinsics
    without_board: tuple[str, ...]
    floor: FloorMount | None

    @property
    def camera(self) -> Camera:
        """The camera, over the floor where that is known."""
        if self.floor is None:
            return self.intrinsics.camera
        tilt, roll, height = (float(value) for value in self.floor.values)
        return replace(self.intrinsics.camera, mount=Mount(tilt_rad=tilt, height_m=height, roll_rad=roll))


def calibrate(
    images: Sequence[Path], floor: Path | None, board: Board, lens: str, progress: Callable[[], None]
) -> Calibration:
    """Return what images of a board tell, in the order of their names, and one of the board on the floor.

    Raises InputError.
    """
    paths = in_order([*images, *([floor] if floor is not None else [])])
    size = common_size(paths)
    found: dict[Path, BoardView | None] = {}
    for path in paths:
        found[path] = board.find(read_image(path, size), path.name)
        progress()
    without = [path for path, view in found.items() if view is None]
    wanted = f"expected a {board.kind} of {board.size} squares"
    if floor in without:
        raise InputError(f"{wanted}, found none; {_advice(board, [floor], size)}", path=floor)
    views = {path: view for path, view in found.items() if view is not None}
    if not views:
        problem = f"{wanted} in the images, found it in none of them; {_advice(board, without, size)}"
        raise InputError(problem, field="--squares")
    if without and len(views) < FEWEST_VIEWS:
        names = ", ".join(path.name for path in without)
        problem = f"{wanted} in at least {FEWEST_VIEWS} images, found it in {len(views)} and not in {names}"
        raise InputError(f"{problem}; {_advice(board, without, size)}")
    intrinsics = calibrated(list(views.values()), size, lens)
    return Calibration(
        intrinsics=intrinsics,
        without_board=tuple(path.name for path in without),
        floor=None if floor is None else mount_over_board(intrinsics, list(views).index(floor)),
    )


def in_order(paths: Iterable[Path]) -> list[Path]:
    """Return each path once, in the order of names, numbers in them as numbers: 2.png before 10.png."""

    def key(path: Path) -> list[tuple[int, str]]:
        return [(int(part), "") if part.isdecimal() else (-1, part) for part in re.split(r"(\d+)", str(path))]

    return sorted(set(paths), key=key)


def _advice(board: Board, images: Sequence[Path], size: tuple[int, int]) -> str:
    """Return what to do about images in which the board was not found, for people."""
    for path in images[:_MOST_LOOKED_AT]:
        other = board.mistaken_for(read_image(path, size))
        if other is not None:
            option = f"--squares {other.size}" if other.size != board.size else ""
            pattern = "" if other.legacy == board.legacy else f" {'with' if other.legacy else 'without'} --legacy"
            found = f"{path.name} shows one {(option + pattern).strip()}"
            return f"{found}: squares are counted, not the corners between them" if option else found
    whole = "a chessboard must be seen whole" if board.kind == "chessboard" else "--dictionary must be the print's"
    return f"--squares counts squares, not the corners between them, and {whole}"


def common_size(paths: Sequence[Path]) -> tuple[int, int]:
    """Return the size (width, height) that all images have. Raises InputError."""
    sizes = []
    for path in paths:
        try:
            sizes.append(measure(read_bytes(path, MAX_IMAGE_BYTES))[0])
        except ValueError as error:
            raise InputError(str(error), path=path) from None
        if sizes[-1] != sizes[0]:
            (width, height), found = sizes[0], sizes[-1]
            problem = f"expected {width}×{height} pixels as in {paths[0]}, found {found[0]}×{found[1]}"
            raise InputError(problem, path=path)
    return sizes[0]


def write_calibration(calibration: Calibration, path: Path, name: str) -> None:
    """Write the file of a camera called `name`, with how good it is as a comment. Raises OutputError."""
    intrinsics = calibration.intrinsics
    names = zip(intrinsics.parameters, intrinsics.sigma, strict=True)
    comment = (
        f"Calibrated from {len(intrinsics.views)} images of a board, reprojection error {intrinsics.rms_px:.3f} px.\n"
        f"1 sigma: {', '.join(f'{name} {sigma:.2g}' for name, sigma in names)}"
    )
    if calibration.floor is not None:
        tilt, roll, height = calibration.floor.sigma
        comment += (
            f"\nMount from a board on the floor; 1 sigma: tilt {np.rad2deg(tilt):.2g}°, roll {np.rad2deg(roll):.2g}°, "
            f"height {height:.2g} m. Not measured: right_m, back_m, yaw_deg."
        )
    camera = replace(calibration.camera, name=name)
    write_camera(camera, path, with_mount=calibration.floor is not None, comment=comment)


def draw_board(board: Board, path: Path) -> None:
    """Draw a board to print at its true size, as PDF, PNG or SVG. Raises InputError, OutputError."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    if path.suffix.lower() not in (".pdf", ".png", ".svg"):
        raise InputError("expected a name that ends in .pdf, .png or .svg", path=path)
    require_new_file(path)
    inches = [metres / 0.0254 for metres in board.picture_size_m()]
    figure = Figure(figsize=(inches[0], inches[1]), facecolor="white")
    FigureCanvasAgg(figure)
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    axes.set_axis_off()
    square_px = min(round(board.square_m / 0.0254 * _DPI), 6000 // max(board.columns, board.rows))
    axes.imshow(board.picture(max(square_px, 40)), cmap="gray", vmin=0, vmax=255, aspect="auto", interpolation="none")
    dpi = _DPI if path.suffix.lower() != ".png" else min(_DPI, 8000 / max(inches))
    with drafted(path) as draft:
        figure.savefig(draft, format=path.suffix[1:].lower(), dpi=dpi)
