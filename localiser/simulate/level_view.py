"""The level view: what an untilted camera at the same place would see, and the look-up that tilts it.

Tilt, roll and lens turn rays about the camera's centre only, so one look-up makes the real image out of the level
view, in which every vertical edge is a column (design equation 3). What each column shows comes from rays in plan
against the solids, and the stack of surfaces that are visible.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from localiser.camera import Camera
from localiser.geometry import Array
from localiser.landmarks import in_camera
from localiser.simulate.solids import Solids

OVERSAMPLE = 2  # samples along each axis, of the level view and of the final image, for one pixel of that image
SMALLEST_DEPTH = 0.2  # rays steeper down (or up) than 78° would need a level view without end


@dataclass(frozen=True, slots=True, eq=False)
class LevelView:
    """The level view's pixels, C columns of R rows, and where the camera's image finds its samples in them.

    Column i holds tan(bearing) from left + i / per_unit to left + (i + 1) / per_unit. Row j samples the elevation
    tangent top - (j + 1/2) / per_unit. first_row, stop_row: (C,) rows that the image needs. row_at, column_at:
    (H', W') of each sample of the image. size: (W, H) of the image.
    """

    left: float
    top: float
    per_unit: float
    columns: int
    rows: int
    first_row: NDArray[np.intp]
    stop_row: NDArray[np.intp]
    row_at: NDArray[np.float32]
    column_at: NDArray[np.float32]
    size: tuple[int, int]

    def elevation_of_rows(self, rows: NDArray[np.intp]) -> NDArray[np.float32]:
        """Return the elevation tangents sampled by these rows."""
        return (self.top - (rows + 0.5) / self.per_unit).astype(np.float32)

    def rows_below(self, elevation: Array) -> NDArray[np.intp]:
        """Return the first rows that sample below these elevation tangents."""
        return np.ceil((self.top - elevation) * self.per_unit - 0.5).astype(np.intp)

    def image(self, view: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return the camera's image (H, W, 3) of the level view (C, R, 3)."""
        fine = cv2.remap(view, self.row_at, self.column_at, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        return np.asarray(cv2.resize(fine, self.size, interpolation=cv2.INTER_AREA))


def require_view_ahead(camera: Camera) -> None:
    """Raise ValueError when the image looks straight down somewhere; its border then does, or looks behind."""
    rays = camera.level_rays(camera.border_px(outside_px=0.5))
    if not (-rays[..., 2] / np.linalg.norm(rays, axis=-1)).min() > SMALLEST_DEPTH:
        raise ValueError("the image must not look straight down: expected a smaller tilt or a narrower field of view")


@lru_cache(maxsize=1)
def level_view_of(camera: Camera) -> LevelView:
    """Return the level view that covers the camera's image, which must not look straight down."""
    return _view_of_rays(_rays(camera), camera)


def strip_view_of(camera: Camera, rows: slice, turned_rad: Array) -> LevelView:
    """Return the level view that covers some rows (R,) of the camera's image, each taken with the camera turned on.

    turned_rad: (R,) anticlockwise, about the vertical through the camera.
    """
    rays = _rays(camera)[rows.start * OVERSAMPLE : rows.stop * OVERSAMPLE]
    turned = np.repeat(turned_rad, OVERSAMPLE)[:, None]
    x, z = rays[..., 0], rays[..., 2]
    cos, sin = np.cos(turned), np.sin(turned)
    return _view_of_rays(np.stack([cos * x + sin * z, rays[..., 1], -sin * x + cos * z], axis=-1), camera)


@lru_cache(maxsize=1)
def _rays(camera: Camera) -> Array:
    """Return rays (H', W', 3) of the level frame through all samples of the camera's image."""
    u = (np.arange(camera.width * OVERSAMPLE) + 0.5) / OVERSAMPLE - 0.5
    v = (np.arange(camera.height * OVERSAMPLE) + 0.5) / OVERSAMPLE - 0.5
    return camera.level_rays(np.stack(np.meshgrid(u, v), axis=-1))


def _view_of_rays(rays: Array, camera: Camera) -> LevelView:
    """Return the level view that covers rays (H', W', 3) of some rows of the camera's image."""
    bearing, elevation = rays[..., 0] / -rays[..., 2], rays[..., 1] / -rays[..., 2]
    per_unit = OVERSAMPLE * camera.focal_px
    margin = 3 / per_unit
    left, top = float(bearing.min() - margin), float(elevation.max() + margin)
    columns = int(np.ceil((bearing.max() + margin - left) * per_unit))
    rows = int(np.ceil((top - elevation.min() + margin) * per_unit))
    column_at, row_at = (bearing - left) * per_unit - 0.5, (top - elevation) * per_unit - 0.5
    # For each column the rows that interpolation touches, with two columns and rows to spare.
    first, last = np.full(columns, rows), np.full(columns, -1)
    column, row = (np.floor(at).astype(np.intp).ravel() for at in (column_at, row_at))
    np.minimum.at(first, column, row)
    np.maximum.at(last, column, row)
    first, last = (
        least([np.roll(rim, k) for k in range(-2, 4)], axis=0) for least, rim in ((np.min, first), (np.max, last))
    )
    first_row, stop_row = np.clip(first - 2, 0, rows), np.clip(last + 4, 0, rows)
    return LevelView(
        left,
        top,
        per_unit,
        columns,
        rows,
        first_row,
        np.maximum(stop_row, first_row),
        row_at.astype(np.float32),
        column_at.astype(np.float32),
        (camera.width, len(rays) // OVERSAMPLE),
    )


# -- what each column shows -------------------------------------------------------------------------------------------

NEAR_M = 0.02
FLOOR, CEILING = -1, -2


@dataclass(frozen=True, slots=True, eq=False)
class Columns:
    """Rays of the level view, C of them, from left to right.

    tangent: (C,) tan(bearing) of each ray. owner: (C,) column of the view that it is part of. share: (C,) of that
    column's width. A column is split where a vertical edge crosses it, which makes the view's edges exact.
    """

    tangent: Array
    owner: NDArray[np.intp]
    share: Array


class Hits(NamedTuple):
    """Where C rays meet P solids; distances are along the camera's level axis, so a point is distance·(tan b, 1).

    entry, leave: (P, C) distances, entry inf where a ray misses.
    """

    entry: Array
    leave: Array


@dataclass(frozen=True, slots=True, eq=False)
class Spans:
    """Visible pieces of surface, S of them, column by column from top to bottom.

    column: (S,) ray. first_row, count: (S,) rows of the view. solid: (S,) index, FLOOR or CEILING. is_upright: (S,)
    faces rather than tops and undersides. distance_m: (S,) of faces. above_m: (S,) height of tops over the camera.
    """

    column: NDArray[np.intp]
    first_row: NDArray[np.intp]
    count: NDArray[np.intp]
    solid: NDArray[np.intp]
    is_upright: NDArray[np.bool_]
    distance_m: Array
    above_m: Array


def columns_of(view: LevelView, camera_pose: Array, edge_points: Array) -> Columns:
    """Return the rays of the view from the camera's floor pose (3,), split at the vertical edges (M, 2)."""
    right, ahead = (axis[0] for axis in in_camera(camera_pose[None], edge_points))
    is_ahead = ahead > NEAR_M
    at = (right[is_ahead] / ahead[is_ahead] - view.left) * view.per_unit
    borders = np.union1d(np.arange(view.columns + 1.0), at[(at > 0) & (at < view.columns)])
    middle = (borders[:-1] + borders[1:]) / 2
    return Columns(view.left + middle / view.per_unit, middle.astype(np.intp), np.diff(borders))


def cast(solids: Solids, camera_pose: Array, tangent: Array) -> Hits:
    """Return where rays at `tangent` (C,) from the camera's floor pose (3,) meet each solid (P): slabs of half-planes.

    Solids that the camera is in, or that lie behind it, are missed.
    """
    normals, offsets = solids.half_planes()
    cos, sin = np.cos(camera_pose[2]), np.sin(camera_pose[2])
    right, ahead = np.array([cos, -sin]), np.array([-sin, -cos])
    gap = offsets - normals @ camera_pose[:2]
    entry = np.full((len(solids), len(tangent)), -np.inf)
    leave = np.full((len(solids), len(tangent)), np.inf)
    for k in range(normals.shape[1]):
        speed = (normals[:, k] @ right)[:, None] * tangent + (normals[:, k] @ ahead)[:, None]
        with np.errstate(divide="ignore", invalid="ignore"):
            distance = gap[:, k, None] / speed
        entry = np.where((speed < 0) & (distance > entry), distance, entry)
        leave = np.where(speed > 0, np.fmin(leave, distance), leave)
        leave = np.where((speed == 0) & (gap[:, k, None] < 0), -np.inf, leave)
    missed = (entry >= leave) | (entry < NEAR_M)
    return Hits(np.where(missed, np.inf, entry), leave)


class _Scenery(NamedTuple):
    """Hits, and heights above the camera: bottom, top (P,) of solids, floor < 0, ceiling > 0."""

    hits: Hits
    bottom: Array
    top: Array
    floor: float
    ceiling: float


def spans_of(solids: Solids, hits: Hits, view: LevelView, columns: Columns, shell_m: tuple[float, float]) -> Spans:
    """Return what each column (C) shows; shell_m: height of camera and ceiling above the floor.

    At every elevation the nearest surface is seen. Elevations at which that may change are the ends of faces and of
    tops; between two of them one surface is seen throughout.
    """
    eye, ceiling = shell_m
    scenery = _Scenery(hits, solids.bottom_m - eye, solids.top_m - eye, -eye, ceiling - eye)
    low = view.top - view.stop_row[columns.owner] / view.per_unit
    high = view.top - view.first_row[columns.owner] / view.per_unit
    solid = _candidates(scenery, low, high)
    # Columns with up to 2, 5, 10, 20, … candidates, so that few columns pay for many solids.
    count = (solid >= 0).sum(axis=0)
    limits = [-1, 2, 5, 10, 20, 40, max(41, int(count.max(initial=0)))]
    groups = [np.flatnonzero((count > least) & (count <= most)) for least, most in pairwise(limits)]
    parts = [_stack(scenery, view, columns, group, solid[:, group]) for group in groups if len(group)]
    return Spans(*(np.concatenate([getattr(part, name) for part in parts]) for name in Spans.__slots__))


def _candidates(scenery: _Scenery, low: Array, high: Array) -> NDArray[np.intp]:
    """Return for each ray the solids (K, C) that it may show, packed to the front, -1 behind them.

    Left out: what stands behind a wall from floor to ceiling, and what lies above or below the view, which reaches
    from the elevation low to high (C,).
    """
    entry, leave = scenery.hits.entry, scenery.hits.leave
    with np.errstate(divide="ignore", invalid="ignore"):
        ends = np.stack([height[:, None] / d for height in (scenery.bottom, scenery.top) for d in (entry, leave)])
    is_full = (scenery.bottom <= scenery.floor + 1e-9) & (scenery.top >= scenery.ceiling - 1e-9)
    wall = np.where(is_full[:, None], entry, np.inf).min(axis=0, initial=np.inf)
    is_seen = np.isfinite(entry) & (entry <= wall) & (ends.min(axis=0) < high) & (ends.max(axis=0) > low)
    order = np.argsort(~is_seen, axis=0, kind="stable")[: int(is_seen.sum(axis=0).max(initial=0))]
    return np.where(np.take_along_axis(is_seen, order, axis=0), order, -1)


def _stack(
    scenery: _Scenery, view: LevelView, columns: Columns, column: NDArray[np.intp], solid: NDArray[np.intp]
) -> Spans:
    """Return what the rays `column` (C',) show of the solids (K, C') that they may meet."""
    # One missing solid at least, so that rays which meet nothing need no case of their own.
    number = max(1, int((solid >= 0).sum(axis=0).max(initial=0)))
    padding = np.full((1, len(column)), -1)
    solid = np.concatenate([solid, padding])[:number]
    # Of each solid (K, C') the face at entry, infinitely far for a missing one, and the top or underside (cap) behind
    # it, nan where there is none: a top is seen from above, an underside from below; never both.
    entry, leave = (np.where(solid >= 0, distance[solid, column], np.inf) for distance in scenery.hits)
    bottom, top = scenery.bottom[solid], scenery.top[solid]
    cap = np.where(top < 0, top, np.where(bottom > 0, bottom, np.nan))
    low, high = bottom / entry, top / entry
    # The elevations (I, C'), falling, at which another surface may come into sight; the horizon is one.
    limits = np.concatenate([low, high, np.nan_to_num(cap / leave), np.zeros((1, len(column)))])
    limits = np.sort(limits, axis=0)[::-1]
    # Between them the nearest is seen that the middle meets: k face, K + k cap, 2K floor or ceiling.
    far = np.full((1, len(column)), 1e3)
    ends = np.concatenate([far, limits, -far])
    middle = ((ends[:-1] + ends[1:]) / 2)[:, None]
    with np.errstate(divide="ignore", invalid="ignore"):
        faces = np.where((middle >= low) & (middle <= high), entry, np.inf)
        at_cap = cap / middle
        caps = np.where((at_cap >= entry) & (at_cap <= leave), at_cap, np.inf)
        shell = np.where(middle < 0, scenery.floor, scenery.ceiling) / middle
    nearest, middle = np.concatenate([faces, caps, shell], axis=1).argmin(axis=1), middle[:, 0]
    is_upright, is_shell = nearest < number, nearest == 2 * number
    which = np.where(is_shell, 0, nearest % number)
    here = np.broadcast_to(np.arange(len(column)), nearest.shape)
    owner = columns.owner[column]
    top_row, stop_row = np.zeros((1, len(column)), dtype=np.intp), np.full((1, len(column)), view.rows)
    rows = np.concatenate([top_row, view.rows_below(limits), stop_row])
    rows = np.clip(rows, view.first_row[owner], view.stop_row[owner])
    count = np.diff(rows, axis=0)
    kept = np.nonzero((count > 0).T)[::-1]  # column by column
    is_below = middle < 0
    return Spans(
        column=column[here][kept],
        first_row=rows[:-1][kept],
        count=count[kept],
        solid=np.where(is_shell, np.where(is_below, FLOOR, CEILING), solid[which, here])[kept],
        is_upright=is_upright[kept],
        distance_m=entry[which, here][kept],
        above_m=np.where(is_shell, np.where(is_below, scenery.floor, scenery.ceiling), cap[which, here])[kept],
    )
