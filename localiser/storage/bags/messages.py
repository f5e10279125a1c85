"""What this program has to say, as ROS messages; on the wire a ROS 2 message is what a bag holds of it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from localiser.camera import Camera
from localiser.geometry import Array, ros_cov_from_cov, ros_from_pose
from localiser.storage.bags.bag import POSE, TEXT, TRANSFORMS, typestore
from localiser.storage.bags.cameras import info_fields
from localiser.storage.bags.frames import base_from_optical, quaternion_from_rotation
from localiser.storage.images import suffix_of

BASE, OPTICAL, ODOM, MAP = "base_link", "camera_optical_frame", "odom", "map"
_NS = 1_000_000_000
_FLOOR_ROWS = np.ix_((0, 1, 5), (0, 1, 5))  # x, y, yaw among x, y, z and the turns about them


class Messages:
    """Makes messages, and turns them into bytes."""

    def __init__(self, *, ros1: bool = False) -> None:
        """Take the definitions of ROS 1 or ROS 2."""
        self.ros1 = ros1
        self.store = typestore(ros1=ros1)

    def encode(self, message: Any) -> bytes:
        """Return the bytes of a message: CDR for ROS 2."""
        encode = self.store.serialize_ros1 if self.ros1 else self.store.serialize_cdr
        return bytes(encode(message, message.__msgtype__))

    def make(self, msgtype: str, **fields: Any) -> Any:
        """Return a message of any type."""
        return self.store.types[msgtype](**fields)

    def header(self, t_ns: int, frame: str) -> Any:
        """Return a header with a stamp."""
        seconds, nanoseconds = divmod(t_ns, _NS)
        stamp = self.make("builtin_interfaces/msg/Time", sec=seconds, nanosec=nanoseconds)
        return self.make("std_msgs/msg/Header", stamp=stamp, frame_id=frame, **({"seq": 0} if self.ros1 else {}))

    def text(self, text: str) -> Any:
        """Return a std_msgs/String."""
        return self.make(TEXT, data=text)

    # -- images and cameras -----------------------------------------------------------------------------------------

    def compressed(self, t_ns: int, data: bytes) -> Any:
        """Return a sensor_msgs/CompressedImage of a JPEG or PNG file."""
        return self.make(
            "sensor_msgs/msg/CompressedImage",
            header=self.header(t_ns, OPTICAL),
            format="png" if suffix_of(data) == ".png" else "jpeg",
            data=np.frombuffer(data, dtype=np.uint8),
        )

    def camera_info(self, t_ns: int, camera: Camera) -> Any:
        """Return a sensor_msgs/CameraInfo."""
        region = self.make(
            "sensor_msgs/msg/RegionOfInterest", x_offset=0, y_offset=0, height=0, width=0, do_rectify=False
        )
        fields: dict[str, Any] = {"binning_x": 0, "binning_y": 0, "roi": region}
        for name, value in info_fields(camera).items():
            numbers = np.array(value, dtype=np.float64) if isinstance(value, list) else value
            fields[name.upper() if self.ros1 and len(name) == 1 else name] = numbers
        return self.make("sensor_msgs/msg/CameraInfo", header=self.header(t_ns, OPTICAL), **fields)

    def mount(self, t_ns: int, camera: Camera) -> Any:
        """Return the tf2_msgs/TFMessage that says where the camera sits on the robot."""
        transform = base_from_optical(camera.mount, camera.level_from_camera)
        turned = quaternion_from_rotation(transform[:3, :3])
        return self._transforms(t_ns, BASE, OPTICAL, transform[:3, 3].tolist(), turned)

    # -- poses ------------------------------------------------------------------------------------------------------

    def odometry(self, t_ns: int, frame: str, pose: Array) -> Any:
        """Return a nav_msgs/Odometry that says a pose (3,) and no covariance."""
        zero = self._vector(0.0, 0.0, 0.0)
        return self.make(
            "nav_msgs/msg/Odometry",
            header=self.header(t_ns, frame),
            child_frame_id=BASE,
            pose=self._pose(pose, np.zeros((3, 3))),
            twist=self.make(
                "geometry_msgs/msg/TwistWithCovariance",
                twist=self.make("geometry_msgs/msg/Twist", linear=zero, angular=zero),
                covariance=np.zeros(36),
            ),
        )

    def pose_in_map(self, t_ns: int, pose: Array, cov: Array) -> Any:
        """Return a geometry_msgs/PoseWithCovarianceStamped of a pose (3,) in the map and its covariance (3, 3)."""
        return self.make(POSE, header=self.header(t_ns, MAP), pose=self._pose(pose, cov))

    def map_from_odometry(self, t_ns: int, pose: Array, odometry: Array) -> Any:
        """Return the tf2_msgs/TFMessage from the map to the odometry's frame (REP-105), for two poses (3,) of one time.

        Whoever follows the odometry's own transforms from there gets the pose in the map at any time since.
        """
        (x, y, yaw), (x_odom, y_odom, yaw_odom) = ros_from_pose(pose), ros_from_pose(odometry)
        turn = float(yaw - yaw_odom)
        cos, sin = math.cos(turn), math.sin(turn)
        moved = [float(x - cos * x_odom + sin * y_odom), float(y - sin * x_odom - cos * y_odom), 0.0]
        return self._transforms(t_ns, MAP, ODOM, moved, _about_up(turn))

    def _pose(self, pose: Array, cov: Array) -> Any:
        x, y, yaw = (float(value) for value in ros_from_pose(pose))
        covariance = np.zeros((6, 6))
        covariance[_FLOOR_ROWS] = ros_cov_from_cov(cov)
        position = self.make("geometry_msgs/msg/Point", x=x, y=y, z=0.0)
        return self.make(
            "geometry_msgs/msg/PoseWithCovariance",
            pose=self.make("geometry_msgs/msg/Pose", position=position, orientation=self._quaternion(_about_up(yaw))),
            covariance=covariance.ravel(),
        )

    def _transforms(self, t_ns: int, parent: str, child: str, moved: Sequence[float], turned: Sequence[float]) -> Any:
        stamped = self.make(
            "geometry_msgs/msg/TransformStamped",
            header=self.header(t_ns, parent),
            child_frame_id=child,
            transform=self.make(
                "geometry_msgs/msg/Transform", translation=self._vector(*moved), rotation=self._quaternion(turned)
            ),
        )
        return self.make(TRANSFORMS, transforms=[stamped])

    def _vector(self, x: float, y: float, z: float) -> Any:
        return self.make("geometry_msgs/msg/Vector3", x=x, y=y, z=z)

    def _quaternion(self, turned: Sequence[float]) -> Any:
        x, y, z, w = turned
        return self.make("geometry_msgs/msg/Quaternion", x=x, y=y, z=z, w=w)


def _about_up(yaw: float) -> tuple[float, float, float, float]:
    """Return the quaternion (x, y, z, w) of a turn about the upward axis."""
    return 0.0, 0.0, float(np.sin(yaw / 2)), float(np.cos(yaw / 2))
