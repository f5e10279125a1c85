"""Measure vertical edges: lean, bearing and their sigmas, the foot, grey values across; a rolling shutter undone."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import cv2
import numpy as np
from numpy.typing import NDArray

from localiser import geometry
from localiser.camera import Camera, MountSigma
from localiser.edges.lines import Groups
from localiser.edges.types import TURN_RATE, CommonError, Edges, Segments
from localiser.edges.views import Image
from localiser.geometry import UNKNOWN_TWIST, Array, Twist

_TYPICAL_INVERSE_RANGE = 0.4  # 1/m: rooms are some metres wide

FOOT_SIGMA_PX = 2.0  # error of an edge's lower end along it: where a line stops is least certain
BORDER_PX = 4.0 * FOOT_SIGMA_PX  # an edge that ends so close to the image border may be cut off by it


def foot_of_edges(bottom_px: Array, camera: Camera, taken_px: Array | None = None) -> tuple[Array, Array]:
    """Return the floor range (E,) m of feet seen at pixels (E, 2), and its sigma; nan where no foot is seen.

    A foot is where an edge ends inside the image and below the horizon. Design equation 9. taken_px: (E, 2) where the
    image shows them, if a rolling shutter took them elsewhere.
    """
    size, taken_px = np.array([camera.width, camera.height]), bottom_px if taken_px is None else taken_px
    inside = np.all((taken_px >= BORDER_PX) & (taken_px <= size - 1 - BORDER_PX), axis=1)
    rays = camera.level_rays(bottom_px)
    depression = np.arctan2(-rays[:, 1], np.hypot(rays[:, 0], rays[:, 2]))
    sigma_rad = FOOT_SIGMA_PX / camera.focal_px
    seen = inside & (depression > sigma_rad)
    height_m = camera.mount.height_m
    range_m = height_m / np.tan(np.where(seen, depression, np.nan))
    return range_m, (range_m**2 + np.square(height_m)) / height_m * sigma_rad


PROFILE_OFFSETS_PX = np.array([-6.0, -4.5, -3.0, -1.5, 0.0, 1.5, 3.0, 4.5, 6.0])
_SAMPLES_ALONG = 16


def profiles(ends_px: Array, image: Image, camera: Camera, taken_of: Callable[[Array], Array] | None = None) -> Array:
    """Return grey values (S, P) across segments (S, 2, 2), given in undistorted pixels, from left to right.

    Means along each segment at `PROFILE_OFFSETS_PX`; nan where all of that lies outside the image. taken_of: where
    points of the segments (S, A, P, 2) were taken, if a rolling shutter took them elsewhere.
    """
    if len(ends_px) == 0:
        return np.zeros((0, len(PROFILE_OFFSETS_PX)))
    # Points (2, P, A, S): with the segments last, loops are long.
    bottom, top = ends_px.T[:, 0, None, None], ends_px.T[:, 1, None, None]
    along = ((np.arange(_SAMPLES_ALONG) + 0.5) / _SAMPLES_ALONG)[:, None]
    right, up = (top - bottom) / np.maximum(np.linalg.norm(top - bottom, axis=0), 1e-9)
    points = bottom + (top - bottom) * along + np.array([-up, right]) * PROFILE_OFFSETS_PX[:, None, None]
    points = points if taken_of is None else taken_of(points.T).T
    taken = camera.pixels_from_image(camera.ideal.image_from_pixels(points.T)).T if camera.is_distorted else points
    u, v = np.ascontiguousarray(taken, dtype=np.float32).reshape(2, -1, len(ends_px))
    inside = ((u >= 0) & (u <= camera.width - 1) & (v >= 0) & (v <= camera.height - 1)).reshape(taken.shape[1:])
    grey = cv2.remap(image, u, v, cv2.INTER_LINEAR).reshape(inside.shape)
    seen = inside.sum(axis=1)
    return np.where(seen > 0, (grey * inside).sum(axis=1) / np.maximum(seen, 1), np.nan).T.copy()


def polarity_of_profiles(profile: Array) -> NDArray[np.int8]:
    """Return (S,) +1 where the right side of a profile (S, P) is lighter than the left, -1 where darker, else 0."""
    middle = len(PROFILE_OFFSETS_PX) // 2
    step = profile[:, middle + 1] - profile[:, middle - 1]
    return np.sign(np.nan_to_num(step)).astype(np.int8)


# -- a rolling shutter undone: edges as a camera that takes all rows at once would have found them ---------------------

# While the rows of an image are taken one after another, the robot turns and drives with velocity (ahead, right). An
# edge at bearing b and floor range r then moves by
#
#     db/dt = turn rate + (ahead · sin b - right · cos b) / r
#
# So each point of it is turned about the vertical, by what the edge has moved between the image's time stamp and the
# time of the point's row. At 1 rad/s and 30 ms an image a vertical edge leans by 1.7° otherwise. The range is told by
# an edge's lower end if it stands on the floor; it cannot be farther away than that.

_INVERSE_RANGE_SIGMA = 0.3  # 1/m: lower ends need not stand on the floor
_STEP_RAD_S = 1e-3  # change of the turn rate by which derivatives are taken
_ITERATIONS = 4  # of finding a point's row, each ten times closer at least up to 4 rad/s and 30 ms


@dataclass(frozen=True, slots=True, eq=False)
class Readout:
    """How a camera with a rolling shutter moved while it took one image.

    velocity: (right, backward) m/s in the level frame, turn_rad_s: anticlockwise, turn_sigma_rad_s: its sigma.
    """

    camera: Camera
    velocity: Array
    turn_rad_s: float
    turn_sigma_rad_s: float

    def rates(self, ends_px: Array) -> tuple[Array, Array]:
        """Return d(bearing)/dt (S,) rad/s of segments (S, 2, 2), undistorted, bottom first, and its sigma by range."""
        rays = self.camera.ideal.level_rays(ends_px[:, 0])
        across, ahead = rays[:, 0], -rays[:, 2]
        bearing = np.arctan2(across, ahead)
        inverse = -rays[:, 1] / np.hypot(across, ahead) / self.camera.mount.height_m
        inverse = np.where(inverse > 0, inverse, _TYPICAL_INVERSE_RANGE)
        right, backward = self.velocity
        passing = -backward * np.sin(bearing) - right * np.cos(bearing)
        return self.turn_rad_s + passing * inverse, np.abs(passing) * _INVERSE_RANGE_SIGMA

    def at_stamp(self, taken_px: Array, rate: Array) -> Array:
        """Return where points (S, …, 2) that were taken would be at the time stamp, if they move at `rate` (S,)."""
        rate = rate.reshape(-1, *[1] * (taken_px.ndim - 2))
        return self._turned(taken_px, -rate * self._since_stamp_s(taken_px))

    def as_taken(self, stamp_px: Array, rate: Array) -> Array:
        """Return where points (S, …, 2) of the time stamp were taken; inverse of `at_stamp`."""
        taken, rate = stamp_px, rate.reshape(-1, *[1] * (stamp_px.ndim - 2))
        for _ in range(_ITERATIONS):
            taken = self._turned(stamp_px, rate * self._since_stamp_s(taken))
        return taken

    def per_turn(self, ends_px: Array, rate: Array) -> tuple[Array, Array]:
        """Return d(lean) and d(bearing) (S,) by the turn rate, s, of segments with ends (S, 2, 2) at the time stamp."""
        moved = self._turned(ends_px, -_STEP_RAD_S * self._since_stamp_s(self.as_taken(ends_px, rate)))
        ideal = self.camera.ideal
        turned = geometry.wrap_half_turn(ideal.lean_of_segments(moved) - ideal.lean_of_segments(ends_px))
        shifted = ideal.bearing_of_segments(moved) - ideal.bearing_of_segments(ends_px)
        return turned / _STEP_RAD_S, shifted / _STEP_RAD_S

    def _since_stamp_s(self, ideal_px: Array) -> Array:
        """Return when the rows of undistorted points (..., 2) are taken, after the time stamp."""
        assert self.camera.shutter is not None
        taken = self.camera.pixels_from_image(self.camera.ideal.image_from_pixels(ideal_px))
        return self.camera.shutter.since_stamp_s(taken[..., 1])

    def _turned(self, ideal_px: Array, bearing_rad: Array) -> Array:
        """Return undistorted points (..., 2) turned about the vertical, towards larger bearings by angles (...)."""
        x, y, z = np.moveaxis(self.camera.ideal.level_rays(ideal_px), -1, 0)
        cos, sin = np.cos(bearing_rad), np.sin(bearing_rad)
        level = np.stack([cos * x - sin * z, y, sin * x + cos * z], axis=-1)
        right, up, backward = np.moveaxis(level @ self.camera.level_from_camera, -1, 0)
        ideal = self.camera.ideal
        return ideal.pixels_from_image(np.stack([right, up], axis=-1) / -backward[..., None])


def readout_of(camera: Camera, twist: Twist | None) -> Readout | None:
    """Return how a camera moved while it took an image, by its robot's twist, if known; None if it took it at once."""
    if camera.shutter is None:
        return None
    twist = twist or UNKNOWN_TWIST
    mount, turn = camera.mount, twist.turn_rad_s
    in_robot = np.array([twist.right_m_s + turn * mount.back_m, twist.backward_m_s - turn * mount.right_m])
    velocity = geometry.robot_from_map(np.array([0.0, 0.0, mount.yaw_rad]), in_robot)
    return Readout(camera, velocity, turn, twist.turn_sigma_rad_s)


def edges_of_segments(
    segments: Segments,
    edge: NDArray[np.int64],
    image: Image,
    camera: Camera,
    mount_sigma_rad: Array,
    readout: Readout | None = None,
) -> Edges:
    """Return the edges (E) that segments (S) make up, where `edge` (S,) says which segment belongs to which.

    Bearing and lean are least squares over the support points of an edge's segments (design equation 7). The bearing's
    line is held through the nadir point, the lean's is free. mount_sigma_rad: (2,). readout: by which segments were
    brought to the image's time stamp, None where all rows were taken then.
    """
    if len(segments) == 0:
        return Edges.none()
    groups = Groups(edge, int(edge.max()) + 1)
    ideal = camera.ideal
    each, sigma = ideal.bearings_of_segments(segments.support_px, segments.across_sigma_px)
    weight = sigma**-2
    total = groups.sum(weight)
    bearing = groups.sum(weight * each) / total
    # Segments that differ by more than their sigmas make a bearing less certain.
    apart = groups.sum(weight * (each - bearing[edge]) ** 2) / np.maximum(np.bincount(edge) - 1, 1)
    bearing_sigma = np.sqrt(np.maximum(apart, 1.0) / total)
    lean, lean_sigma, upright_ends, middle_e = _lean_and_ends(segments, groups, camera)
    image_ends = camera.image_from_upright(upright_ends)
    ends_px, ideal_px = camera.pixels_from_image(image_ends), ideal.pixels_from_image(image_ends)
    pieces_px = groups.sum(np.linalg.norm(segments.ends_px[:, 1] - segments.ends_px[:, 0], axis=-1))
    polarity = np.zeros(groups.count, dtype=np.int8)
    polarity[edge] = segments.polarity
    taken_of, turn, shown_px = None, None, ends_px
    if readout is not None:
        # The readout leaves errors by unknown ranges, and by the turn rate, which is common to all edges.
        rate, rate_sigma = readout.rates(ideal_px)
        taken_of = partial(readout.as_taken, rate=rate)
        shown_px = camera.pixels_from_image(ideal.image_from_pixels(taken_of(ideal_px)))
        turned, shifted = readout.per_turn(ideal_px, rate)
        bearing_sigma = np.hypot(bearing_sigma, shifted * rate_sigma)
        lean_sigma, tilt_rad = np.hypot(lean_sigma, turned * rate_sigma), camera.mount.tilt_rad
        per_lean = np.nan if geometry.is_level(tilt_rad) else geometry.bearing_per_lean(bearing, tilt_rad)
        turn = readout.turn_sigma_rad_s, per_lean * turned, shifted
    foot_range, foot_sigma = foot_of_edges(ends_px[:, 0], camera, shown_px[:, 0])
    return Edges.from_columns(
        bearing,
        bearing_sigma,
        lean,
        lean_sigma,
        length_px=np.minimum(pieces_px, np.linalg.norm(ideal_px[:, 1] - ideal_px[:, 0], axis=-1)),
        polarity=polarity,
        ends_px=ends_px,
        foot_range_m=foot_range,
        foot_range_sigma_m=foot_sigma,
        profile=profiles(ideal_px, image, camera, taken_of),
        common=common_error(bearing, middle_e, camera, mount_sigma_rad, turn),
    )


def _lean_and_ends(segments: Segments, groups: Groups, camera: Camera) -> tuple[Array, Array, Array, Array]:
    """Return lean (E,), its sigma (E,), upright ends (E, 2, 2), bottom first, and mean height e (E,) of free lines."""
    ideal = camera.ideal
    support = ideal.upright_from_pixels(segments.support_px)
    members = np.bincount(groups.of, minlength=groups.count)[groups.of]
    # What moves a segment as a whole turns an edge only where segments are joined.
    sigma_px = np.where(members > 1, segments.across_sigma_px, segments.end_sigma_px)
    # An error across a leaning line is one of 1 / cos(lean) along a.
    weight = (np.cos(ideal.lean_of_segments(segments.support_px)) / sigma_px * camera.focal_px) ** 2
    points = Groups(np.repeat(groups.of, 2), groups.count)
    fit = points.line(support[..., 1].ravel(), support[..., 0].ravel(), np.repeat(weight, 2))
    lean = np.arctan(fit.slope)
    end_e = ideal.upright_from_pixels(segments.ends_px)[..., 1].ravel()
    low, high = np.full(groups.count, np.inf), np.full(groups.count, -np.inf)
    np.minimum.at(low, points.of, end_e)
    np.maximum.at(high, points.of, end_e)
    e = np.stack([low, high], axis=-1)
    a = fit.y[:, None] + fit.slope[:, None] * (e - fit.x[:, None])
    return lean, np.cos(lean) ** 2 / np.sqrt(fit.spread), np.stack([a, e], axis=-1), fit.x


def common_error(
    bearing: Array,
    middle_e: Array,
    camera: Camera,
    mount_sigma_rad: Array,
    turn: tuple[float, Array, Array] | None = None,
) -> CommonError:
    """Return what an error of tilt and roll (2,) does to the bearings (E,) of a frame (design equation 8).

    And what other errors of the mount do, where their sigma is stated; of an offset, at a typical range. turn: sigma of
    the turn rate, and what it does to bearings (E,) from lean and line, where a shutter rolls.
    """
    from_lean, from_line = camera.bearing_jacobians(bearing, middle_e)
    stated, zero = camera.mount.sigma or MountSigma(), np.zeros_like(bearing)
    of_mount = [
        ("yaw", stated.yaw_rad, zero + 1.0),
        ("height", stated.height_m, zero),
        ("right", stated.right_m, -np.cos(bearing) * _TYPICAL_INVERSE_RANGE),
        ("back", stated.back_m, -np.sin(bearing) * _TYPICAL_INVERSE_RANGE),
    ]
    others = [(name, sigma, by, by) for name, sigma, by in of_mount if sigma] + ([(TURN_RATE, *turn)] if turn else [])
    names, sigmas, by_lean, by_line = zip(*others, strict=True) if others else ((), (), (), ())
    cov = np.diag([*mount_sigma_rad**2, *np.square(sigmas)])
    columns = np.column_stack([from_lean, *by_lean]), np.column_stack([from_line, *by_line])
    return CommonError(("tilt", "roll", *names), cov, *columns)
