"""What edges are looked for in: image files with a camera, or the images of a log."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from localiser import storage
from localiser.camera import Camera
from localiser.errors import InputError
from localiser.geometry import Twist
from localiser.storage import FolderReader, Image, read_image, safe_name


@dataclass(frozen=True, slots=True, eq=False)
class Taken:
    """An image to find edges in. image: its file, as it was named. stem: the name of its outputs.

    t_ns, twist: its time and the robot's motion, in a log.
    """

    image: str
    stem: str
    load: Callable[[], Image]
    t_ns: int | None = None
    twist: Twist | None = None


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
        Taken(image.name, stem, image.load, image.t_ns, camera.twist_at(log.odometry, image.t_ns))
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
