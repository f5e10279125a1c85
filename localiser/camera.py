"""The camera: pixels to rays, lines to lean and bearing with their sigmas, floor contact.

The frames (image, upright image, level) are those of docs/conventions.md. Bearings are in the level frame.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import cv2
import numpy as np
from numpy.typing import ArrayLike

from localiser import geometry
from localiser.geometry import Array, Trajectory, Twist

DISTORTION_COUNTS = {"plumb_bob": (0, 4, 5), "rational_polynomial": (8, 12, 14), "equidistant": (4,), "none": (0,)}
_UPWARDS = np.array([1.0, -1.0])  # rows of an image count downwards
_UNDISTORT_UNTIL = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 200, 1e-14)


@dataclass(frozen=True, slots=True)
class MountSigma:
    """How certain the values of a mount are, 1 sigma each; None: not stated."""

    tilt_rad: float | None = None
    roll_rad: float | None = None
    yaw_rad: float | None = None
    height_m: float | None = None
    right_m: float | None = None
    back_m: float | None = None


@dataclass(frozen=True, slots=True)
class Mount:
    """Where the camera sits on the robot: turned by yaw (anticlockwise), then tilted, then rolled.

    tilt_rad: positive looks down. roll_rad: positive has the camera's right side down. height_m: above the floor.
    right_m, back_m: from the robot's centre (15 cm ahead of it: back_m = -0.15). sigma: of a mount that was measured
    for one image; its errors are then of this image alone. None: as the configuration says; they are learnt.
    """

    tilt_rad: float
    height_m: float
    roll_rad: float = 0.0
    yaw_rad: float = 0.0
    right_m: float = 0.0
    back_m: float = 0.0
    sigma: MountSigma | None = None


@dataclass(frozen=True, slots=True)
class RollingShutter:
    """Rows are taken row_time_s apart; negative: from the bottom up. stamp_row: that of the image's time stamp."""

    row_time_s: float
    stamp_row: float = 0.0

    def since_stamp_s(self, row: ArrayLike) -> Array:
        """Return how long (...,) after the image's time stamp rows (...,) are taken."""
        return np.asarray((np.asarray(row, dtype=np.float64) - self.stamp_row) * self.row_time_s)


@dataclass(frozen=True, eq=False)
class Camera:
    """Intrinsics (pixels), lens distortion as in ROS, and the mount. shutter: None where all rows are taken at once."""

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    mount: Mount
    distortion_model: str = "none"
    distortion: tuple[float, ...] = ()
    name: str = ""
    shutter: RollingShutter | None = None

    # -- frames -------------------------------------------------------------------------------------------------

    @cached_property
    def matrix(self) -> Array:
        """The 3×3 camera matrix of OpenCV."""
        return np.array([[self.fx, 0.0, self.cx], [0.0, self.fy, self.cy], [0.0, 0.0, 1.0]])

    @cached_property
    def focal_px(self) -> float:
        """One focal length for turning pixel errors into angles: √(fx fy)."""
        return float(np.sqrt(self.fx * self.fy))

    @cached_property
    def level_from_camera(self) -> Array:
        """Rotation (3, 3) from the camera's axes (right, up, backward) to the level frame: tilt after roll."""
        s, c = np.sin(self.mount.tilt_rad), np.cos(self.mount.tilt_rad)
        tilt = np.array([[1.0, 0.0, 0.0], [0.0, c, s], [0.0, -s, c]])
        roll = np.eye(3)
        roll[:2, :2] = self._roll_matrix
        return np.asarray(tilt @ roll)

    @cached_property
    def robot_from_level(self) -> Array:
        """The camera's floor pose (right, backward, yaw) (3,) in the robot frame."""
        return np.array([self.mount.right_m, self.mount.back_m, self.mount.yaw_rad])

    def pose_in_map(self, robot_pose: ArrayLike) -> Array:
        """Return floor poses (..., 3) of the camera in the map for robots at `robot_pose` (..., 3)."""
        return geometry.compose(robot_pose, self.robot_from_level)

    @cached_property
    def is_distorted(self) -> bool:
        """Whether the lens bends straight lines at all."""
        return any(self.distortion) or self.distortion_model == "equidistant"

    def with_mount(self, **changes: float) -> Camera:
        """Return this camera with some values of its mount changed."""
        return replace(self, mount=replace(self.mount, **changes))  # type: ignore[arg-type]

    def at(self, mount: Mount | None) -> Camera:
        """Return the camera as it was mounted for one image; None: as it is. The last few are kept."""
        return self if mount is None or mount == self.mount else _mounted(self, mount=mount)

    @cached_property
    def ideal(self) -> Camera:
        """The ideal pinhole camera with the same matrix and mount; its pixels are called undistorted."""
        return replace(self, distortion_model="none", distortion=())

    @property
    def readout_s(self) -> tuple[float, float]:
        """When the earliest and the latest row of an image are taken, after its time stamp; 0 where all are at once."""
        first, last = (0.0, 0.0) if self.shutter is None else self.shutter.since_stamp_s([0, self.height - 1]).tolist()
        return min(first, last), max(first, last)

    def twist_at(self, track: Trajectory, t_ns: int) -> Twist | None:
        """Return how a robot on this track moves while an image of that time is taken; None where that is at once."""
        return geometry.twist_at(track, t_ns, self.readout_s) if self.shutter else None

    # -- pixels and rays ----------------------------------------------------------------------------------------

    def image_from_pixels(self, pixels: ArrayLike) -> Array:
        """Return image coordinates (a, e) (..., 2) of pixels (u, v) (..., 2); undoes the lens distortion."""
        pixels = np.asarray(pixels, dtype=np.float64)
        flat = np.ascontiguousarray(pixels.reshape(-1, 1, 2))
        if flat.size == 0:
            return np.zeros(pixels.shape)
        if self.distortion_model == "equidistant":
            found = cv2.fisheye.undistortPoints(flat, self.matrix, np.array(self.distortion), criteria=_UNDISTORT_UNTIL)
        elif self.is_distorted:
            found = cv2.undistortPoints(flat, self.matrix, np.array(self.distortion), criteria=_UNDISTORT_UNTIL)
        else:
            found = (flat - self.matrix[:2, 2]) / self.matrix.diagonal()[:2]
        return np.asarray(found.reshape(pixels.shape) * _UPWARDS)

    def pixels_from_image(self, image_points: ArrayLike) -> Array:
        """Return pixels (u, v) (..., 2) of image coordinates (a, e) (..., 2); applies the lens distortion."""
        points = np.asarray(image_points, dtype=np.float64) * _UPWARDS
        flat = np.ascontiguousarray(points.reshape(-1, 1, 2))
        if flat.size == 0:
            return np.zeros(points.shape)
        if self.distortion_model == "equidistant":
            found = cv2.fisheye.distortPoints(flat, self.matrix, np.array(self.distortion))
        elif self.is_distorted:
            rays = np.concatenate([flat, np.ones_like(flat[..., :1])], axis=-1)
            found, _ = cv2.projectPoints(rays, np.zeros(3), np.zeros(3), self.matrix, np.array(self.distortion))
        else:
            found = flat * self.matrix.diagonal()[:2] + self.matrix[:2, 2]
        return np.asarray(found.reshape(points.shape))

    @cached_property
    def lens_radius(self) -> float:
        """The normalised distance from the image centre up to which the lens model is one to one; inf if everywhere.

        Where a polynomial turns back, points far outside the field of view would land inside the image again.
        """
        axes = np.array([[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]])
        radii = np.linspace(0.0, 10.0, 2001)
        bent = (self.pixels_from_image(radii[:, None, None] * axes) - [self.cx, self.cy]) / [self.fx, -self.fy]
        grows = (np.diff((bent * axes).sum(axis=-1), axis=0) > 0).all(axis=1)
        return np.inf if grows.all() else float(radii[np.argmin(grows)])

    def image_from_upright(self, upright_points: ArrayLike) -> Array:
        """Return (a, e) (..., 2) of the image from upright ones; rolled as the camera is."""
        return np.asarray(np.asarray(upright_points, dtype=np.float64) @ self._roll_matrix)

    def upright_from_pixels(self, pixels: ArrayLike) -> Array:
        """Return upright image coordinates (a, e) (..., 2) of pixels (..., 2)."""
        return np.asarray(self.image_from_pixels(pixels) @ self._roll_matrix.T)

    def pixels_from_upright(self, upright_points: ArrayLike) -> Array:
        """Return pixels (..., 2) of upright image coordinates (..., 2)."""
        return self.pixels_from_image(self.image_from_upright(upright_points))

    @cached_property
    def _roll_matrix(self) -> Array:
        s, c = np.sin(self.mount.roll_rad), np.cos(self.mount.roll_rad)
        return np.array([[c, s], [-s, c]])

    def border_px(self, count: int = 65, outside_px: float = 0.0) -> Array:
        """Return pixels (4, count, 2) along the image's top, bottom, left and right border, or so far outside of it."""
        u, v = (np.linspace(-outside_px, size - 1 + outside_px, count) for size in (self.width, self.height))
        rows = [np.stack([u, np.full(count, row)], axis=-1) for row in v[[0, -1]]]
        return np.array(rows + [np.stack([np.full(count, column), v], axis=-1) for column in u[[0, -1]]])

    @cached_property
    def upright_bounds(self) -> tuple[float, float, float, float]:
        """An upright rectangle (a_left, a_right, e_bottom, e_top) sure to lie inside the image, at any roll.

        What lies between the four borders, or the largest of the image's shape about its middle, if that is larger.
        """
        sides = self.upright_from_pixels(self.border_px())
        for _ in range(quarters := round(self.mount.roll_rad / (np.pi / 2)) % 4):
            sides = sides[[2, 3, 1, 0]]  # the left is the top, the top is the right
        top, bottom, left, right = sides
        size = np.array([self.width, self.height])[:: 1 - quarters % 2 * 2]
        low, high = np.array([[left[:, 0].max(), bottom[:, 1].max()], [right[:, 0].min(), top[:, 1].min()]])
        middle = (sides.min(axis=(0, 1)) + sides.max(axis=(0, 1))) / 2
        reach = np.abs(sides - middle) / size
        half = np.minimum(reach[:, :-1], reach[:, 1:]).max(axis=-1).min() * size
        if np.prod(2 * half) > 1.001 * np.prod(np.maximum(high - low, 0.0)):
            low, high = middle - half, middle + half
        return float(low[0]), float(high[0]), float(low[1]), float(high[1])

    # -- the world ----------------------------------------------------------------------------------------------

    def level_rays(self, pixels: ArrayLike) -> Array:
        """Return rays (x, y, z) (..., 3) of the level frame through pixels (..., 2), not normalised."""
        image_points = self.image_from_pixels(pixels)
        rays = np.concatenate([image_points, -np.ones_like(image_points[..., :1])], axis=-1)
        return np.asarray(rays @ self.level_from_camera.T)

    def project_level(self, points: ArrayLike) -> Array:
        """Return pixels (..., 2) of points (x, y, z) (..., 3) of the level frame; nan where the camera cannot see.

        That is behind the image plane, or so far to the side that the lens model would fold the point back inside.
        """
        in_camera = np.asarray(points, dtype=np.float64) @ self.level_from_camera
        depth = -in_camera[..., 2]
        depth = np.where(depth > 1e-9, depth, np.nan)
        image_points = in_camera[..., :2] / depth[..., None]
        seen = np.hypot(image_points[..., 0], image_points[..., 1]) < self.lens_radius
        return self.pixels_from_image(np.where(seen[..., None], image_points, np.nan))

    def project(self, robot_pose: ArrayLike, points_in_map: ArrayLike) -> Array:
        """Return pixels (..., 2) of map points (x, y, z) (..., 3), y above the floor, seen from `robot_pose` (3,)."""
        points = np.asarray(points_in_map, dtype=np.float64)
        floor = geometry.robot_from_map(self.pose_in_map(robot_pose), points[..., [0, 2]])
        level = np.stack([floor[..., 0], points[..., 1] - self.mount.height_m, floor[..., 1]], axis=-1)
        return self.project_level(level)

    # -- lines --------------------------------------------------------------------------------------------------

    def lean_of_segments(self, ends_px: ArrayLike) -> Array:
        """Return the lean (E,) of image segments (E, 2, 2), in the upright image: the paper's slope as an angle."""
        ends = self.upright_from_pixels(ends_px)
        across, up = np.moveaxis(ends[..., 1, :] - ends[..., 0, :], -1, 0)
        return geometry.wrap_half_turn(np.arctan2(across, up))

    def bearing_of_segments(self, ends_px: ArrayLike) -> Array:
        """Return the bearing (E,) of segments (E, 2, 2) held through the nadir point."""
        return self.bearings_of_segments(ends_px, 0.0)[0]

    def bearings_of_segments(self, ends_px: ArrayLike, endpoint_sigma_px: ArrayLike) -> tuple[Array, Array]:
        """Return `bearing_of_segments` (E,), and its sigma (E,) for ends that err by sigma (E,) across the line.

        The least-squares line through the nadir point weighs each end by its squared distance from that point, which
        is proportional to (c + e s)². The sigma is J σ / √(2 D² + L²/2) of design equation 7. Both are written so that
        they also hold for a tilt of 0, of which the nadir point is infinitely far.
        """
        ends = self.upright_from_pixels(ends_px)
        from_nadir = np.cos(self.mount.tilt_rad) + ends[..., 1] * np.sin(self.mount.tilt_rad)
        squared = (from_nadir**2).sum(axis=-1)
        bearing = np.arctan((ends[..., 0] * from_nadir).sum(axis=-1) / squared)
        lean = geometry.lean_from_bearing(bearing, self.mount.tilt_rad)
        sigma = np.asarray(endpoint_sigma_px, dtype=np.float64) / self.focal_px
        sigma_tangent = sigma / np.cos(lean) / np.sqrt(squared)
        return np.asarray(bearing), np.asarray(sigma_tangent * np.cos(bearing) ** 2)

    def bearing_jacobians(self, bearing_rad: ArrayLike, middle_e: ArrayLike) -> tuple[Array, Array]:
        """Return d(bearing)/d(tilt, roll) (E, 2) for bearings from lean alone, and for those from line and nadir.

        bearing_rad: (E,). middle_e: (E,) upright image height of the segment's middle. An error of the mount moves all
        edges of a frame together (design equation 8). The lean's is nan when the tilt is 0.
        """
        b, e = np.asarray(bearing_rad, dtype=np.float64), np.asarray(middle_e, dtype=np.float64)
        tilt = self.mount.tilt_rad
        s, c = np.sin(tilt), np.cos(tilt)
        from_lean = np.full((*b.shape, 2), np.nan)
        if not geometry.is_level(tilt):
            per_tilt = -0.5 * np.sin(2 * b) * c / s
            from_lean = np.stack([per_tilt, geometry.bearing_per_lean(b, tilt)], axis=-1)
        # tan b = a / (c + e s). Tilt: moves c + e s by (e c - s). Roll by dρ: (a, e) -> (a + e dρ, e - a dρ).
        depth = c + e * s
        a = np.tan(b) * depth
        per_tangent = np.cos(b) ** 2
        by_tilt = -a * (e * c - s) / depth**2
        by_roll = e / depth + a**2 * s / depth**2
        return from_lean, np.stack([by_tilt, by_roll], axis=-1) * per_tangent[..., None]


_mounted = lru_cache(maxsize=16)(replace)
