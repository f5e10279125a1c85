"""`localiser edges`: find vertical edges in images; write a table of them, and a picture of each image."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from localiser.commands.options import ConfigFile, Overrides, is_quiet, progress, with_options
from localiser.errors import InputError, LocaliserError, RunEndedEarlyError

if TYPE_CHECKING:
    from localiser.camera import Camera
    from localiser.config import Config
    from localiser.edges import Edges
    from localiser.geometry import Array, Trajectory
    from localiser.storage import Image, ImageEvent

EPILOG = """Examples:

`localiser edges photo.png --camera camera.yaml`

`localiser edges *.jpg --camera camera.yaml --detector lsd --out found`

`localiser edges logs/corridor --no-pictures --set edges.min_length_px=20`"""

_LEAST_WIDTH = 1000  # of a picture; a smaller image is drawn larger

COLUMNS = (
    "edge",  # number in the picture, from left to right
    "bearing_rad",  # direction from the camera's forward axis, positive right, of the line held through the nadir point
    "bearing_sigma_rad",  # its standard deviation
    "lean_rad",  # angle of the free line from the image's vertical, top to the right positive, roll undone
    "lean_sigma_rad",  # its standard deviation
    "slope",  # the paper's slope m = 1 / tan(lean)
    "slope_deg",  # the paper's slope as an angle, from the image's horizontal: 90 is vertical
    "length_px",  # visible length
    "polarity",  # 1 dark to light from left to right, -1 light to dark, 0 unknown
    "bottom_u_px",  # lower end in the image as taken, to the right of the top-left pixel's centre
    "bottom_v_px",  # and below it
    "top_u_px",  # upper end
    "top_v_px",  # and below the top-left pixel's centre
    "foot_range_m",  # floor distance of the lower end from the camera, if it stands on the floor; empty if not seen
    "foot_range_sigma_m",  # its standard deviation, the mount's error left out
    "foot_right_m",  # that floor point to the right of the camera
    "foot_back_m",  # and behind it, so negative ahead
)


def edges(
    images: Annotated[
        list[Path], typer.Argument(metavar="IMAGE…", help="Image files of one camera, or one log folder.")
    ],
    camera: Annotated[
        Path | None, typer.Option(metavar="FILE", help="What took the images; by default a log's own.")
    ] = None,
    detector: Annotated[str | None, typer.Option(metavar="NAME", help="columns, lsd or hough.")] = None,
    out: Annotated[
        Path | None,
        typer.Option("--out", "-o", metavar="DIR", help="New folder for the results; by default results/edges/1, 2, …"),
    ] = None,
    pictures: Annotated[bool, typer.Option("--pictures/--no-pictures", help="Draw what was found.")] = True,
    config: ConfigFile = None,
    overrides: Overrides = None,
) -> None:
    """Find the vertical edges in images; write them as CSV, and a picture of each image."""
    import numpy as np

    from localiser.config import in_force, read_config, to_yaml
    from localiser.replay import Stop, asked_to_stop
    from localiser.storage import RunFolder, output_errors, require_new, write_camera, write_text

    settings = read_config(config, with_options(overrides, edges__detector=detector))
    taken_by, taken, odometry = _inputs(images, camera)
    taken[0].load()  # a wrong camera is an error before a folder is made
    if out is not None:
        require_new(out)
        with output_errors(out):
            out.mkdir(parents=True, exist_ok=True)
    folder = out or RunFolder.create(Path("results"), "edges").path
    write_camera(taken_by, folder / "camera.yaml")
    write_text(folder / "config.yaml", to_yaml(in_force(settings)))
    counts: list[int] = []
    asked = Stop()
    try:
        with progress("Finding edges", len(taken), shown=len(taken) > 1) as advance, asked_to_stop() as asked:
            for number, one in enumerate(taken):
                if asked.is_set():
                    raise KeyboardInterrupt
                counts.append(_find_in(one, number, taken_by, odometry, settings, folder, pictures))
                advance()
    except (KeyboardInterrupt, LocaliserError) as error:
        reason, exit_code = "stopped", asked.exit_code
        if isinstance(error, LocaliserError):
            reason, exit_code = str(error), error.exit_code
        done = f"The run ended after {len(counts)} of {len(taken)} images"
        raise RunEndedEarlyError(f"{reason}. {done}; what was done is in {folder}", exit_code) from error
    if not is_quiet():
        where = taken[0].name if len(counts) == 1 else f"{len(counts)} images, {np.median(counts):g} each (median)"
        typer.echo(f"{sum(counts)} vertical edges in {where}")
        typer.echo(f"Results in {folder}: edges.csv{'; a picture of each image' if pictures else ''}.")


# -- what is looked at ------------------------------------------------------------------------------------------------


def _inputs(paths: Sequence[Path], camera_file: Path | None) -> tuple[Camera, list[ImageEvent], Trajectory | None]:
    """Return the camera, the images, and the odometry of a log: of files, or of one log folder.

    A camera file replaces the log's own camera. Raises InputError.
    """
    from localiser.documents import plain_name
    from localiser.storage import FolderReader, ImageEvent, open_log, read_camera, read_image

    logs = [path for path in paths if FolderReader().recognises(path)]
    if logs and len(paths) > 1:
        raise InputError("expected images or one log, found it among other inputs", path=logs[0])
    camera = read_camera(camera_file) if camera_file else None
    if logs:
        log = open_log(logs[0], format="folder")
        if not log.has_images:
            raise InputError("expected a log with images, found one whose edges are measured already", path=logs[0])
        if camera and (camera.width, camera.height) != (log.camera.width, log.camera.height):
            found = f"one of {camera.width}×{camera.height}"
            expected = f"a camera of {log.camera.width}×{log.camera.height} pixels"
            raise InputError(f"expected {expected}, found {found}", field="--camera")
        return camera or log.camera, log.images, log.odometry
    if camera is None:
        raise InputError("expected --camera FILE: what took the images", path=paths[0])
    size = (camera.width, camera.height)
    loads = ((path, partial(read_image, path, size)) for path in paths)
    return camera, [ImageEvent(0, plain_name(str(path)), load, path.read_bytes) for path, load in loads], None


# -- what is found ----------------------------------------------------------------------------------------------------


def _find_in(
    taken: ImageEvent,
    number: int,
    camera: Camera,
    odometry: Trajectory | None,
    settings: Config,
    folder: Path,
    pictures: bool,
) -> int:
    """Append the edges of an image, from left to right, to edges.csv, and draw them; return how many there are."""
    import numpy as np

    from localiser.edges import find_edges
    from localiser.storage import csv_of, encode_image, output_errors, safe_name, write_bytes

    image = taken.load()
    twist = None if odometry is None else camera.twist_at(odometry, taken.t_ns)
    found = find_edges(image, camera, settings.edges, mount=taken.mount, twist=twist)
    found = found.take(np.argsort(found.bearing, kind="stable"))
    about = {"image": taken.name} | ({} if odometry is None else {"t_ns": str(taken.t_ns)})
    about["detector"] = settings.edges.detector
    path = folder / "edges.csv"
    with output_errors(path):
        head = [] if path.exists() else [[*about, *COLUMNS]]
        with path.open("a", encoding="utf-8", newline="") as file:
            file.write(csv_of([*head, *([*about.values(), *row] for row in rows_of(found))]))
    if pictures:
        name = f"{number + 1:04d}_{safe_name(Path(taken.name).stem)}.png"
        write_bytes(folder / name, encode_image(picture(image, found, camera), ".png", 100))
    return len(found)


def rows_of(edges: Edges) -> list[list[Any]]:
    """Return a row for each edge with the cells of `COLUMNS`; what is not known is empty."""
    import numpy as np

    from localiser import geometry

    computed = {
        "edge": np.arange(1, len(edges) + 1),
        "slope": geometry.slope_from_lean(edges.lean),
        "slope_deg": 90.0 - np.rad2deg(edges.lean),
        "foot_right_m": edges.foot_range_m * np.sin(edges.bearing),
        "foot_back_m": -edges.foot_range_m * np.cos(edges.bearing),
    }
    ends = ("bottom_u_px", "bottom_v_px", "top_u_px", "top_v_px")
    computed |= dict(zip(ends, edges.ends_px.reshape(-1, 4).T, strict=True))
    columns = (computed.get(name, getattr(edges, name.removesuffix("_rad"), None)) for name in COLUMNS)
    values = [np.asarray(column).tolist() for column in columns]
    return [["" if math.isnan(value) else value for value in cells] for cells in zip(*values, strict=True)]


def picture(image: Image, edges: Edges, camera: Camera) -> Image:
    """Return the image (H, W) in colour, larger where it is small, with segments that are no vertical edges in grey.

    Vertical edges are blue, those whose bearing is not known to 0.1° red; each has its number at its top, and a ring
    at its lower end where that is seen on the floor.
    """
    import cv2
    import numpy as np

    zoom = max(1, -(-_LEAST_WIDTH // camera.width))
    larger = cv2.resize(image, None, fx=zoom, fy=zoom, interpolation=cv2.INTER_CUBIC) if zoom > 1 else image
    pixels = np.asarray(cv2.cvtColor(larger, cv2.COLOR_GRAY2BGR), dtype=np.uint8)

    along = np.linspace(0.0, 1.0, 9)[:, None]  # the lens bends a straight line

    def draw(ends: Array, colour: tuple[int, int, int], width: int) -> list[list[int]]:
        one, other = camera.image_from_pixels(ends)
        line = camera.pixels_from_image(one * (1.0 - along) + other * along)
        line = np.round((line + 0.5) * zoom - 0.5).astype(np.int32)
        cv2.polylines(pixels, [line], False, colour, width, cv2.LINE_AA)
        return line[[0, -1]].tolist()  # type: ignore[no-any-return]

    for ends in edges.rejected_px:
        draw(ends, (212, 205, 199), 1)
    for number, ends in enumerate(edges.ends_px):
        if not np.isfinite(ends).all():
            continue
        is_sure = edges.bearing_sigma[number] < np.deg2rad(0.1)
        bottom, top = draw(ends, (255, 140, 20) if is_sure else (60, 80, 255), 2)
        if np.isfinite(edges.foot_range_m[number]):
            cv2.circle(pixels, bottom, 6, (255, 255, 255), 1, cv2.LINE_AA)
        for colour, width in (((0, 0, 0), 3), ((255, 255, 255), 1)):
            at = (top[0] + 4, max(top[1], 14))
            cv2.putText(pixels, str(number + 1), at, cv2.FONT_HERSHEY_SIMPLEX, 0.45, colour, width, cv2.LINE_AA)
    return pixels
