"""All edges of a log as one table, and the poses from which they were seen."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from localiser.camera import Camera, Mount
from localiser.edges import TURN_RATE, Edges, foot_of_edges
from localiser.geometry import Array, compose

Index = NDArray[np.int64]
_BORDER_PX = 3.0  # an end this close to the image border goes on outside
_SIDE = 3  # outer samples of a profile that make up one side of the edge


@dataclass(frozen=True, slots=True, eq=False)
class Sightings:
    """The edges of T frames as columns, S of them, sorted by frame.

    first: (T + 1,) where each frame's edges begin. frame: (S,). bearing, sigma: (S,) rad, in the camera's level frame.
    polarity: (S,). side: (S, 2) grey values left and right of the edge, nan where unknown.
    slope_up: (S, 2) height above the camera of the lower and the upper end per metre ahead. cut: (S, 2) whether
    that end lies at the image's border, so that the edge may go on. foot_m: (S,) range of the foot if it stands on the
    floor, nan where no foot is seen. marker: (S,) side of a marker, see `markers`, -1 for none.
    mounts: (T,) of the camera at each frame, None: as the camera says; empty where it always is so.
    """

    first: Index
    frame: Index
    bearing: Array
    sigma: Array
    polarity: NDArray[np.int8]
    side: Array
    slope_up: Array
    cut: NDArray[np.bool_]
    foot_m: Array
    marker: Index
    mounts: tuple[Mount | None, ...] = ()

    def __len__(self) -> int:
        return len(self.frame)

    @property
    def frames(self) -> int:
        """The number of frames."""
        return len(self.first) - 1

    @classmethod
    def from_edges(cls, frames: Sequence[Edges], camera: Camera) -> Sightings:
        """Return the table of the edges of T frames, seen by one camera, as it was mounted in each."""
        count = np.array([len(edges) for edges in frames], dtype=np.int64)
        first = np.concatenate([[0], np.cumsum(count)])

        def column(name: str, shape: tuple[int, ...] = ()) -> Array:
            parts = [getattr(edges, name) for edges in frames if len(edges)]
            return np.concatenate(parts) if parts else np.zeros((0, *shape))

        sigma = [np.zeros(0)]
        for edges in frames:  # what a turn rate moves in an image counts as an error of each edge
            own, common = edges.bearing_sigma, edges.common
            if TURN_RATE in common.names:
                by_turn = common.bearing_from_line[:, common.names.index(TURN_RATE)]
                own = np.hypot(own, by_turn * common.sigma_of(TURN_RATE))
            sigma.append(own)
        ends_px = column("ends_px", (2, 2))
        # Edges that were not measured in an image may know their ends, and not what follows from them.
        slope_up, cut, foot_m = _by_mount(ends_px, frames, camera)
        return cls(
            first=first,
            frame=np.repeat(np.arange(len(frames)), count),
            bearing=column("bearing"),
            sigma=np.concatenate(sigma),
            polarity=column("polarity").astype(np.int8),
            side=np.concatenate([np.zeros((0, 2)), *(_sides(edges.profile) for edges in frames)]),
            slope_up=slope_up,
            cut=cut,
            foot_m=foot_m,
            marker=np.minimum(column("landmark_id").astype(np.int64), -1),
            mounts=_mounts(frames),
        )

    @classmethod
    def together(cls, parts: Sequence[Sightings], cameras: Sequence[Camera]) -> Sightings:
        """Return the tables of several logs as one, their frames one after the other; cameras: one for each log."""
        mounts = [
            [part.camera_at(frame, camera).mount for frame in range(part.frames)]
            for part, camera in zip(parts, cameras, strict=True)
        ]
        columns: dict[str, Any] = {
            f.name: np.concatenate([getattr(part, f.name) for part in parts])
            for f in fields(cls)
            if f.name not in ("first", "frame", "mounts")
        }
        frames = np.concatenate([[0], np.cumsum([part.frames for part in parts])])
        sizes = np.concatenate([np.diff(part.first) for part in parts])
        return cls(
            first=np.concatenate([[0], np.cumsum(sizes)]),
            frame=np.concatenate([part.frame + begin for part, begin in zip(parts, frames[:-1], strict=True)]),
            mounts=tuple(mount for part in mounts for mount in part),
            **columns,
        )

    def camera_at(self, frame: int, camera: Camera) -> Camera:
        """Return the camera as it was mounted at a frame."""
        return camera.at(self.mounts[frame]) if self.mounts else camera

    def robot_from_level(self, camera: Camera) -> Array:
        """Return the floor poses (T, 3) of the camera in the robot frame."""
        if not self.mounts:
            return np.tile(camera.robot_from_level, (self.frames, 1))
        return np.array([self.camera_at(t, camera).robot_from_level for t in range(self.frames)])

    def camera_poses(self, camera: Camera, robot_poses: Array) -> Array:
        """Return the floor poses (T, 3) of the camera in the map, for robots at `robot_poses` (T, 3)."""
        return compose(robot_poses, self.robot_from_level(camera))


def _mounts(frames: Sequence[Edges]) -> tuple[Mount | None, ...]:
    """Return the mount of each frame; empty where the camera always sits as it says."""
    mounts = tuple(edges.mount for edges in frames)
    return () if all(mount is None for mount in mounts) else mounts


def _sides(profile: Array) -> Array:
    """Return the grey values (E, 2) left and right of edges with profiles (E, P); nan where they are too short."""
    middle = profile.shape[1] // 2
    if profile.shape[1] < 2 * _SIDE:
        return np.full((len(profile), 2), np.nan)
    # The samples next to the edge hold its blur, the outermost ones perhaps the next edge.
    sides = profile[:, middle - _SIDE : middle], profile[:, middle + 1 : middle + 1 + _SIDE]
    return np.column_stack([np.median(side, axis=1) for side in sides])


def _by_mount(ends_px: Array, frames: Sequence[Edges], camera: Camera) -> tuple[Array, NDArray[np.bool_], Array]:
    """Return slopes and cuts of the ends (S, 2, 2) of all edges, and the range of the feet."""

    def of(ends: Array, mounted: Camera) -> tuple[Array, NDArray[np.bool_], Array]:
        return *_ends(ends, mounted), foot_of_edges(ends[:, 0], mounted)[0]

    if not _mounts(frames):
        return of(ends_px, camera)
    parts = [of(edges.ends_px, camera.at(edges.mount)) for edges in frames]
    slope_up, cut, foot_m = (np.concatenate(column) for column in zip(*parts, strict=True))
    return slope_up, cut, foot_m


def _ends(ends_px: Array, camera: Camera) -> tuple[Array, NDArray[np.bool_]]:
    """Return height per metre ahead (S, 2) of the ends (S, 2, 2), and whether each is cut off by the border."""
    upright = camera.upright_from_pixels(ends_px)
    s, c = np.sin(camera.mount.tilt_rad), np.cos(camera.mount.tilt_rad)
    e = upright[..., 1]
    size = np.array([camera.width, camera.height])
    cut = ~((ends_px >= _BORDER_PX) & (ends_px <= size - 1 - _BORDER_PX)).all(axis=-1)
    # The inverse of e = (c y + s d) / (c d - s y), for y above the camera and d ahead of it.
    return np.asarray((e * c - s) / (c + e * s)), np.asarray(cut)


def direction_of(points: Array, cameras: Array) -> tuple[Array, Array]:
    """Return heading (K,) rad and distance (K,) m from cameras (K, 2+) to points (K, 2), in the map."""
    offset = points - cameras[:, :2]
    return np.arctan2(-offset[:, 0], -offset[:, 1]), np.hypot(offset[:, 0], offset[:, 1])


def per_point(points: Array, cameras: Array) -> Array:
    """Return the derivative (K, 2) of `direction_of`'s heading by the point's (x, z)."""
    offset = points - cameras[:, :2]
    squared = np.maximum((offset**2).sum(axis=1), 1e-12)
    return np.asarray(np.stack([offset[:, 1], -offset[:, 0]], axis=-1) / squared[:, None])
