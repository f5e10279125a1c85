"""What is said about one image: its vertical edges and how certain they are, segments as detectors return them."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, fields, replace
from typing import Annotated, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field

from localiser import geometry
from localiser.camera import Camera, Mount
from localiser.errors import InputError
from localiser.geometry import Array, finite_numbers

TURN_RATE = "turn rate"  # the name of the common error of a rolling shutter, rad/s: how fast the robot turned


@dataclass(frozen=True, slots=True, eq=False)
class CommonError:
    """Errors that move all edges of a frame together: K terms, such as tilt and roll (design equation 8).

    names: K names, tilt and roll first where known. cov: (K, K), rad², m² for lengths, rad²/s² for rates.
    bearing_from_lean, bearing_from_line: (E, K) derivatives of the bearing from lean alone, and of the line's.
    """

    names: tuple[str, ...]
    cov: Array
    bearing_from_lean: Array
    bearing_from_line: Array

    def sigma_of(self, name: str) -> float:
        """Return the sigma of one error, 0 where it is none of these."""
        return float(np.sqrt(self.cov.diagonal()[self.names.index(name)])) if name in self.names else 0.0

    def take(self, index: NDArray[np.int64] | NDArray[np.bool_]) -> CommonError:
        """Return what is common to the edges at `index`."""
        return CommonError(self.names, self.cov, self.bearing_from_lean[index], self.bearing_from_line[index])


@dataclass(frozen=True, slots=True, eq=False)
class Edges:
    """The vertical edges of one image, E of them, as columns; nan where something is not known.

    bearing, bearing_sigma: (E,) rad, from the camera's forward axis, positive right, of the line held through the
        nadir point (observation `line`).
    lean, lean_sigma: (E,) rad, of the free line in the upright image (observation `slope`).
    length_px: (E,) visible length. polarity: (E,) +1 dark to light from left to right, -1 light to dark, 0 unknown.
    ends_px: (E, 2, 2) bottom and top end (u, v) in the image as it was taken, lens distortion included. Where the
        shutter rolls: in the image that would have been taken at once, at the time stamp.
    foot_range_m, foot_range_sigma_m: (E,) floor distance of the foot from the camera, if the lower end is one; nan
        where that lies outside the image or above the horizon. An error of the mount is not part of the sigma.
    profile: (E, P) grey values across the edge from left to right, P may be 0.
    landmark_id: (E,) index of the true landmark in the map's order, or -1; known for simulated edges only. Below -1 it
        is a side of a marker, see `markers`.
    common: errors shared by all edges of the frame.
    rejected_px: (R, 2, 2) segments that were found and are not vertical edges, to look at.
    mount: of the camera when it took this image, which bearings and ranges hold for; None: as the camera says. What
        takes edges and a camera uses `camera.at(edges.mount)`.
    height_sigma_m: how certain the camera's height above the floor is, 1 sigma, beyond what `ends_px` are.
    """

    bearing: Array
    bearing_sigma: Array
    lean: Array
    lean_sigma: Array
    length_px: Array
    polarity: NDArray[np.int8]
    ends_px: Array
    foot_range_m: Array
    foot_range_sigma_m: Array
    profile: Array
    landmark_id: NDArray[np.int64]
    common: CommonError
    rejected_px: Array = field(default_factory=lambda: np.zeros((0, 2, 2)))
    mount: Mount | None = None
    height_sigma_m: float = 0.0

    def __len__(self) -> int:
        return len(self.bearing)

    @classmethod
    def from_columns(cls, bearing: Array, bearing_sigma: Array, lean: Array, lean_sigma: Array, **known: Any) -> Edges:
        """Return edges (E) with what is given; other columns, by their names, are unknown when left out or None."""
        count = len(bearing)
        unknown = np.full(count, np.nan)
        columns = {
            "length_px": unknown,
            "polarity": np.zeros(count, dtype=np.int8),
            "ends_px": np.full((count, 2, 2), np.nan),
            "foot_range_m": unknown,
            "foot_range_sigma_m": unknown,
            "profile": np.zeros((count, 0)),
            "landmark_id": np.full(count, -1, dtype=np.int64),
            "common": CommonError((), np.zeros((0, 0)), np.zeros((count, 0)), np.zeros((count, 0))),
        }
        columns |= {name: value for name, value in known.items() if value is not None}
        return cls(bearing, bearing_sigma, lean, lean_sigma, **columns)  # type: ignore[arg-type]

    @classmethod
    def from_bearings(cls, bearing: ArrayLike, sigma: ArrayLike) -> Edges:
        """Return edges of which only bearings (E,) are known (rad). sigma: (E,) or one for all. Raises InputError."""
        bearing = finite_numbers("bearing", bearing, ("E",))
        spread = np.full(bearing.shape, finite_numbers("sigma", sigma, (), bearing.shape))
        if not (spread > 0).all():
            raise InputError(f"expected numbers above 0, found {sigma!r}", field="sigma")
        unknown = np.full(len(bearing), np.nan)
        return cls.from_columns(bearing, spread, unknown, unknown)

    @classmethod
    def none(cls) -> Edges:
        """Return the edges of an image that shows none."""
        return cls.from_columns(*np.zeros((4, 0)))

    def longest(self, most: int) -> Edges:
        """Return the `most` longest edges, in the order that they have; all where there are no more."""
        if len(self) <= most:
            return self
        order = np.argsort(-np.nan_to_num(self.length_px), kind="stable")
        return self.take(np.sort(order[:most]))

    def take(self, index: NDArray[np.int64] | NDArray[np.bool_]) -> Edges:
        """Return the edges at `index` (indices or mask (E,)), in that order."""
        whole = ("common", "rejected_px", "mount", "height_sigma_m")
        columns = {f.name: getattr(self, f.name)[index] for f in fields(self) if f.name not in whole}
        return replace(self, common=self.common.take(index), **columns)


# -- edges that were measured elsewhere -------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class BearingSensor:
    """A sensor that reports bearings and no image; stands in for a camera through a nominal tilt."""

    bearing_sigma_deg: Annotated[float, Field(gt=0, le=45, description="error of one bearing (degrees, 1 sigma)")] = 1.5
    half_view_deg: Annotated[float, Field(gt=1, le=80, description="half the horizontal view (degrees)")] = 33.0
    tilt_deg: Annotated[
        float, Field(gt=0, lt=90, description="nominal tilt through which a bearing becomes a slope (degrees)")
    ] = 20.0
    height_m: Annotated[float, Field(gt=0, le=10, description="height above the floor (m)")] = 0.3

    def camera(self, name: str = "") -> Camera:
        """Return a camera with this field of view at every range.

        Its image is a strip along the horizon, which every edge that is taller than the camera crosses, far or near;
        in a full image the field of view would widen towards the floor. The principal point lies below the strip.
        """
        width, rows, tilt = 640, 32, math.radians(self.tilt_deg)
        # On the horizon row e = tan(tilt), so tan b = a cos(tilt).
        focal = (width - 1) / 2 * math.cos(tilt) / math.tan(math.radians(self.half_view_deg))
        mount, cy = Mount(tilt_rad=tilt, height_m=self.height_m), (rows - 1) / 2 + focal * math.tan(tilt)
        return Camera(width, rows, focal, focal, (width - 1) / 2, cy, mount, name=name)


def complete(
    bearing: Array, bearing_sigma: Array, lean: Array, lean_sigma: Array, tilt_rad: float
) -> tuple[Array, Array, Array, Array]:
    """Return bearing, its sigma, lean, its sigma (E,), each filled in from the other where nan.

    tan(lean) = s tan(b) [Taylor06] eq. 7; sigma of the bearing = |J| · sigma of the lean. Nothing is filled in when the
    tilt is 0, where the two say nothing of each other.
    """
    if geometry.is_level(tilt_rad):
        return bearing, bearing_sigma, lean, lean_sigma
    no_bearing, no_lean = np.isnan(bearing), np.isnan(lean)
    full_bearing = np.where(no_bearing, geometry.bearing_from_lean(lean, tilt_rad), bearing)
    full_lean = np.where(no_lean, geometry.lean_from_bearing(bearing, tilt_rad), lean)
    per_lean = np.abs(geometry.bearing_per_lean(full_bearing, tilt_rad))
    full_bearing_sigma = np.where(no_bearing, lean_sigma * per_lean, bearing_sigma)
    return full_bearing, full_bearing_sigma, full_lean, np.where(no_lean, bearing_sigma / per_lean, lean_sigma)


@dataclass(frozen=True, slots=True, eq=False)
class Segments:
    """Straight segments, S of them, in undistorted pixels: those of `Camera.ideal`.

    ends_px: (S, 2, 2) bottom and top end. support_px: (S, 2, 2) lower and upper point whose errors across the line,
    sigma_px (S,) each and independent, say how certain the line is; those of a general detector are its ends, those of
    a line fitted to points lie at the points' standard deviation from their middle. shift_sigma_px: (S,) by how much
    what lies beside the segment may have moved it, as a whole and, about as much, one end against the other. polarity:
    (S,) as in `Edges`, 0 not known yet.
    """

    ends_px: Array
    support_px: Array
    sigma_px: Array
    shift_sigma_px: Array
    polarity: NDArray[np.int8]

    def __len__(self) -> int:
        return len(self.ends_px)

    @property
    def end_sigma_px(self) -> Array:
        """The whole error (S,) of a support point against the other one."""
        return np.hypot(self.sigma_px, self.shift_sigma_px)

    @property
    def across_sigma_px(self) -> Array:
        """The error (S,) of two independent support points that leaves the middle as uncertain as it is."""
        return np.sqrt(self.sigma_px**2 + 3 * self.shift_sigma_px**2)

    def take(self, index: NDArray[np.bool_]) -> Segments:
        """Return the segments where the mask (S,) holds."""
        return Segments(*(getattr(self, column.name)[index] for column in fields(self)))

    @classmethod
    def of_ends(cls, ends_px: Array, sigma_px: float, roll_rad: float = 0.0) -> Segments:
        """Return segments that are known by their ends (S, 2, 2), in any order. roll_rad: of the camera."""
        upside_down = np.diff(ends_px @ np.array([np.sin(roll_rad), np.cos(roll_rad)]))[:, 0] > 0
        ends, none = np.where(upside_down[:, None, None], ends_px[:, ::-1], ends_px), np.zeros(len(ends_px))
        return cls(ends, ends, np.full(len(ends), sigma_px), none, none.astype(np.int8))
