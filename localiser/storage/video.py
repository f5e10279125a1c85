"""Read a video file as a log, with odometry and camera in two other files; frames are decoded one by one."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from localiser.camera import Camera
from localiser.documents import plain_name, require_regular, text_of
from localiser.errors import InputError
from localiser.image_files import MOST_PIXELS, MOST_SCANS
from localiser.storage.cameras import read_camera
from localiser.storage.images import check_size, encode_image, image_event, warn_turned
from localiser.storage.log import NO_ODOMETRY, VISION_ALONE, Log, require_overlap
from localiser.storage.trajectories import read_poses


def read_video(path: Path, odometry: Path | None, camera: Path, start_ns: int | None = None) -> Log:
    """Return the log of a video; its frames are counted now and decoded later.

    odometry: see `read_poses`; None for a log of images alone, whose times begin at 0. camera: camera file with the
    mount. start_ns: when the first frame was taken, by the clock of the odometry; by default with the first pose.
    Raises InputError.
    """
    poses = NO_ODOMETRY if odometry is None else read_poses(odometry)
    known = read_camera(camera)
    first_ns = next(iter(poses.t_ns.tolist()), 0) if start_ns is None else start_ns
    video = _Video(path, (known.width, known.height))
    frames = [
        image_event(
            first_ns + t_ns,
            f"{path.name}/{index:06d}",
            partial(video.file, index),
            video.size,
            path=path,
            field=f"frame {index}",
        )
        for index, t_ns in enumerate(_times_ns(path, known))
    ]
    settings = {} if len(poses) else VISION_ALONE
    return require_overlap(Log(plain_name(path.stem), path, known, poses, frames, settings=settings))


_JPEG_CODECS, _PNG_CODECS = ("MJPG", "mjpb", "mjpe"), ("MPNG", "apng")  # as OpenCV calls them
_SCAN = b"\xff\xda"


def _open(path: Path) -> Any:
    """Return the open video; by FFmpeg alone, for which a name with % or :// is still a file.

    Frames that are PNG files are refused: FFmpeg unpacks what is beside the pixels, too, to any size.
    """
    require_regular(path, "video")
    capture = _by_ffmpeg(text_of(path.resolve()))
    if capture is None:
        raise InputError("expected a video that can be decoded", path=path)
    capture.set(cv2.CAP_PROP_ORIENTATION_AUTO, 0)  # frames as they are stored, as images are
    return capture


def open_stream(address: str) -> tuple[Any, bool] | None:
    """Return an open video or stream, and whether its frames come as JPEG files, not decoded; None where it is gone.

    Other codecs are decoded by FFmpeg, which bounds what they take by the size. Raises InputError where that is more
    than an image may have, or a frame is a PNG file.
    """
    capture = _by_ffmpeg(address)
    if capture is None:
        return None
    width, height = (int(capture.get(of)) for of in (cv2.CAP_PROP_FRAME_WIDTH, cv2.CAP_PROP_FRAME_HEIGHT))
    if width * height > MOST_PIXELS:
        raise InputError(f"expected images of at most {MOST_PIXELS} pixels, found {width}×{height}", path=address)
    return capture, _codec(capture) in _JPEG_CODECS and bool(capture.set(cv2.CAP_PROP_FORMAT, -1))


def _by_ffmpeg(address: str) -> Any | None:
    capture = cv2.VideoCapture(address, cv2.CAP_FFMPEG)
    if not capture.isOpened():
        return None
    if _codec(capture) in _PNG_CODECS:
        raise InputError("expected frames of H.264 or another codec for video, found PNG; convert them", path=address)
    return capture


def _codec(capture: Any) -> str:
    return (int(capture.get(cv2.CAP_PROP_FOURCC)) % 2**32).to_bytes(4, "little").decode("latin-1")


def _check_scans(path: Path) -> None:
    """Raise InputError where a frame that is a JPEG file has too many scans; no frame is decoded."""
    capture = _open(path)
    if _codec(capture) in _JPEG_CODECS and capture.set(cv2.CAP_PROP_FORMAT, -1):
        frame = 0
        while capture.grab():
            _, file = capture.retrieve()
            if file is not None and file.tobytes().count(_SCAN) > MOST_SCANS:
                problem = f"expected a JPEG of at most {MOST_SCANS} scans, found more"
                raise InputError(problem, path=path, field=f"frame {frame}")
            frame += 1
    capture.release()


def _times_ns(path: Path, camera: Camera) -> list[int]:
    """Return the times (T,) of all frames after the first."""
    _check_scans(path)
    capture = _open(path)
    size = (int(capture.get(cv2.CAP_PROP_FRAME_WIDTH)), int(capture.get(cv2.CAP_PROP_FRAME_HEIGHT)))
    check_size(path, size, (camera.width, camera.height))
    warn_turned(int(capture.get(cv2.CAP_PROP_ORIENTATION_META)) % 360, path)
    times = []
    while capture.grab():
        times.append(round(capture.get(cv2.CAP_PROP_POS_MSEC) * 1e6))
    capture.release()
    if not times:
        raise InputError("expected a video with at least one frame, found none", path=path)
    for frame, (before, time) in enumerate(pairwise(times), start=1):
        if time <= before:
            problem = f"expected frames with times that increase, found {time} ns after {before} ns"
            raise InputError(problem, path=path, field=f"frame {frame}")
    return [t_ns - times[0] for t_ns in times]


JPEG_QUALITY = 90


@dataclass(slots=True, eq=False)
class _Video:
    """Decodes frames of a video: in order each once, in any other order from the start again."""

    path: Path
    size: tuple[int, int]
    _capture: Any = None
    _next: int = 0
    _last: tuple[int, bytes] = field(default=(-1, b""))

    def file(self, index: int) -> bytes:
        """Return a frame as an image file."""
        if self._last[0] != index:
            if self._capture is None or index < self._next:
                self._capture, self._next = _open(self.path), 0
            while self._next < index and self._capture.grab():
                self._next += 1
            done, image = self._capture.read()
            if not done or image.shape[1::-1] != self.size:
                raise InputError("expected a frame that can be decoded", path=self.path, field=f"frame {index}")
            self._next = index + 1
            self._last = (index, encode_image(np.asarray(image, dtype=np.uint8), ".jpg", JPEG_QUALITY))
        return self._last[1]
