"""The likelihood of edges by compiled loops: the sum over particles, landmarks and edges.

Several questions about the same particles, views, are answered by one call. Four things make it fast, and none of them
changes the result by more than 1e-5. Particles are sorted into cells of floor and heading, and only the landmarks that
can be in view from a cell are looked at. An edge that no landmark comes near costs nothing. The loops run as vector
instructions (`likelihood_kernel`). No more particles are weighed at a time than the cache holds. A particle's result
depends on that particle alone, whatever number of threads share the work.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from localiser.camera import Camera
from localiser.edges import Edges
from localiser.geometry import Array
from localiser.landmarks import (
    LandmarkMap,
    SightParameters,
    in_view_of_cells,
    kept_with,
    reach_of,
    sigmas_m,
    widest_tangent,
)
from localiser.markers import code_of
from localiser.observation import endpoint_likelihood as endpoints
from localiser.observation.angle import Angle
from localiser.observation.parameters import ObservationParameters
from localiser.observation.sighting import Sighting

# An edge of a landmark has its polarity with probability 0.9, and clutter has both alike. So p(polarity | landmark) / ½
# is 1 + polarity_e · MEAN_POLARITY · polarity_l, and 1 where either is unknown (0). See docs/notes/observation.md.
MEAN_POLARITY = 2 * 0.9 - 1.0
GATE_SIGMAS = 6.0  # beyond this a normal density is below 1e-8 of its peak: nothing beside clutter
_UNKNOWN_M = 1e9  # beyond every height
_CELL = np.array([0.5, 0.5, 2 * np.pi / 32])  # m, m, rad; larger where particles are few
_PER_CELL = 32  # particles, at least, if they were spread evenly
_SMALLEST = 1e-6  # m, m, rad
_LARGEST_M = 4.0  # side of a cell of a cloud that is spread over a building
_MOST_CELLS = 1 << 18  # of such a cloud, most of them empty
_LANES, _STATEMENTS = 8, 2  # rates of a view, and which landmarks are hidden, at most: `likelihood_kernel`
_BINS = 512  # of the compared angle
_PER_THREAD = 4096  # particles, below which another thread is not worth its start
_PART = 16384  # particles weighed by one thread at a time: poses and results stay in the second cache

EdgeBins = tuple[NDArray[np.int64], tuple[float, float, float]]


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """One of the questions that a particle's edges answer at once, see `likelihood_kernel.log_products`.

    rates: (K,) ascending, at most 8. of_edges: whether these are inlier rates, else detection rates. clutter: (E,) how
    dense clutter is at each edge; None: as dense everywhere. visibility: (L,) probability that a landmark in view is
    not hidden; None: none is.
    """

    rates: Array
    of_edges: bool
    clutter: Array | None = None
    visibility: Array | None = None


@dataclass(frozen=True, slots=True, eq=False)
class EdgeTable:
    """The edges of one image as the loop takes them, by their compared angle.

    rows: (E, 13) compared angle (rad, ascending, inf where unknown), its variance (rad²), upright image heights of the
    lower and upper end (∓1e9 where unknown), 1 / length, of both ends the room that clutter has, the peak beside it and
    1 / sigma, polarity, landmark whose edge it is said to be, -1 for any. order: (E,) which edge a row is. bins: of
    their angles, see `bins_of`. largest_var: of the known ones. missed: p(an end is not its landmark's).
    """

    rows: Array
    order: NDArray[np.int64]
    bins: EdgeBins
    largest_var: float
    missed: float


def marked_landmarks(edges: Edges, landmark_map: LandmarkMap) -> NDArray[np.int64]:
    """Return the landmark (E,) that each edge is by the marker whose side it is; -1 for others.

    A side that the map has twice tells none of them.
    """
    if not (edges.landmark_id < -1).any():
        return np.full(len(edges), -1)
    of = kept_with(landmark_map, ("markers",), lambda: sides_on(landmark_map))
    return np.array([of.get(code, -1) for code in edges.landmark_id.tolist()], dtype=np.int64)


def sides_on(landmark_map: LandmarkMap) -> dict[int, int]:
    """Return the landmark of each marker's side that the map has once. Raises InputError for a name that is none."""
    names = [(k, one["identity"]) for k, one in enumerate(landmark_map.extra) if "identity" in one]
    codes = [(k, code_of(name)[0]) for k, name in names]
    count = Counter(code for _, code in codes)
    return {code: k for k, code in codes if count[code] == 1}


@lru_cache(maxsize=64)  # the same edges are weighed several times in a frame, and when places are proposed later
def edge_table(angle: Angle, edges: Edges, blur_rad: float, identified: bool, landmark_map: LandmarkMap) -> EdgeTable:
    """Return the table of edges. blur_rad: sigma that is added to every edge's own.

    identified: whether edges are of the landmark that they name, and of none where they name none.
    """
    measured, variance = angle.measured(edges)
    known = np.isfinite(measured) & np.isfinite(variance)
    identity = marked_landmarks(edges, landmark_map).astype(np.float64)
    if identified:
        known, identity = known & (edges.landmark_id >= 0), edges.landmark_id.astype(np.float64)
    # Edges of which this observation knows nothing go to the end: no landmark comes near them.
    measured, variance = np.where(known, measured, np.inf), np.where(known, variance + blur_rad**2, 1.0)
    ends = endpoints.endpoints_of(edges, angle.camera)
    columns: list[NDArray[Any]] = [measured, variance, ends.e, ends.per_length, ends.room, ends.peak]
    columns += [1.0 / ends.sigma, edges.polarity, identity]
    order = np.argsort(measured, kind="stable")[: known.sum() if identified else None]
    rows = np.column_stack(columns)[order]
    return EdgeTable(rows, order, bins_of(rows[: known.sum(), 0]), float(variance[known].max(initial=0.0)), ends.missed)


@lru_cache(maxsize=16)
def _view(camera: Camera, sight: SightParameters) -> tuple[tuple[float, ...], float]:
    """Return the view of a scene, and the bound on |tan(bearing)|."""
    margin = sight.margin_px / camera.focal_px * np.array([-1.0, 1.0, -1.0, 1.0])
    bounds: list[float] = (np.array(camera.upright_bounds) + margin).tolist()
    tilt_rad, shortest = camera.mount.tilt_rad, max(sight.length_min_px, 1e-9) / camera.focal_px
    return (float(np.sin(tilt_rad)), float(np.cos(tilt_rad)), *bounds, shortest), widest_tangent(camera, sight)


def _landmarks(landmark_map: LandmarkMap, height_m: float, sigma_m: float, scale: float) -> Array:
    """Return the landmarks of a scene (L, 6), worked out again when the camera's height or the map's scale changes."""

    def make() -> Array:
        bottom, top = landmark_map.bottom_m - height_m, landmark_map.top_m - height_m
        columns: list[Array] = [
            landmark_map.points,
            np.where(np.isnan(bottom), -_UNKNOWN_M, bottom),
            np.where(np.isnan(top), _UNKNOWN_M, top),
            (scale * sigmas_m(landmark_map, sigma_m)) ** 2,
            np.asarray(MEAN_POLARITY * landmark_map.polarity, dtype=np.float64),
        ]
        return np.column_stack(columns)

    kept: dict[tuple[float, float], Array] = kept_with(landmark_map, ("scene", sigma_m), dict)
    if (height_m, scale) not in kept:
        kept.clear()
        kept[height_m, scale] = make()
    return kept[height_m, scale]


def by_views(
    angle: Angle,
    parameters: ObservationParameters,
    columns: Array,
    sighting: Sighting,
    landmark_map: LandmarkMap,
    views: Sequence[View],
    blur_rad: float = 0.0,
) -> list[Array]:
    """Return log p(edges | pose, rate_k) (K, N) of N particles in each view, relative to clutter alone.

    columns: (4, N) x, z, heading of the robot, and by how much the camera's yaw differs from the mount's.
    """
    count, threads = columns.shape[1], parameters.threads
    table = edge_table(angle, sighting.edges, blur_rad, parameters.association == "known", landmark_map)
    mount, sight = angle.camera.mount, parameters.sight
    landmarks = _landmarks(landmark_map, mount.height_m, parameters.landmark_sigma_m, sighting.map_scale)
    offset, (seen, widest) = (mount.right_m, mount.back_m, mount.yaw_rad), _view(angle.camera, sight)
    farthest_m, reach = sight.far.range_max_m, reach_of(landmark_map, sight.far.range_max_m)
    # What all views share: which landmarks show, by distinct statements, and tables of rates and of clutter.
    hidden = {id(view.visibility): view.visibility for view in views}
    if len(hidden) > _STATEMENTS:
        raise ValueError(
            f"expected at most {_STATEMENTS} statements of which landmarks are hidden, found {len(hidden)}"
        )
    visibility = np.stack([np.ones(len(landmark_map)) if one is None else one for one in hidden.values()])
    each = [(list(hidden).index(id(view.visibility)), len(view.rates), view.of_edges) for view in views]
    odds = np.zeros((len(views), _LANES))
    rare = np.ones((len(views), len(table.order)))
    for row, view in enumerate(views):
        odds[row, : len(view.rates)] = view.rates / (1.0 - view.rates if view.of_edges else len(table.order))
        if view.clutter is not None:
            rare[row] = 1.0 / view.clutter[table.order]

    result = np.empty((len(views), odds.shape[1], count))

    def weigh(part: slice) -> None:
        """Weigh so few particles that all about them stays in the cache."""
        from localiser.observation import likelihood_kernel as kernel

        some = columns[:, part]
        low, per_unit, shape = _cells(some[:3])
        poses = some.T.copy()
        run, order = kernel.ordered(kernel.cells_of(poses, low, per_unit, shape), int(shape.prod()), _by_heading(some))
        half_view_rad = float(np.arctan(widest) + np.abs(some[3]).max())
        start, item = in_view_of_cells(run, low, per_unit, shape, landmarks, half_view_rad, farthest_m, reach, offset)
        result[..., part] = kernel.log_products(
            poses,
            order,
            run,
            offset,
            start,
            item,
            landmarks,
            visibility,
            odds,
            np.array(each, dtype=np.int64),
            rare,
            table.rows,
            *table.bins,
            seen,
            (sight.range_min_m**2, farthest_m**2, sight.range_max_m**2, widest),
            (GATE_SIGMAS, table.largest_var),
            (endpoints.TOLERANCE_PX / angle.camera.focal_px, table.missed),
            angle.span_rad,
            angle.kind == "slope",
        )

    size = min(max(-(-count // threads), _PER_THREAD), _PART)
    parts = [slice(begin, begin + size) for begin in range(0, count, size)]
    if min(threads, len(parts)) == 1:
        for part in parts:
            weigh(part)
    else:
        with ThreadPoolExecutor(min(threads, len(parts))) as pool:
            list(pool.map(weigh, parts))
    return [found[: len(view.rates)] for found, view in zip(result, views, strict=True)]


def _by_heading(columns: Array) -> NDArray[np.int64]:
    """Return the particles (N,) by their cameras' headings, so that the same edges are near those beside each other.

    Numbers of 16 bits are sorted several times as fast, and are fine enough: no result depends on the order.
    """
    heading = columns[2] + columns[3]
    low, extent = heading.min(), max(float(np.ptp(heading)), _SMALLEST)
    return np.argsort(((heading - low) * (65535.0 / extent)).astype(np.uint16), kind="stable")


def bins_of(angle: Array) -> EdgeBins:
    """Return where ascending angles (E,) begin in even bins: first (B,), and (lowest, bins per rad, last bin).

    Those from bin i on are angle[first[i]:]; the last bin is beyond all.
    """
    if len(angle) == 0:
        return np.zeros(1, dtype=np.int64), (0.0, 1.0, 0.0)
    step = max(float(angle[-1] - angle[0]) / (_BINS - 2), 1e-12)
    first = np.searchsorted(angle, angle[0] + step * np.arange(_BINS))
    first[-1] = len(angle)
    return first, (float(angle[0]), 1.0 / step, _BINS - 1.0)


def _cells(columns: Array) -> tuple[Array, Array, NDArray[np.int64]]:
    """Return the corner (3,) of the cells that cover poses (3, N), cells per unit (3,), and their number (3,).

    Cells are no larger than the cloud, so that fewer landmarks can be in view from them.
    """
    low, extent = columns.min(axis=1), np.ptp(columns, axis=1)
    size = _CELL
    while True:
        shape = np.floor(extent / size) + 1.0  # as floats: their product does not overflow, however far poses lie apart
        cells = shape.prod()
        is_spread = size[0] >= _LARGEST_M and cells <= _MOST_CELLS
        if is_spread or cells <= max(columns.shape[1] // _PER_CELL, 1):
            return low, 1.0 / np.minimum(size, np.maximum(extent, _SMALLEST)), shape.astype(np.int64)
        size = size * 1.25
