"""The landmark map, and which landmarks a camera sees from many poses at once."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from localiser import geometry
from localiser.camera import Camera
from localiser.geometry import Array

FRAME = {"axes": "x right, y up, z backward", "units": "m"}


@dataclass(frozen=True, slots=True, eq=False)
class LandmarkMap:
    """Vertical edges of a building, L of them, as columns; nan where something is not known.

    ids: L unique names. points: (L, 2) x, z in metres. cov: (L, 2, 2) m². bottom_m, top_m: (L,) heights above the
    floor between which the edge can be seen. polarity: (L,) as in `Edges`, seen from where it was measured, 0 unknown.
    source: how each was obtained. extra: unknown keys of each landmark, header: unknown keys of the file; both are
    kept so that a newer version's file survives being saved.
    """

    name: str
    ids: tuple[int | str, ...]
    points: Array
    cov: Array
    bottom_m: Array
    top_m: Array
    polarity: NDArray[np.int8]
    source: tuple[str, ...]
    frame: dict[str, Any] = field(default_factory=lambda: dict(FRAME))
    extra: tuple[dict[str, Any], ...] = ()
    header: dict[str, Any] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.ids)

    @classmethod
    def from_points(
        cls,
        points: Array,
        *,
        name: str = "",
        ids: tuple[int | str, ...] | None = None,
        bottom_m: Array | None = None,
        top_m: Array | None = None,
        source: str = "",
    ) -> LandmarkMap:
        """Return a map of points (L, 2) with heights where given; the rest is unknown."""
        count = len(points)
        return cls(
            name=name,
            ids=tuple(range(count)) if ids is None else ids,
            points=np.asarray(points, dtype=np.float64).reshape(count, 2),
            cov=np.full((count, 2, 2), np.nan),
            bottom_m=np.full(count, np.nan) if bottom_m is None else bottom_m,
            top_m=np.full(count, np.nan) if top_m is None else top_m,
            polarity=np.zeros(count, dtype=np.int8),
            source=(source,) * count,
            extra=({},) * count,
        )


@dataclass(frozen=True, slots=True, eq=False)
class Sight:
    """Landmarks seen from camera poses: P pairs (pose, landmark), sorted by pose.

    pose, landmark: (P,) indices. tangent: (P,) tan(bearing) from the camera. range_m: (P,) floor distance.
    length_px: (P,) length of the part inside the image.
    """

    pose: NDArray[np.int64]
    landmark: NDArray[np.int64]
    tangent: Array
    range_m: Array
    length_px: Array


def in_camera(camera_poses: Array, points: Array) -> tuple[Array, Array]:
    """Return (right, ahead), each (N, L) m: landmarks (L, 2) in the level frames of camera poses (N, 3)."""
    cos, sin = np.cos(camera_poses[:, 2]), np.sin(camera_poses[:, 2])
    dx = points[:, 0] - camera_poses[:, 0:1]
    dz = points[:, 1] - camera_poses[:, 1:2]
    right = dx * cos[:, None] - dz * sin[:, None]
    ahead = -(dx * sin[:, None] + dz * cos[:, None])
    return right, ahead


__all__ = ["FRAME", "LandmarkMap", "Sight", "geometry", "in_camera", "Camera"]
