"""The measurements of one image for global localisation: bearings, and the lower end of each edge."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from localiser.camera import Camera
from localiser.edges import Edges
from localiser.geometry import Array, between, compose
from localiser.observation import ENDPOINT_SIGMA_PX, Angle, end_per_height, ends_lower_first


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """The E edges of one image, left to right.

    bearing, bearing_sigma: (E,) rad. foot: (E,) upright image height of the lower end, nan where it is not known.
    cut: (E,) whether that end is the border of the image. foot_sigma: its error, the mount's included. length_px: (E,),
    1 where it is not known.
    """

    camera: Camera
    bearing: Array
    bearing_sigma: Array
    foot: Array
    cut: NDArray[np.bool_]
    foot_sigma: float
    length_px: Array

    def __len__(self) -> int:
        return len(self.bearing)

    def robot_poses(self, camera_poses: Array) -> Array:
        """Return where in the map (N, 3) the robot is whose camera is at (N, 3)."""
        return compose(camera_poses, between(self.camera.robot_from_level, np.zeros(3)))


def are_known(camera: Camera, edges: Edges, kind: Literal["line", "slope"] = "line") -> NDArray[np.bool_]:
    """Return which edges (E,) have a known bearing: a view holds only these."""
    angle = Angle(camera, kind)
    bearing, sigma = angle.bearings(edges)
    return np.asarray(np.isfinite(bearing) & np.isfinite(sigma**2 + angle.mount_var(edges)))


def view_of(camera: Camera, edges: Edges, kind: Literal["line", "slope"] = "line") -> View:
    """Return the view of `edges` seen by `camera`, by their line or by their slope alone."""
    angle = Angle(camera, kind)
    bearing, sigma = angle.bearings(edges)
    variance = sigma**2 + angle.mount_var(edges)
    known = np.flatnonzero(are_known(camera, edges, kind))
    order = known[np.argsort(bearing[known], kind="stable")]
    ends, cut = ends_lower_first(edges.ends_px[order], camera)
    unknown = np.isnan(ends).any(axis=1)
    known_sigma = np.hypot(ENDPOINT_SIGMA_PX / camera.focal_px, edges.common.sigma_of("tilt"))
    by_height = edges.height_sigma_m * end_per_height(ends, camera)[:, 0]
    foot = np.where(unknown, _height_at(camera, bearing[order], edges.foot_range_m[order]), ends[:, 0])
    return View(
        camera=camera,
        bearing=bearing[order],
        bearing_sigma=np.sqrt(variance[order]),
        foot=foot,
        cut=cut[:, 0] & ~unknown,
        foot_sigma=float(np.hypot(known_sigma, np.median(by_height[~unknown]) if not unknown.all() else 0.0)),
        length_px=np.nan_to_num(edges.length_px[order], nan=1.0),
    )


def _height_at(camera: Camera, bearing: Array, floor_range_m: Array) -> Array:
    """Return the upright image heights (E,) of floor points at bearings (E,) and ranges (E,), nan where unknown."""
    s, c, height_m = np.sin(camera.mount.tilt_rad), np.cos(camera.mount.tilt_rad), camera.mount.height_m
    ahead = floor_range_m * np.cos(bearing)
    return np.asarray((ahead * s - height_m * c) / (ahead * c + height_m * s))
