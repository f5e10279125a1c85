"""Put the camera of a robot together from its messages; the same rules for a live run and for a bag.

A recording of a live run therefore has the camera that the run had, and nothing that the run refused.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from localiser.camera import Camera, Mount
from localiser.errors import InputError
from localiser.storage.bags.bag import stamp_of
from localiser.storage.bags.cameras import camera_of, intrinsics_of
from localiser.storage.bags.frames import MOST_FRAMES, MOST_FRAMES_LIVE, FrameTree, mount_of, plain_frame
from localiser.storage.bags.images import stated_size
from localiser.storage.bags.inertial import Inertial
from localiser.storage.bags.moving_frames import Link, MovingFrames, at_time, mount_at, way

_IN_RECTIFIED = "image_rect"  # what image_proc calls images with their lens distortion undone


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
    ) -> None:
        """Begin. given: the camera from a file, which comes before anything that a robot says. source: for errors.

        at_once: whether the camera is what the messages until now say, as on a robot that drives. Otherwise it is what
        all of them say, which `made` returns in the end. moving_kept: how many times of each transform that changes are
        kept; None keeps all.
        """
        self.camera = given
        self.problem = "no camera_info"
        self.size: tuple[int, int] | None = None
        self._source, self._at_once = source, at_once
        self._rectified = _IN_RECTIFIED in image_topic
        self._info: Any = None
        self.is_given = given is not None
        most = MOST_FRAMES_LIVE if at_once else MOST_FRAMES
        self._tree, self._moving = FrameTree(most), MovingFrames(moving_kept, most)
        self._ways: dict[Link, tuple[FrameTree, list[Link]]] = {}
        self._inertial = Inertial()
        self._first_ns: int | None = None
        self._optical = self._base = ""

    def take_camera(self, camera: Camera) -> None:
        """Take the camera from a file, as the argument `given`."""
        self.camera, self.is_given = camera, True

    def take_info(self, info: Any) -> None:
        """Take a CameraInfo. Raises ValueError when it differs from the one that the camera was made from."""
        settled = self._info is not None and (self.camera is not None or not self._at_once)
        if settled:
            before, now = (intrinsics_of(one, rectified=self._rectified) for one in (self._info, info))
            if changed := [name for name in now if repr(before[name]) != repr(now[name])]:
                found = ", ".join(f"{name} from {before[name]} to {now[name]}" for name in changed)
                raise ValueError(f"expected one camera, found intrinsics that change: {found:.300}")
        self._info = info
        self._look()

    def take_transforms(self, message: Any) -> None:
        """Take a TFMessage. Raises ValueError."""
        self._tree.add_all(message.transforms)
        self._ways.clear()
        self._look()

    def take_moving(self, message: Any, offset_ns: int = 0) -> None:
        """Take a TFMessage of transforms that change; offset_ns: what is added to their stamps. Raises ValueError."""
        known = len(self._moving.links)
        self._moving.add_all(message.transforms, offset_ns)
        if len(self._moving.links) > known:
            self._ways.clear()
        self._look()

    def forget_moving(self) -> None:
        """Forget the transforms that change: the clock of their stamps began anew."""
        self._moving.forget_times()

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
        """Take an Odometry."""
        if not self._base:
            self._base = plain_frame(odometry.child_frame_id)
            self._look()

    def made(self) -> Camera:
        """Return the camera by everything until now. Raises InputError; ValueError where something is missing."""
        if self._info is None:
            raise ValueError("expected a topic of sensor_msgs/CameraInfo, found none")
        mount = self._mount_at(self._first_ns or 0)
        return camera_of(self._info, mount, rectified=self._rectified, name="", source=self._source)

    def mounts(self, times_ns: Sequence[int]) -> list[Mount | None]:
        """Return the mount of the camera at each time, None where it does not move. Raises ValueError."""
        mounts = [self.mount_at(t_ns) for t_ns in times_ns]
        if not len(self._inertial):
            return mounts
        usual = self.made().mount
        return [self._levelled(mount or usual, t_ns) for mount, t_ns in zip(mounts, times_ns, strict=True)]

    def mount_reaches(self, stamp_ns: int) -> bool:
        """Whether all transforms of a mount that moves are known at a time or later; True where it does not move."""
        return all(self._moving.reaches(link, stamp_ns) for link in self._moving_links())

    def mount_at(self, stamp_ns: int) -> Mount | None:
        """Return the mount at a time, None where it does not move. Raises ValueError."""
        return self._mount_at(stamp_ns) if self._moving_links() else None

    def _levelled(self, mount: Mount, t_ns: int) -> Mount:
        """Return the mount at a time with tilt and roll by the inertial sensor."""
        frame, optical = self._inertial.frame, self._optical
        fixed, links = (FrameTree(), []) if frame == optical else self._way(frame)
        tree = at_time(fixed, self._moving, links, t_ns)
        return self._inertial.mount(mount, tree.between(optical, frame)[:3, :3], t_ns)

    def _moving_links(self) -> list[Link]:
        return [] if self.is_given else self._way(self._base)[1]

    def _way(self, start: str) -> tuple[FrameTree, list[Link]]:
        """Return the transforms from a frame to the camera's, see `way`; remembered until there are others."""
        link = start, self._optical
        if link not in self._ways:
            self._ways[link] = way(self._tree, self._moving, *link)
        return self._ways[link]

    def _mount_at(self, t_ns: int) -> Mount:
        fixed, links = self._way(self._base)
        if not links:
            return mount_of(self._tree, self._base, self._optical)
        return mount_at(fixed, self._moving, links, self._base, self._optical, t_ns)

    def _look(self) -> None:
        if not self._at_once or self.camera is not None or self._info is None:
            return
        try:
            self.camera = self.made()
        except (ValueError, InputError) as error:
            self.problem = str(error)
