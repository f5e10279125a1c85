"""Make ROS messages, and take images out of them. Bytes of a ROS 2 message are the same in a bag and on a network."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cache
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np

from localiser.camera import Camera, MountSigma
from localiser.geometry import Array, ros_cov_from_cov, ros_from_pose
from localiser.image_files import eight_bits, measure
from localiser.storage.bags.records import RosType
from localiser.storage.bags.transforms import FLOOR_ROWS, base_from_optical, quaternion_from_rotation
from localiser.storage.images import MAX_IMAGE_BYTES, Image, encode_image, suffix_of

if TYPE_CHECKING:
    from rosbags.typesys.store import Typestore

BASE, OPTICAL, ODOM, MAP = "base_link", "camera_optical_frame", "odom", "map"
_NS = 1_000_000_000


@cache
def typestore(*, ros1: bool) -> Typestore:
    """Return the message definitions of ROS 1 Noetic or ROS 2 Humble; the messages read here are the same in all."""
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_HUMBLE)
    if RosType.TRANSFORMS not in store.fielddefs:
        store.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", RosType.TRANSFORMS))
    return store


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
        """Return a message of any type; what is left out is zero or empty.

        fields: inner messages as mappings or as messages, sequences of messages as lists of messages.
        """
        from rosbags.interfaces import Nodetype

        values = {}
        for name, (node, of) in self.store.fielddefs[msgtype][1]:
            given = fields.get(name)
            if node == Nodetype.NAME:
                values[name] = (
                    self.make(str(of), **(given or {})) if given is None or isinstance(given, dict) else given
                )
            elif node == Nodetype.ARRAY:
                values[name] = np.zeros(of[1]) if given is None else np.asarray(given, dtype=np.float64)
            elif node == Nodetype.SEQUENCE:
                values[name] = _empty(of[0]) if given is None else given
            else:
                values[name] = _ZEROS.get(str(of[0]), 0) if given is None else given
        return self.store.types[msgtype](**values)

    def text(self, text: str) -> Any:
        """Return a std_msgs/String."""
        return self.make(RosType.TEXT, data=text)

    def compressed(self, t_ns: int, data: bytes, frame: str = OPTICAL) -> Any:
        """Return a sensor_msgs/CompressedImage of a JPEG or PNG file. frame: of the camera."""
        kind = "png" if suffix_of(data) == ".png" else "jpeg"
        pixels = np.frombuffer(data, np.uint8)
        return self.make(RosType.COMPRESSED, header=header(t_ns, frame), format=kind, data=pixels)

    def camera_info(self, t_ns: int, camera: Camera) -> Any:
        """Return a sensor_msgs/CameraInfo."""
        matrix = camera.matrix
        fields: dict[str, Any] = {
            "width": camera.width,
            "height": camera.height,
            "distortion_model": "" if camera.distortion_model == "none" else camera.distortion_model,
            "d": np.array(camera.distortion, dtype=np.float64),
            "k": matrix.ravel(),
            "r": np.eye(3).ravel(),
            "p": np.column_stack([matrix, np.zeros(3)]).ravel(),
        }
        if self.ros1:
            fields = {name.upper() if len(name) == 1 else name: value for name, value in fields.items()}
        return self.make(RosType.CAMERA_INFO, header=header(t_ns, OPTICAL), **fields)

    def mount(self, t_ns: int, camera: Camera) -> Any:
        """Return the tf2_msgs/TFMessage that says where the camera sits on the robot."""
        transform = base_from_optical(camera.mount, camera.level_from_camera)
        return self._transform(t_ns, BASE, OPTICAL, transform[:3, 3], quaternion_from_rotation(transform[:3, :3]))

    def inertial(self, t_ns: int, camera: Camera) -> Any:
        """Return a sensor_msgs/Imu that says tilt and roll of the camera, with the sigmas of its mount.

        Its orientation is of the camera's optical frame against east, north and up, for a camera that looks north.
        """
        up_from_level = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
        turned = up_from_level @ camera.level_from_camera @ np.diag([1.0, -1.0, -1.0])
        sigma = camera.mount.sigma or MountSigma()
        about = (sigma.tilt_rad or 0.0, (sigma.roll_rad or 0.0) * math.cos(camera.mount.tilt_rad), math.pi)
        unknown = np.array([-1.0, *np.zeros(8)])
        return self.make(
            RosType.IMU,
            header=header(t_ns, OPTICAL),
            orientation=_named("xyzw", quaternion_from_rotation(turned)),
            orientation_covariance=np.diag(np.square(about)).ravel(),
            angular_velocity_covariance=unknown,
            linear_acceleration_covariance=unknown,
        )

    def odometry(self, t_ns: int, frame: str, pose: Array) -> Any:
        """Return a nav_msgs/Odometry that says a pose (3,) and no covariance."""
        return self.make(RosType.ODOMETRY, header=header(t_ns, frame), child_frame_id=BASE, pose={"pose": _pose(pose)})

    def pose_in_map(self, t_ns: int, pose: Array, cov: Array, frame: str = MAP) -> Any:
        """Return a geometry_msgs/PoseWithCovarianceStamped of a pose (3,) in the map and its covariance (3, 3)."""
        covariance = np.zeros((6, 6))
        covariance[FLOOR_ROWS] = ros_cov_from_cov(cov)
        stated = {"pose": _pose(pose), "covariance": covariance.ravel()}
        return self.make(RosType.POSE, header=header(t_ns, frame), pose=stated)

    def map_from_odometry(self, t_ns: int, pose: Array, odometry: Array, frames: tuple[str, str] = (MAP, ODOM)) -> Any:
        """Return the tf2_msgs/TFMessage from the map to the odometry's frame (REP-105), for two poses (3,) of one time.

        Whoever follows the odometry's own transforms from there gets the pose in the map at any time since. frames:
        names of the map's and the odometry's.
        """
        (x, y, yaw), (x_odom, y_odom, yaw_odom) = ros_from_pose(pose), ros_from_pose(odometry)
        turn = float(yaw - yaw_odom)
        cos, sin = math.cos(turn), math.sin(turn)
        moved = [x - cos * x_odom + sin * y_odom, y - sin * x_odom - cos * y_odom, 0.0]
        return self._transform(t_ns, *frames, moved, _about_up(turn))

    def robot_in_odometry(self, t_ns: int, odometry: Array) -> Any:
        """Return the tf2_msgs/TFMessage from the odometry's frame to the robot, for a pose (3,) of the odometry."""
        x, y, yaw = (float(value) for value in ros_from_pose(odometry))
        return self._transform(t_ns, ODOM, BASE, [x, y, 0.0], _about_up(yaw))

    def poses(self, poses: Array) -> list[Any]:
        """Return a geometry_msgs/Pose for each of the poses (N, 3) in the map."""
        types = self.store.types
        point, turn, pose = (types[f"geometry_msgs/msg/{name}"] for name in ("Point", "Quaternion", "Pose"))
        return [
            pose(
                position=point(x=x, y=y, z=0.0),
                orientation=turn(x=0.0, y=0.0, z=math.sin(yaw / 2), w=math.cos(yaw / 2)),
            )
            for x, y, yaw in ros_from_pose(poses).tolist()
        ]

    def points(self, points: Array) -> list[Any]:
        """Return a geometry_msgs/Point for each of the points (N, 3) in the map: right, up, back."""
        point = self.store.types["geometry_msgs/msg/Point"]
        return [point(x=x, y=-z, z=y) for x, y, z in points.tolist()]

    def _transform(
        self, t_ns: int, parent: str, child: str, moved: Sequence[float] | Array, turned: Sequence[float]
    ) -> Any:
        stamped = self.make(
            "geometry_msgs/msg/TransformStamped",
            header=header(t_ns, parent),
            child_frame_id=child,
            transform={"translation": _named("xyz", moved), "rotation": _named("xyzw", turned)},
        )
        return self.make(RosType.TRANSFORMS, transforms=[stamped])


_ZEROS: dict[str, Any] = {"string": "", "bool": False, "float32": 0.0, "float64": 0.0}


def _empty(of: Any) -> Any:
    """Return an empty sequence of elements of a type."""
    from rosbags.interfaces import Nodetype

    return [] if of[0] == Nodetype.NAME or of[1][0] == "string" else np.zeros(0, dtype=of[1][0])


def header(t_ns: int, frame: str) -> dict[str, Any]:
    """Return the fields of a std_msgs/Header."""
    seconds, nanoseconds = divmod(t_ns, _NS)
    return {"stamp": {"sec": seconds, "nanosec": nanoseconds}, "frame_id": frame}


def _pose(pose: Array) -> dict[str, Any]:
    x, y, yaw = (float(value) for value in ros_from_pose(pose))
    return {"position": _named("xyz", (x, y, 0.0)), "orientation": _named("xyzw", _about_up(yaw))}


def _named(names: str, values: Sequence[float] | Array) -> dict[str, float]:
    return {name: float(value) for name, value in zip(names, values, strict=True)}


def _about_up(yaw: float) -> tuple[float, float, float, float]:
    """Return the quaternion (x, y, z, w) of a turn about the upward axis."""
    return 0.0, 0.0, float(np.sin(yaw / 2)), float(np.cos(yaw / 2))


# What a raw image becomes, and the bytes of a pixel. Bayer and YUV become colour.
_BYTES = {"mono8": 1, "8UC1": 1, "rgb8": 3, "bgr8": 3, "8UC3": 3, "rgba8": 4, "bgra8": 4, "mono16": 2, "16UC1": 2}
_TO_BGR = {"rgb8": cv2.COLOR_RGB2BGR, "rgba8": cv2.COLOR_RGBA2BGR, "bgra8": cv2.COLOR_BGRA2BGR}
_BAYER = ("RGGB", "BGGR", "GBRG", "GRBG")
_BYTES |= {f"bayer_{pattern.lower()}8": 1 for pattern in _BAYER}
_TO_BGR |= {f"bayer_{pattern.lower()}8": getattr(cv2, f"COLOR_Bayer{pattern}2BGR") for pattern in _BAYER}
_YUV = {"yuv422": "UYVY", "uyvy": "UYVY", "yuv422_yuy2": "YUY2", "yuyv": "YUY2", "nv12": "NV12", "nv21": "NV21"}
_BYTES |= {name: 2 for name, layout in _YUV.items() if not layout.startswith("NV")}
_TO_BGR |= {name: getattr(cv2, f"COLOR_YUV2BGR_{layout}") for name, layout in _YUV.items()}
_DEEP = ("mono16", "16UC1")  # whole numbers, become grey values of 8 bits by the range that they use
ENCODINGS = (*_BYTES, "nv12", "nv21")


def shows_light(message: Any, *, is_deep: bool) -> bool:
    """Whether a message shows light, not depth. is_deep: whether whole numbers of 16 bits are distances."""
    if not hasattr(message, "encoding"):
        return "compressedDepth" not in message.format
    return "FC" not in message.encoding and not (is_deep and message.encoding in _DEEP)


def stated_size(message: Any) -> tuple[int, int]:
    """Return the size (width, height) that a message says its image has. Raises ValueError when it cannot be one."""
    if not hasattr(message, "encoding"):
        return measure(message.data.tobytes())[0]
    _check_raw(message)
    return int(message.width), int(message.height)


def image_file(message: Any) -> bytes:
    """Return the image of a sensor_msgs Image or CompressedImage as a JPEG or PNG file. Raises ValueError."""
    if not hasattr(message, "encoding"):
        return bytes(message.data)
    return encode_image(_pixels(message), ".png", 100)


def grey_image(message: Any) -> Image | None:
    """Return a raw image as (H, W) uint8 grey values, the same as those of its file; None for a compressed one.

    Raises ValueError.
    """
    if not hasattr(message, "encoding"):
        return None
    pixels = _pixels(message)
    return np.asarray(cv2.cvtColor(pixels, cv2.COLOR_BGR2GRAY) if pixels.ndim == 3 else pixels, dtype=np.uint8)


def _check_raw(message: Any) -> None:
    """Raise ValueError unless an Image has as many bytes as its size and encoding ask for."""
    encoding, width, height, step = message.encoding, message.width, message.height, message.step
    if encoding not in ENCODINGS:
        raise ValueError(f"expected an encoding of {', '.join(ENCODINGS)}, found {encoding[:40]!r}")
    planar = encoding not in _BYTES
    if min(width, height) < 1 or (encoding in _YUV and width % 2) or (planar and height % 2):
        raise ValueError(f"expected an image that {encoding} can hold, found {width}×{height} pixels")
    least = width * _BYTES.get(encoding, 1)
    rows = height * 3 // 2 if planar else height
    if step < least:
        raise ValueError(f"expected rows of at least {least} bytes for {width} pixels of {encoding}, found {step}")
    if len(message.data) != step * rows:
        raise ValueError(f"expected {rows} rows of {step} bytes, found {len(message.data)} bytes")
    if len(message.data) > MAX_IMAGE_BYTES:
        raise ValueError(f"expected at most {MAX_IMAGE_BYTES} bytes, found {len(message.data)}")


def _pixels(message: Any) -> Image:
    """Return an Image as (H, W) grey or (H, W, 3) BGR uint8, the rows' padding cut off."""
    _check_raw(message)
    encoding = message.encoding
    channels = _BYTES.get(encoding, 1)
    rows = message.data.reshape(-1, message.step)[:, : message.width * channels]
    if encoding in _DEEP:
        kind = ">u2" if message.is_bigendian else "<u2"
        return eight_bits(np.ascontiguousarray(rows).view(kind))
    pixels = np.ascontiguousarray(rows.reshape(len(rows), message.width, channels) if channels > 1 else rows)
    code = _TO_BGR.get(encoding)
    return np.asarray(pixels if code is None else cv2.cvtColor(pixels, code), dtype=np.uint8)
