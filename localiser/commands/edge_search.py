"""Find edges in images: what is looked at, the loop over the images, and the rows and files that it writes."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

from localiser import geometry, storage
from localiser.calibration import check_mount
from localiser.camera import Camera, Mount
from localiser.commands.edge_picture import save_picture
from localiser.config import Config, in_force, to_yaml
from localiser.edges import EdgeParameters, Edges, find_edges, mount_error_of_edges
from localiser.errors import InputError, LocaliserError, RunEndedEarlyError
from localiser.geometry import Twist
from localiser.replay import Stop, asked_to_stop
from localiser.storage import (
    FolderReader,
    Image,
    RunFolder,
    csv_of,
    output_errors,
    read_image,
    require_new,
    safe_name,
    write_camera,
    write_text,
)

KEPT_IMAGES = 200
"""So many images tell whether the stated mount is right; a large batch is not held in memory."""
_CLEAR = 9.2  # squared Mahalanobis distance in two dimensions that chance exceeds in 1 % of the cases

Row = dict[str, Any]

# -- what is looked at ------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, eq=False)
class Taken:
    """An image to find edges in. image: its file, as it was named. stem: the name of its outputs.

    t_ns, twist, mount: its time, the robot's motion and the camera's mount, in a log.
    """

    image: str
    stem: str
    load: Callable[[], Image]
    t_ns: int | None = None
    twist: Twist | None = None
    mount: Mount | None = None


def inputs_of(paths: Sequence[Path], camera_file: Path | None) -> tuple[Camera, list[Taken]]:
    """Return the camera and the images: files that the camera of `camera_file` took, or those of one log folder.

    Images are read when they are loaded. A camera file replaces the log's own camera. Raises InputError.
    """
    logs = [path for path in paths if FolderReader().recognises(path)]
    if logs and len(paths) > 1:
        raise InputError("expected images or one log, found it among other inputs", path=logs[0])
    camera = storage.read_camera(camera_file) if camera_file else None
    if logs:
        return _of_log(logs[0], camera)
    if camera is None:
        raise InputError("expected --camera FILE: what took the images", path=paths[0])
    return camera, _of_files(paths, camera)


def _of_log(path: Path, camera: Camera | None) -> tuple[Camera, list[Taken]]:
    log = storage.open_log(path, format="folder")
    if not log.has_images:
        raise InputError("expected a log with images, found one whose edges are measured already", path=path)
    if camera and (camera.width, camera.height) != (log.camera.width, log.camera.height):
        found = f"one of {camera.width}×{camera.height}"
        raise InputError(
            f"expected a camera of {log.camera.width}×{log.camera.height} pixels, found {found}", field="--camera"
        )
    stems = stems_of([Path(image.name) for image in log.images])
    camera = camera or log.camera
    return camera, [
        Taken(image.name, stem, image.load, image.t_ns, camera.twist_at(log.odometry, image.t_ns), image.mount)
        for image, stem in zip(log.images, stems, strict=True)
    ]


def _of_files(paths: Sequence[Path], camera: Camera) -> list[Taken]:
    size = (camera.width, camera.height)
    twice = [path for path, count in Counter(paths).items() if count > 1]
    if twice:
        raise InputError("expected each image once, found it twice", path=twice[0])
    return [
        Taken(str(path), stem, lambda path=path: read_image(path, size))  # type: ignore[misc]
        for path, stem in zip(paths, stems_of(paths), strict=True)
    ]


def stems_of(paths: Sequence[Path]) -> list[str]:
    """Return names for the outputs of images: as short as keeps them apart, also where case does not count."""
    longest = max(len(path.parts) for path in paths)
    candidates = [[path.stem for path in paths]]
    candidates += [["_".join(path.parts[-parts:]) for path in paths] for parts in range(1, longest + 1)]
    for names in candidates:
        safe = [safe_name(name) for name in names]
        if len({name.lower() for name in safe}) == len(paths):
            return safe
    return [f"{index}_{safe_name(path.stem)}" for index, path in enumerate(paths, 1)]


# -- the loop ---------------------------------------------------------------------------------------------------------


@dataclass(slots=True)
class EdgeSearch:
    """Images of one camera in which edges are looked for.

    out: new or empty folder for results, else results/edges/1, 2, …. pictures: whether to draw what was found.
    last, mount: what was found in the image that was done last, and tilt and roll by that (degrees). kept: what was
    found in the first `KEPT_IMAGES`. counts, ms: how many edges each image had, and how long it took.
    """

    camera: Camera
    images: Sequence[Taken]
    config: Config
    out: Path | None = None
    pictures: bool = True
    folder: Path = field(init=False)
    last: Edges = field(init=False)
    mount: dict[str, float] = field(init=False)
    kept: list[Edges] = field(init=False, default_factory=list)
    counts: list[int] = field(init=False, default_factory=list)
    ms: list[float] = field(init=False, default_factory=list)

    def run(self, progress: Callable[[], None]) -> None:
        """Find the edges of all images, calling `progress` after each.

        Raises RunEndedEarlyError at the first image that is not what it should be, or when the user stops it; what
        was done until then is on disk.
        """
        first = self.images[0].load()  # a wrong camera is told before a folder is made
        self._find(first, self.images[0])  # what the detector makes once for a camera is in no image's time
        self.folder = self._new_folder()
        write_camera(self.camera, self.folder / "camera.yaml")
        write_text(self.folder / "config.yaml", to_yaml(in_force(self.config)))
        asked = Stop()
        try:
            with asked_to_stop() as asked:
                for taken in self.images:
                    if asked.is_set():
                        raise KeyboardInterrupt
                    self._one(taken, taken.load())
                    progress()
        except (KeyboardInterrupt, LocaliserError) as error:
            reason, exit_code = "stopped", asked.exit_code
            if isinstance(error, LocaliserError):
                reason, exit_code = str(error), error.exit_code
            done = f"The run ended after {len(self.counts)} of {len(self.images)} images"
            raise RunEndedEarlyError(f"{reason}. {done}; what was done is in {self.folder}", exit_code) from error

    def _new_folder(self) -> Path:
        """Return the folder of the results, made. Raises OutputError when it holds something already."""
        if self.out is None:
            return RunFolder.create(Path("results"), "edges").path
        require_new(self.out)
        with output_errors(self.out):
            self.out.mkdir(parents=True, exist_ok=True)
        return self.out

    def _find(self, image: Image, taken: Taken) -> Edges:
        """Return the edges of an image, from left to right."""
        edges = find_edges(image, self.camera, self.config.edges, mount=taken.mount, twist=taken.twist)
        return edges.take(np.argsort(edges.bearing, kind="stable"))

    def _one(self, taken: Taken, image: Image) -> None:
        begin = perf_counter()
        self.last = self._find(image, taken)
        self.ms.append(1e3 * (perf_counter() - begin))
        camera = self.camera.at(taken.mount)
        self.mount = mount_by_edges(self.last, camera, self.config.edges)
        self.counts.append(len(self.last))
        if len(self.kept) < KEPT_IMAGES:
            self.kept.append(self.last)
        self._write(taken)
        if self.pictures:
            title = Path(taken.image).name
            save_picture(self.folder / f"{taken.stem}.png", image, camera, self.last, title=title)

    def _write(self, taken: Taken) -> None:
        """Append what was found in an image to edges.csv, which so survives a stop."""
        about = {"image": taken.image, **({} if taken.t_ns is None else {"t_ns": taken.t_ns})}
        detector = self.config.edges.detector
        path = self.folder / "edges.csv"
        with output_errors(path):
            table = [{**about, "detector": detector, **row} for row in rows_of(self.last)]
            text = csv_text([*about, "detector", *COLUMNS], table, header=not path.exists())
            with path.open("a", encoding="utf-8", newline="") as file:
                file.write(text)

    def mount_warning(self) -> str | None:
        """Return a text where the edges contradict the stated mount clearly, else None; see `check_mount`.

        Nothing says how far apart images were taken, so all together are as certain as one of them. One image may
        well contradict the truth by a sigma of what is stated, so more is asked than of a whole run.
        """
        believed_rad = self.config.edges.mount_sigma_rad
        check = check_mount(self.kept, np.zeros((len(self.kept), 3)), self.camera, believed_rad)
        off, cov = check.mount - check.stated, check.cov + np.diag(believed_rad**2)
        if not check.disagrees or off @ np.linalg.solve(cov, off) <= _CLEAR:
            return None
        stated, found, sigma = (np.rad2deg(values) for values in (check.stated, check.mount, check.sigma))
        return (
            f"The lines say that the camera's tilt is {found[0]:z.1f}° ± {sigma[0]:.1f}° and its roll "
            f"{found[1]:z.1f}° ± {sigma[1]:.1f}°; stated are {stated[0]:.2f}° and {stated[1]:.2f}°. Until the camera "
            "file is right, edges are missed and bearings are off. See `localiser camera tilt`."
        )


# -- rows -------------------------------------------------------------------------------------------------------------

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


def rows_of(edges: Edges) -> list[Row]:
    """Return one row an edge with the keys of `COLUMNS`; what is not known is nan."""
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
    return [dict(zip(COLUMNS, cells, strict=True)) for cells in zip(*values, strict=True)]


def mount_by_edges(edges: Edges, camera: Camera, parameters: EdgeParameters) -> dict[str, float]:
    """Return the tilt and roll of the camera by the edges of one image, from what is stated and how certain that is."""
    stated = np.array([camera.mount.tilt_rad, camera.mount.roll_rad])
    plumb_rad = float(np.deg2rad(parameters.plumb_sigma_deg))
    error = mount_error_of_edges(edges, camera, parameters.mount_sigma_rad, plumb_rad)
    found = np.rad2deg([stated + error.mean, np.sqrt(np.diag(error.cov))])
    return dict(zip(("tilt_deg", "roll_deg", "tilt_sigma_deg", "roll_sigma_deg"), found.ravel().tolist(), strict=True))


def csv_text(columns: Iterable[str], rows: Iterable[Mapping[str, Any]], *, header: bool = True) -> str:
    """Return rows as CSV; nan and None are empty cells, numbers read back to the same value."""
    names = list(columns)
    head = [names] if header else []
    return csv_of([*head, *([_cell(row[name]) for name in names] for row in rows)])


def _cell(value: object) -> object:
    return "" if value is None or (isinstance(value, float) and math.isnan(value)) else value
