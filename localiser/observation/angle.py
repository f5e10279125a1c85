"""The angle in which edges are compared with landmarks: of the line through the nadir point, or of the slope alone.

`line` compares bearings; `slope` compares leans, as the founding paper does, whose tangent is that of the bearing times
the sine of the tilt [Taylor06, eq. 7]. Leans are never divided by that sine, so nothing is infinite straight ahead.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Literal

import numpy as np

from localiser import geometry
from localiser.camera import Camera
from localiser.edges import Edges
from localiser.geometry import Array


@dataclass(frozen=True, eq=False)
class Angle:
    """What edges measure, and landmarks are expected at: bearings (`line`) or leans (`slope`), rad."""

    camera: Camera
    kind: Literal["line", "slope"]

    def measured(self, edges: Edges) -> tuple[Array, Array]:
        """Return the measured angle (E,) and its variance (E,), the mount's common error included.

        The common error is shared by all edges of a frame; here it widens each of them: safe while it is small.
        """
        return _measured(self, edges)

    def mount_var(self, edges: Edges) -> Array:
        """Return the variance (E,), rad², of the bearings by the mount's common error."""
        common = edges.common
        by_mount = common.bearing_from_line if self.kind == "line" else common.bearing_from_lean
        return np.asarray(np.einsum("ek,kl,el->e", by_mount, common.cov, by_mount))

    def predicted(self, tangent: Array) -> tuple[Array, Array]:
        """Return the angle that is compared (P,) for tan(bearing) (P,), and its derivative by the bearing."""
        if self.kind == "line":
            return np.arctan(tangent), np.ones_like(tangent)
        s = np.sin(self.camera.mount.tilt_rad)
        return np.arctan(s * tangent), s * (1 + tangent**2) / (1 + (s * tangent) ** 2)

    def bearings(self, edges: Edges) -> tuple[Array, Array]:
        """Return the bearing (E,) that the compared angle tells, and its sigma (E,); what is common does not move."""
        if self.kind == "line":
            return edges.bearing, edges.bearing_sigma
        tilt_rad = self.camera.mount.tilt_rad
        bearing = geometry.bearing_from_lean(edges.lean, tilt_rad)
        return bearing, edges.lean_sigma * np.abs(geometry.bearing_per_lean(bearing, tilt_rad))

    def span_at(self, bearing: Array) -> Array:
        """Return the angle (E,) of bearings at which a density per rad of bearing is that of evenly spread clutter.

        Clutter is spread evenly over the compared angle. So it is denser in bearing where a lean changes faster.
        """
        return self.span_rad / self.predicted(np.tan(bearing))[1]

    @cached_property
    def span_rad(self) -> float:
        """The angle (rad) that clutter is spread over."""
        a_left, a_right, _, _ = self.camera.upright_bounds
        predicted, _ = self.predicted(np.array([a_left, a_right]) / np.cos(self.camera.mount.tilt_rad))
        return float(abs(predicted[1] - predicted[0]))


@lru_cache(maxsize=8)  # asked for several times in a frame
def _measured(angle: Angle, edges: Edges) -> tuple[Array, Array]:
    if angle.kind == "line":
        return edges.bearing, edges.bearing_sigma**2 + angle.mount_var(edges)
    tilt_rad = angle.camera.mount.tilt_rad
    per_bearing = 1.0 / geometry.bearing_per_lean(geometry.bearing_from_lean(edges.lean, tilt_rad), tilt_rad)
    return edges.lean, edges.lean_sigma**2 + angle.mount_var(edges) * per_bearing**2
