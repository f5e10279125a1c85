"""The robot's part of a world file: camera, drive, and errors of odometry and images."""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, model_validator

from localiser import geometry
from localiser.camera import DISTORTION_COUNTS, Camera, Mount, RollingShutter
from localiser.geometry import Array

# YAML knows lists, not tuples; the numbers inside stay strict.
Metres = Annotated[float, Field(ge=-1e5, le=1e5)]
Degrees = Annotated[float, Field(ge=-3600, le=3600)]
Point = Annotated[tuple[Metres, Metres], Field(strict=False)]
Pixels = Annotated[float, Field(ge=-1e6, le=1e6)]
Positive = Annotated[float, Field(gt=0, le=1e5)]
NotNegative = Annotated[float, Field(ge=0, le=1e5)]


class Model(BaseModel):
    """A part of a world file: strict types, no unknown keys, no nan."""

    model_config = ConfigDict(strict=True, extra="forbid", frozen=True, allow_inf_nan=False)


class MountSpec(Model):
    """Where the camera sits on the robot, as in a log's camera file."""

    tilt_deg: Annotated[float, Field(ge=-45, le=60)]
    height_m: Positive
    roll_deg: Annotated[float, Field(ge=-45, le=45)] = 0.0
    yaw_deg: Degrees = 0.0
    right_m: Metres = 0.0
    back_m: Metres = 0.0


class Sway(Model):
    """A sine about the usual value, in its unit."""

    amplitude: float
    hz: Annotated[float, Field(gt=0, le=20)]
    phase_deg: float = 0.0


class MountMotionSpec(Model):
    """How the camera moves on the robot. stated_sigma_deg: error of tilt and roll as the log states them per image."""

    tilt_deg: Sway | None = None
    roll_deg: Sway | None = None
    yaw_deg: Sway | None = None
    height_m: Sway | None = None
    stated_sigma_deg: Annotated[float, Field(ge=0, le=10)] = 0.0


class ShutterSpec(Model):
    """A rolling shutter, as in a log's camera file."""

    row_time_us: Annotated[float, Field(ge=-1000, le=1000)]
    stamp_row: Annotated[float, Field(ge=0, le=4096)] = 0.0


class CameraSpec(Model):
    """Pinhole and lens; the principal point is the image centre when not given. motion: of the mount, none if fixed."""

    width: Annotated[int, Field(ge=16, le=4096)] = 640
    height: Annotated[int, Field(ge=16, le=4096)] = 480
    focal_px: Positive
    cx: Pixels | None = None
    cy: Pixels | None = None
    distortion_model: Literal["none", "plumb_bob", "rational_polynomial", "equidistant"] = "none"
    distortion: tuple[Annotated[float, Field(ge=-1e6, le=1e6)], ...] = Field(default=(), strict=False)
    mount: MountSpec
    motion: MountMotionSpec | None = None
    rolling_shutter: ShutterSpec | None = None

    @model_validator(mode="after")
    def _stamp_row_is_in_the_image(self) -> CameraSpec:
        if self.rolling_shutter is not None and self.rolling_shutter.stamp_row > self.height - 1:
            found = self.rolling_shutter.stamp_row
            raise ValueError(f"expected stamp_row to be a row of the image, 0 to {self.height - 1}, found {found:g}")
        return self

    @model_validator(mode="after")
    def _distortion_is_complete(self) -> CameraSpec:
        counts = DISTORTION_COUNTS[self.distortion_model]
        if len(self.distortion) not in counts:
            expected = " or ".join(map(str, counts))
            raise ValueError(
                f"{self.distortion_model}: expected {expected} distortion coefficients, found {len(self.distortion)}"
            )
        return self

    def camera(self, name: str = "") -> Camera:
        """Return the camera in SI units and radians."""
        mount, shutter = self.mount, self.rolling_shutter
        return Camera(
            width=self.width,
            height=self.height,
            fx=self.focal_px,
            fy=self.focal_px,
            cx=(self.width - 1) / 2 if self.cx is None else self.cx,
            cy=(self.height - 1) / 2 if self.cy is None else self.cy,
            mount=Mount(
                tilt_rad=float(np.deg2rad(mount.tilt_deg)),
                height_m=mount.height_m,
                roll_rad=float(np.deg2rad(mount.roll_deg)),
                yaw_rad=float(np.deg2rad(mount.yaw_deg)),
                right_m=mount.right_m,
                back_m=mount.back_m,
            ),
            distortion_model=self.distortion_model,
            distortion=self.distortion,
            name=name,
            shutter=RollingShutter(shutter.row_time_us / 1e6, shutter.stamp_row) if shutter else None,
        )


class WayPoint(Model):
    """A point of the path. corner_radius_m: of the arc that rounds this corner; 0 turns on the spot.

    speed_m_s: on the way to this point, the drive's when not given. pause_s: standing still there.
    """

    to: Point
    speed_m_s: Positive | None = None
    corner_radius_m: NotNegative = 0.0
    pause_s: NotNegative = 0.0


class DriveSpec(Model):
    """The path from its first point, heading for the second, with constant speed and turn rate on each piece.

    end_turn_deg: turn on the spot at the end. image_offset_s: time of the first image.
    """

    path: Annotated[tuple[WayPoint, ...], Field(strict=False, min_length=2, max_length=10_000)]
    speed_m_s: Positive = 0.5
    turn_deg_s: Positive = 40.0
    end_turn_deg: Degrees = 0.0
    image_hz: Annotated[float, Field(gt=0, le=1000)] = 5.0
    image_offset_s: NotNegative = 0.0
    odometry_hz: Annotated[float, Field(gt=0, le=1000)] = 20.0

    @property
    def headings(self) -> Array:
        """Heading (P - 1,) of each straight between two points of the path (P)."""
        step = np.diff(np.array([point.to for point in self.path]), axis=0)
        return np.arctan2(-step[:, 0], -step[:, 1])

    @property
    def cuts_m(self) -> Array:
        """Distance (P,) from each point at which the arc that rounds it begins and ends."""
        half = np.abs(geometry.wrap_angle(np.diff(self.headings))) / 2
        radius = np.array([point.corner_radius_m for point in self.path[1:-1]])
        # A turn by half a circle has no arc that touches both straights.
        tangent = np.where(half > np.pi / 2 - 1e-6, np.inf, np.tan(np.minimum(half, np.pi / 2 - 1e-6)))
        cut = np.multiply(radius, tangent, out=np.zeros_like(radius), where=radius > 0)
        return np.concatenate([[0.0], cut, [0.0]])

    @model_validator(mode="after")
    def _corners_fit(self) -> DriveSpec:
        points = np.array([point.to for point in self.path])
        length = np.linalg.norm(np.diff(points, axis=0), axis=1)
        if length.min() < 1e-6:
            raise ValueError(f"expected way points apart, found {self.path[int(length.argmin())].to} twice in a row")
        needed = self.cuts_m[:-1] + self.cuts_m[1:]
        if (needed > length + 1e-9).any():
            k = int((needed - length).argmax())
            raise ValueError(
                f"expected room for the corners between way points {k + 1} and {k + 2}: "
                f"they need {needed[k]:.2f} m, found {length[k]:.2f} m; use a smaller corner_radius_m"
            )
        return self


class OdometrySpec(Model):
    """Errors of the odometry, systematic first. The slow scales are Ornstein–Uhlenbeck processes in time."""

    distance_scale: Annotated[float, Field(gt=-1, le=100)] = 0.0
    rotation_scale: Annotated[float, Field(gt=-1, le=100)] = 0.0
    veer_deg_per_m: Degrees = 0.0
    distance_noise_m_per_sqrt_m: NotNegative = 0.0
    heading_walk_deg_per_sqrt_m: NotNegative = 0.0
    turn_noise_deg_per_sqrt_deg: NotNegative = 0.0
    slow_scale_sigma: NotNegative = 0.0
    slow_scale_time_s: Positive = 10.0


class ImageSpec(Model):
    """What lens, sensor and storage do to an image. exposure_s blurs it by the robot's own motion."""

    colour: bool = True
    noise_sigma: NotNegative = 1.0
    blur_px: NotNegative = 0.0
    exposure_s: NotNegative = 0.0
    gain: Positive = 1.0
    vignette: Annotated[float, Field(ge=0, lt=1)] = 0.0
    jpeg_quality: Annotated[int, Field(ge=1, le=100)] = 90


class StartSpec(Model):
    """How well the start is known: the log states the true start plus an error with these sigmas."""

    sigma_m: NotNegative = 0.1
    sigma_deg: NotNegative = 3.0
