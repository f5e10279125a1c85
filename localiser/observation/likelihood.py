"""The likelihood of edges by compiled loops: the sum over particles, landmarks and edges.

It computes what `EdgeObservation.by_rate_plain` does with arrays. Four things make it fast, and none of them changes
the result by more than 1e-5. Particles are sorted into cells of floor and heading, and only the landmarks that can be
in view from a cell are looked at. An edge that no landmark comes near costs nothing. The loops run as vector
instructions (`likelihood_kernel`). No more particles are weighed at a time than the cache holds. A particle's result
depends on that particle alone, whatever number of threads share the work.
"""

from __future__ import annotations

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
    Reach,
    SightParameters,
    in_view_of_cells,
    kept_with,
    reach_of,
    sigmas_m,
    widest_tangent,
)
from localiser.observation import endpoint_likelihood as endpoints
from localiser.observation import polarity
from localiser.observation.angle import Angle
from localiser.observation.parameters import ObservationParameters
from localiser.observation.protocols import Sighting

GATE_SIGMAS = 6.0  # beyond this a normal density is below 1e-8 of its peak: nothing beside clutter
_UNKNOWN_M = 1e9  # beyond every height
_CELL = np.array([0.5, 0.5, 2 * np.pi / 32])  # m, m, rad; larger where particles are few
_PER_CELL = 32  # particles, at least, if they were spread evenly
_SMALLEST = 1e-6  # m, m, rad
_LARGEST_M = 4.0  # side of a cell of a cloud that is spread over a building
_MOST_CELLS = 1 << 18  # of such a cloud, most of them empty
_BINS = 512  # of the compared angle
_PER_THREAD = 4096  # particles, below which another thread is not worth its start
_PART = 16384  # particles weighed by one thread at a time: poses and results stay in the second cache

EdgeBins = tuple[NDArray[np.int64], tuple[float, float, float]]


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """What all particles share in a frame: landmarks, edges and the camera, as the loop takes them.

    landmarks: (L, 6) x, z, bottom and top above the camera (∓1e9 where unknown), all in m, variance of the position in
    m², mean polarity of its edges. visibility: (V, L) probability that nothing hides it, in each view. edges: (E, 13)
    compared angle (rad, ascending, inf where unknown), its variance (rad²), upright image heights of the lower and
    upper end (∓1e9 where unknown), 1 / length, of both ends the room that clutter has, the peak beside it and
    1 / sigma, polarity, 1 / how dense clutter is there. bins: of their angles, see `bins_of`.
    offset: right, back (m) and yaw (rad) of the camera on the robot.
    view: (7,) sine and cosine of the tilt; a_left, a_right, e_low, e_high of the image with its margin; the shortest
    length that counts. range_m: nearest, farthest, and from where on walls hide. widest: bound on |tan(bearing)|. gate:
    reach beyond the landmark's own sigma: how many sigmas, and the largest variance of an edge. ends: how far an edge
    may stick out, p(missed). span: of the compared angle (rad). is_slope: whether that is the lean. reach: which
    landmarks are in range from where.
    """

    landmarks: Array
    visibility: Array
    reach: Reach
    edges: Array
    bins: EdgeBins
    offset: tuple[float, float, float]
    view: tuple[float, ...]
    range_m: tuple[float, float, float]
    widest: float
    gate: tuple[float, float]
    ends: tuple[float, float]
    span: float
    is_slope: bool


def scene_of(
    angle: Angle,
    parameters: ObservationParameters,
    sighting: Sighting,
    landmark_map: LandmarkMap,
    blur_rad: float,
    visibility: Array,
) -> Scene:
    """Return what all particles share, for the edges of one image.

    blur_rad: sigma that is added to every edge's. visibility: (V, L) probability that a landmark in view is not hidden,
    in each of V views of it, at most `likelihood_kernel.VIEWS`.
    """
    camera, sight = angle.camera, parameters.sight
    mount, farthest_m = camera.mount, sight.far.range_max_m
    table, bins, largest_var, missed = _edges(angle, sighting.edges, blur_rad)
    view, widest = _view(camera, sight)
    return Scene(
        landmarks=_landmarks(landmark_map, mount.height_m, parameters.landmark_sigma_m, sighting.map_scale),
        visibility=visibility,
        reach=reach_of(landmark_map, farthest_m),
        edges=table,
        bins=bins,
        offset=(mount.right_m, mount.back_m, mount.yaw_rad),
        view=view,
        ends=(endpoints.TOLERANCE_PX / camera.focal_px, missed),
        range_m=(sight.range_min_m, farthest_m, sight.range_max_m),
        widest=widest,
        gate=(GATE_SIGMAS, largest_var),
        span=angle.span_rad,
        is_slope=angle.kind == "slope",
    )


@lru_cache(maxsize=64)  # the same edges are weighed several times in a frame, and when places are proposed later
def _edges(angle: Angle, edges: Edges, blur_rad: float) -> tuple[Array, EdgeBins, float, float]:
    """Return the edges of a scene (E, 13), their bins, the largest variance of those known, and p(missed)."""
    measured, variance = angle.measured(edges)
    # Edges of which this observation knows nothing go to the end: no landmark comes near them.
    known = np.isfinite(measured) & np.isfinite(variance)
    measured, variance = np.where(known, measured, np.inf), np.where(known, variance + blur_rad**2, 1.0)
    ends = endpoints.endpoints_of(edges, angle.camera)
    columns: list[NDArray[Any]] = [measured, variance, ends.e, ends.per_length, ends.room, ends.peak]
    columns += [1.0 / ends.sigma, edges.polarity, 1.0 / edges.clutter]
    table = np.column_stack(columns)[np.argsort(measured, kind="stable")]
    return table, bins_of(table[: known.sum(), 0]), float(variance[known].max(initial=0.0)), ends.missed


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
            polarity.mean_polarity(landmark_map.polarity),
        ]
        return np.column_stack(columns)

    kept: dict[tuple[float, float], Array] = kept_with(landmark_map, ("scene", sigma_m), dict)
    if (height_m, scale) not in kept:
        kept.clear()
        kept[height_m, scale] = make()
    return kept[height_m, scale]


def by_rate(scene: Scene, columns: Array, rates: Array, threads: int = 1, *, of_edges: bool = True) -> Array:
    """Return log p(edges | pose, rate_k) (V, K, N) of N particles in each view, relative to clutter alone.

    columns: (4, N) x, z, heading of the robot, and by how much the camera's yaw differs from the mount's. rates: (K,)
    ascending, at most 8 of them.
    """
    count = columns.shape[1]
    result = np.empty((len(scene.visibility), len(rates), count))

    def weigh(part: slice) -> None:
        result[..., part] = _weighed(scene, columns[:, part], rates, of_edges)

    size = min(max(-(-count // threads), _PER_THREAD), _PART)
    parts = [slice(begin, begin + size) for begin in range(0, count, size)]
    if min(threads, len(parts)) == 1:
        for part in parts:
            weigh(part)
    else:
        with ThreadPoolExecutor(min(threads, len(parts))) as pool:
            list(pool.map(weigh, parts))
    return result


def _weighed(scene: Scene, columns: Array, rates: Array, of_edges: bool) -> Array:
    """Return `by_rate` of so few particles that all about them stays in the cache."""
    from localiser.observation import likelihood_kernel as kernel

    low, per_unit, shape = _cells(columns[:3])
    odds = rates / (1.0 - rates) if of_edges else rates / len(scene.edges)
    poses = columns.T.copy()
    cell, sequence = kernel.cells_of(poses, low, per_unit, shape), _by_heading(columns)
    run, order = kernel.ordered(cell, int(shape.prod()), sequence)
    nearest_m, farthest_m, open_m = scene.range_m
    half_view_rad = float(np.arctan(scene.widest) + np.abs(columns[3]).max())
    start, item = in_view_of_cells(
        run, low, per_unit, shape, scene.landmarks, half_view_rad, farthest_m, scene.reach, scene.offset
    )
    found = kernel.log_products(
        poses,
        order,
        run,
        scene.offset,
        start,
        item,
        scene.landmarks,
        scene.visibility,
        (*odds.tolist(), *[0.0] * (kernel.LANES - len(rates))),
        len(rates),
        of_edges,
        scene.edges,
        *scene.bins,
        scene.view,
        (nearest_m**2, farthest_m**2, open_m**2, scene.widest),
        scene.gate,
        scene.ends,
        scene.span,
        scene.is_slope,
    )
    return found.reshape(-1, len(rates), columns.shape[1])


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
