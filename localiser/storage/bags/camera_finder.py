"""Put the camera of a robot together from its messages; the same rules for a live run and for a bag.

A recording of a live run therefore has the camera that the run had, and nothing that the run refused. Intrinsics are
those of sensor_msgs/CameraInfo, the mount that of transforms, tilt and roll by an inertial sensor where there is one.
"""

from __future__ import annotations

import math
import re
from array import array
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from localiser.camera import Camera, Mount, MountSigma
from localiser.documents import Document, Place
from localiser.errors import InputError
from localiser.geometry import Array
from localiser.motion import up_of
from localiser.storage.bags.messages import stated_size
from localiser.storage.bags.transforms import (
    MOST_APART_S,
    MOST_FRAMES,
    MOST_FRAMES_LIVE,
    FrameTree,
    Link,
    around,
    mount_links,
    mount_of,
    plain_frame,
    rotation_from_quaternion,
    rounded_angle,
    stamp_of,
)
from localiser.storage.cameras import camera_from_document, ros_keys

_RECTIFIED = {"rect", "rectified", "undistorted"}  # words of names of images with their lens distortion undone
_RAW = {"raw", "mono", "unrectified", "distorted"}  # and of those as the camera took them, as image_proc has it
_CAMERA_FROM_OPTICAL = np.diag([1.0, -1.0, -1.0])
_LEAST_SIGMA_RAD = 1e-9  # below it nothing is stated
_UNKNOWN = -1.0  # how ROS says that a sensor has no orientation
_COLUMNS = 20


def is_rectified(topic: str) -> bool | None:
    """Return whether images had their lens distortion undone, by the name of their topic; None where it does not say.

    A name that ends in `image_color` says that they had not, as ROS's image_proc names its images.
    """
    words = set(re.split(r"[/_\-]", topic.lower()))
    ends = topic.lower().removesuffix("/compressed").endswith("image_color")
    return True if words & _RECTIFIED else False if words & _RAW or ends else None


class CameraFinder:
    """Puts the camera together from CameraInfo, fixed transforms, and whose frames images and odometry name first.

    camera: None until it is known. problem: why it is not known. size: (width, height) of images, once that is known.
    """

    def __init__(
        self,
        given: Camera | None,
        image_topic: str,
        source: str = "",
        *,
        at_once: bool = True,
        moving_kept: int | None = None,
        rectified: bool | None = None,
    ) -> None:
        """Begin. given: the camera from a file, which comes before anything that a robot says. source: for errors.

        at_once: whether the camera is what the messages until now say, as on a robot that drives. Otherwise it is what
        all of them say, which `made` returns in the end. moving_kept: how many times of each transform that changes are
        kept; None keeps all. rectified: whether images had their lens distortion undone; None: as the topic says.
        """
        self.camera = given
        self.problem = "no camera_info"
        self.size: tuple[int, int] | None = None
        self._source, self._at_once = source, at_once
        self._topic, self._rectified = image_topic, is_rectified(image_topic) if rectified is None else rectified
        self._info: Any = None
        self.is_given = given is not None
        self._tree = FrameTree(MOST_FRAMES_LIVE if at_once else MOST_FRAMES, moving_kept)
        self._inertial = Inertial()
        self._first_ns: int | None = None
        self._optical = self._base = ""

    @property
    def floor(self) -> str:
        """The frame above which heights are."""
        return self._tree.floor_of(self._base) or self._base

    def take_camera(self, camera: Camera) -> None:
        """Take the camera from a file, as the argument `given`."""
        self.camera, self.is_given = camera, True

    def take_info(self, info: Any) -> None:
        """Take a CameraInfo. Raises ValueError when it differs from the one that the camera was made from."""
        settled = self._info is not None and (self.camera is not None or not self._at_once)
        if settled:
            before, now = (intrinsics_of(one, rectified=bool(self._rectified)) for one in (self._info, info))
            if changed := [name for name in now if repr(before[name]) != repr(now[name])]:
                found = ", ".join(f"{name} from {before[name]} to {now[name]}" for name in changed)
                raise ValueError(f"expected one camera, found intrinsics that change: {found:.300}")
        self._info = info
        self._look()

    def take_transforms(self, message: Any) -> None:
        """Take a TFMessage. Raises ValueError."""
        self._tree.add_all(message.transforms)
        self._look()

    def take_moving(self, message: Any, offset_ns: int = 0) -> None:
        """Take a TFMessage of transforms that change; offset_ns: what is added to their stamps. Raises ValueError."""
        self._tree.add_moving(message.transforms, offset_ns)
        self._look()

    def forget_moving(self) -> None:
        """Forget the transforms that change: the clock of their stamps began anew."""
        self._tree.forget_times()

    def take_inertial(self, message: Any, offset_ns: int = 0) -> None:
        """Take an Imu; offset_ns: what is added to its stamp. Raises ValueError."""
        self._inertial.take(message, stamp_of(message) + offset_ns)

    def take_image(self, image: Any) -> None:
        """Take an image. Raises ValueError when it has no size, or another than the camera.

        Before the camera is known, images of any size may come where the camera is looked for at once: they are not
        used. Otherwise all have the size of the first.
        """
        size = stated_size(image)
        if not self._optical:
            self._optical, self._first_ns = plain_frame(image.header.frame_id), stamp_of(image)
            self._look()
        elif self._at_once and self.camera is None:  # transforms may have come since the image before
            self._first_ns = stamp_of(image)
            self._look()
        if self._at_once:
            self.size = None if self.camera is None else (self.camera.width, self.camera.height)
        expected = self.size or size
        if size != expected:
            why = "as the camera says" if self._at_once else "as the first has"
            raise ValueError(f"expected images of {expected[0]}×{expected[1]} pixels, {why}, found {size[0]}×{size[1]}")
        if not self._at_once:
            self.size = size

    def take_odometry(self, odometry: Any) -> None:
        """Take an Odometry, or other poses that name the robot's frame."""
        if not self._base:
            self._base = plain_frame(getattr(odometry, "child_frame_id", ""))
            self._look()

    def made(self) -> Camera:
        """Return the camera by everything until now. Raises InputError; ValueError where something is missing."""
        if self._info is None:
            raise ValueError("expected a topic of sensor_msgs/CameraInfo, found none")
        if not self._base:
            raise ValueError("expected odometry that names the robot's frame (child_frame_id), found none")
        mount = mount_of(self._tree, self._base, self._optical, self._first_ns or 0)
        if self._rectified is None and is_ambiguous(self._info):
            name = self._topic
            raise ValueError(
                f"expected a name that says whether images had their lens distortion undone, found {name}, with D that "
                f"is not 0 and P that is not K; say --topic image_raw={name}, or image_rect={name} where it is undone"
            )
        return camera_of(self._info, mount, rectified=bool(self._rectified), source=self._source)

    def mounts(self, times_ns: Sequence[int]) -> list[Mount | None]:
        """Return the mount of the camera at each time, None where it does not move. Raises ValueError."""
        mounts = [self.mount_at(t_ns) for t_ns in times_ns]
        if not len(self._inertial):
            return mounts
        usual = self.made().mount
        levelled: list[Mount | None] = []
        for mount, t_ns in zip(mounts, times_ns, strict=True):
            optical_from_sensor = self._tree.between(self._optical, self._inertial.frame, t_ns)
            levelled.append(self._inertial.mount(mount or usual, optical_from_sensor[:3, :3], t_ns))
        return levelled

    def mount_reaches(self, stamp_ns: int) -> bool:
        """Whether all transforms of a mount that moves are known at a time or later; True where it does not move."""
        return all(self._tree.reaches(link, stamp_ns) for link in self._moving_links())

    def mount_at(self, stamp_ns: int) -> Mount | None:
        """Return the mount at a time, None where it does not move. Raises ValueError."""
        return mount_of(self._tree, self._base, self._optical, stamp_ns) if self._moving_links() else None

    def _moving_links(self) -> list[Link]:
        return [] if self.is_given else mount_links(self._tree, self._base, self._optical)

    def _look(self) -> None:
        if not self._at_once or self.camera is not None or self._info is None:
            return
        try:
            self.camera = self.made()
        except (ValueError, InputError) as error:
            self.problem = str(error)


# -- intrinsics --------------------------------------------------------------------------------------------------------


def camera_of(info: Any, mount: Mount, *, rectified: bool, source: str) -> Camera:
    """Return the camera that a CameraInfo describes, checked as a camera file is.

    rectified: whether the images had their lens distortion undone, and are those of the projection matrix. source: the
    bag, for errors. Raises InputError.
    """
    document = Document(_camera_file(info, rectified), {(): Place(source)})
    region = info.roi
    if info.binning_x > 1 or info.binning_y > 1 or region.x_offset or region.y_offset or region.do_rectify:
        raise document.error(("binning",), "expected images of the whole sensor, found binning or a region of interest")
    return replace(camera_from_document(document), mount=mount, name="")


def is_ambiguous(info: Any) -> bool:
    """Whether a CameraInfo is of two cameras, that of raw and that of rectified images, both of which it states."""
    coefficients, matrix, projection = (_array(info, name) for name in "dkp")
    rectified = np.array([*projection[0:3], *projection[4:7], *projection[8:11]])
    return any(coefficients) and any(projection) and not np.allclose(rectified, matrix, rtol=1e-6)


def intrinsics_of(info: Any, *, rectified: bool) -> dict[str, Any]:
    """Return all of a CameraInfo that a camera is made from, by name, to be compared with another's."""
    region = info.roi
    part = {
        "binning": (int(info.binning_x), int(info.binning_y)),
        "roi": (int(region.x_offset), int(region.y_offset), bool(region.do_rectify)),
    }
    return _camera_file(info, rectified) | part


def _camera_file(info: Any, rectified: bool) -> dict[str, Any]:
    """Return a CameraInfo as a camera file has it; ROS 1 writes the matrices' names in capitals."""
    coefficients, matrix, projection, rotation = (_array(info, name) for name in "dkpr")
    model = info.distortion_model or "none"
    if rectified:
        matrix = [*projection[0:3], *projection[4:7], *projection[8:11]]
        model, coefficients = "none", []
    if model == "none" and not any(coefficients):
        coefficients = []
    data = ros_keys([int(info.width), int(info.height)], matrix, model, coefficients)
    data["mount"] = {"tilt_deg": 0.0, "height_m": 1.0}  # replaced by what the transforms say
    if rectified:
        data["rectification_matrix"] = {"rows": 3, "cols": 3, "data": rotation}
    return data


def _array(info: Any, name: str) -> list[float]:
    values = getattr(info, name, None)
    values = getattr(info, name.upper()) if values is None else values
    return [float(value) for value in values[:100]]


# -- an inertial sensor ------------------------------------------------------------------------------------------------


class Inertial:
    """Messages of one sensor_msgs/Imu topic. frame: of the sensor."""

    def __init__(self) -> None:
        """Start with none."""
        self.frame = ""
        self._times, self._values = array("q"), array("d")
        self._known: tuple[NDArray[np.int64], Array, Array] | None = None

    def __len__(self) -> int:
        return len(self._times)

    def take(self, message: Any, stamp_ns: int) -> None:
        """Add a message. Raises ValueError when its frame changes or a number is not finite."""
        frame = plain_frame(message.header.frame_id)
        if self.frame not in ("", frame):
            raise ValueError(f"expected one inertial sensor, found frames {self.frame!r} and {frame!r}")
        turned, rate, pulled = message.orientation, message.angular_velocity, message.linear_acceleration
        numbers = [turned.x, turned.y, turned.z, turned.w, *np.asarray(message.orientation_covariance)[:9]]
        numbers += [rate.x, rate.y, rate.z, pulled.x, pulled.y, pulled.z]
        if not np.isfinite(numbers).all():
            raise ValueError("expected finite numbers of an inertial sensor, found others")
        self.frame, self._known = frame, None
        self._times.append(stamp_ns)
        self._values.extend([*map(float, numbers), 0.0])

    def mount(self, mount: Mount, optical_from_sensor: Array, t_ns: int) -> Mount:
        """Return the mount with tilt and roll, and their sigmas, as the sensor tells them at a time.

        optical_from_sensor: (3, 3). Raises ValueError where the sensor was silent.
        """
        times, up, cov = self._fused()
        first, last, share = around(times, t_ns)
        near = first if t_ns - times[first] <= abs(times[last] - t_ns) else last
        apart_s = abs(int(times[near]) - t_ns) / 1e9
        if apart_s > MOST_APART_S:
            raise ValueError(
                f"expected an inertial sensor within {MOST_APART_S} s of the image at {t_ns} ns, found it silent for "
                f"{apart_s:.3g} s"
            )
        camera_from_sensor = _CAMERA_FROM_OPTICAL @ optical_from_sensor
        upward = camera_from_sensor @ ((1.0 - share) * up[first] + share * up[last])
        return _leaning(mount, upward / np.linalg.norm(upward), camera_from_sensor @ cov[near] @ camera_from_sensor.T)

    def _fused(self) -> tuple[NDArray[np.int64], Array, Array]:
        """Return times (T,), up (T, 3) in the sensor's axes, and the covariance (T, 3, 3) of turns about these."""
        if self._known is None:
            times = np.array(self._times, dtype=np.int64)
            values = np.array(self._values).reshape(-1, _COLUMNS)
            times, index = np.unique(times, return_index=True)
            values = values[index]
            if (values[:, 4] == _UNKNOWN).any():
                self._known = times, *up_of(times, values[:, 13:16], values[:, 16:19])
            else:
                turned = np.array([rotation_from_quaternion(*row[:4]) for row in values])
                cov = values[:, 4:13].reshape(-1, 3, 3)
                self._known = times, turned[:, 2], np.einsum("tji,tjk,tkl->til", turned, cov, turned)
        return self._known


def _leaning(mount: Mount, up: Array, cov: Array) -> Mount:
    """Return the mount of a camera for which `up` (3,) is up; cov: (3, 3) of turns about its axes (right, up, back).

    Tilt and roll are those with which `Camera.level_from_camera` has that middle row.
    """
    level = math.hypot(up[0], up[1])
    if level < 1e-2:
        raise ValueError("expected a camera that does not look straight up or down")
    by_up = np.array([[0.0, 0.0, 1.0 / level], [-up[1] / level**2, up[0] / level**2, 0.0]])
    turns = np.array([[0.0, -up[2], up[1]], [up[2], 0.0, -up[0]], [-up[1], up[0], 0.0]])
    jacobian = by_up @ turns
    variance = np.maximum(np.diag(jacobian @ cov @ jacobian.T), 0.0)
    tilt, roll = (sigma if sigma > _LEAST_SIGMA_RAD else None for sigma in np.sqrt(variance).tolist())
    known = {"tilt_rad": tilt and rounded_angle(tilt), "roll_rad": roll and rounded_angle(roll)}
    stated = replace(mount.sigma or MountSigma(), **known)
    return replace(
        mount,
        tilt_rad=rounded_angle(math.atan2(up[2], level)),
        roll_rad=rounded_angle(math.atan2(-up[0], up[1])),
        sigma=None if stated == MountSigma() else stated,
    )
