"""The likelihood of edges by compiled loops: the sum over particles, landmarks and edges.

Several questions about the same particles, views, are answered by one call. Four things make it fast, and none of them
changes the result by more than 1e-5. Particles are sorted into cells of floor and heading, and only the landmarks that
can be in view from a cell are looked at. An edge that no landmark comes near costs nothing. The loops run as vector
instructions (`likelihood_kernel`). No more particles are weighed at a time than the cache holds. A particle's result
depends on that particle alone, whatever number of threads share the work.
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from localiser.geometry import Array
from localiser.landmarks import LandmarkMap, in_view_of_cells, kept_with, reach_of
from localiser.observation.frame import TOLERANCE_PX, UNKNOWN, Frame
from localiser.observation.sighting import Sighting

# An edge of a landmark has its polarity with probability 0.9, and clutter has both alike. So p(polarity | landmark) / ½
# is 1 + polarity_e · MEAN_POLARITY · polarity_l, and 1 where either is unknown (0). See docs/notes/observation.md.
MEAN_POLARITY = 2 * 0.9 - 1.0
GATE_SIGMAS = 6.0  # beyond this a normal density is below 1e-8 of its peak: nothing beside clutter
_CELL = np.array([0.5, 0.5, 2 * np.pi / 32])  # m, m, rad; larger where particles are few
_PER_CELL = 32  # particles, at least, if they were spread evenly
_SMALLEST = 1e-6  # m, m, rad
_LARGEST_M = 4.0  # side of a cell of a cloud that is spread over a building
_MOST_CELLS = 1 << 18  # of such a cloud, most of them empty
_LANES, _STATEMENTS = 8, 2  # rates of a view, and which landmarks are hidden, at most: `likelihood_kernel`
_PER_THREAD = 4096  # particles, below which another thread is not worth its start
_PART = 16384  # particles weighed by one thread at a time: poses and results stay in the second cache


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


def _landmarks(landmark_map: LandmarkMap, sigma_m: float) -> Array:
    """Return the landmarks (L, 6) as the loop takes them, heights (m) and sigmas (m) as the map has them."""

    def make() -> Array:
        columns: list[Array] = [
            landmark_map.points,
            np.nan_to_num(landmark_map.bottom_m, nan=-UNKNOWN),
            np.nan_to_num(landmark_map.top_m, nan=UNKNOWN),
            landmark_map.sigma_m(sigma_m),
            np.asarray(MEAN_POLARITY * landmark_map.polarity, dtype=np.float64),
        ]
        return np.column_stack(columns)

    found: Array = kept_with(landmark_map, ("likelihood", sigma_m), make)
    return found


def by_views(
    frame: Frame,
    columns: Array,
    sighting: Sighting,
    landmark_map: LandmarkMap,
    views: Sequence[View],
    blur_rad: float = 0.0,
) -> list[Array]:
    """Return log p(edges | pose, rate_k) (K, N) of N particles in each view, relative to clutter alone.

    columns: (4, N) x, z, heading of the robot, and by how much the camera's yaw differs from the mount's.
    """
    count, threads, mount = columns.shape[1], frame.parameters.threads, frame.camera.mount
    table, (image, limits) = frame.table(landmark_map, blur_rad), frame.sight
    farthest_m, widest = frame.parameters.sight.far.range_max_m, limits[3]
    landmarks = _landmarks(landmark_map, frame.parameters.landmark_sigma_m)
    reach, offset = reach_of(landmark_map, farthest_m), (mount.right_m, mount.back_m, mount.yaw_rad)
    # What all views share: which landmarks show, by distinct statements, and tables of rates and of clutter.
    hidden = {id(view.visibility): view.visibility for view in views}
    if len(hidden) > _STATEMENTS:
        raise ValueError(f"expected at most {_STATEMENTS} statements of what is hidden, found {len(hidden)}")
    visibility = np.stack([np.ones(len(landmark_map)) if one is None else one for one in hidden.values()])
    each, odds = np.zeros((len(views), 3), dtype=np.int64), np.zeros((len(views), _LANES))
    rare = np.ones((len(views), len(table.order)))
    for row, view in enumerate(views):
        each[row] = list(hidden).index(id(view.visibility)), len(view.rates), view.of_edges
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
            (mount.height_m, sighting.map_scale),
            start,
            item,
            landmarks,
            visibility,
            odds,
            each,
            rare,
            table.rows,
            *table.bins,
            image,
            limits,
            (GATE_SIGMAS, table.largest_var),
            (TOLERANCE_PX / frame.camera.focal_px, frame.ends.missed),
            frame.span_rad,
            frame.parameters.kind == "slope",
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
