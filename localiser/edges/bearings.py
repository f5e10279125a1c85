"""Edges that were measured elsewhere: as bearings, as leans, or as both."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from pydantic import Field

from localiser import geometry
from localiser.camera import Camera, Mount
from localiser.geometry import Array

_STRIP_ROWS = 32


@dataclass(frozen=True, slots=True)
class BearingSensor:
    """A sensor that reports bearings and no image; stands in for a camera through a nominal tilt."""

    bearing_sigma_deg: Annotated[float, Field(gt=0, le=45, description="error of one bearing (degrees, 1 sigma)")] = 1.5
    half_view_deg: Annotated[float, Field(gt=1, le=80, description="half the horizontal field of view (degrees)")] = (
        33.0
    )
    tilt_deg: Annotated[
        float, Field(gt=0, lt=90, description="nominal tilt through which a bearing becomes a slope (degrees)")
    ] = 20.0
    height_m: Annotated[float, Field(gt=0, le=10, description="height above the floor (m)")] = 0.3

    def camera(self, name: str = "") -> Camera:
        """Return a camera with this field of view at every range.

        Its image is a strip along the horizon, which every edge that is taller than the camera crosses, far or near;
        in a full image the field of view would widen towards the floor. The principal point lies below the strip.
        """
        width = 640
        tilt = math.radians(self.tilt_deg)
        # On the horizon row e = tan(tilt), so tan b = a cos(tilt).
        focal = (width - 1) / 2 * math.cos(tilt) / math.tan(math.radians(self.half_view_deg))
        middle = (_STRIP_ROWS - 1) / 2
        return Camera(
            width=width,
            height=_STRIP_ROWS,
            fx=focal,
            fy=focal,
            cx=(width - 1) / 2,
            cy=middle + focal * math.tan(tilt),
            mount=Mount(tilt_rad=tilt, height_m=self.height_m),
            name=name,
        )


def complete(
    bearing: Array, bearing_sigma: Array, lean: Array, lean_sigma: Array, tilt_rad: float
) -> tuple[Array, Array, Array, Array]:
    """Return bearing, its sigma, lean, its sigma (E,), each filled in from the other where nan.

    tan(lean) = s tan(b) [Taylor06] eq. 7; sigma of the bearing = |J| · sigma of the lean. Nothing is filled in when the
    tilt is 0, where the two say nothing of each other.
    """
    if abs(math.sin(tilt_rad)) < 1e-12:
        return bearing, bearing_sigma, lean, lean_sigma
    full_bearing = np.where(np.isnan(bearing), geometry.bearing_from_lean(lean, tilt_rad), bearing)
    full_lean = np.where(np.isnan(lean), geometry.lean_from_bearing(bearing, tilt_rad), lean)
    per_lean = np.abs(geometry.bearing_per_lean(full_bearing, tilt_rad))
    return (
        full_bearing,
        np.where(np.isnan(bearing), lean_sigma * per_lean, bearing_sigma),
        full_lean,
        np.where(np.isnan(lean), bearing_sigma / per_lean, lean_sigma),
    )
