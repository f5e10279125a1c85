"""The observation's sum over particles, landmarks and edges, compiled.

It computes what `observation.EdgeObservation.by_share_plain` does with arrays. Four things make it fast, none of which
changes the result by more than 1e-5: particles are sorted into cells of floor and heading, and only the landmarks that
can be in view from a cell are looked at; an edge that no landmark comes near costs nothing, since its factor 1 - w is
common to all particles; the loops run as vector instructions (`loops`); and no more particles are weighed at a time
than the cache holds. A particle's result depends on nothing but that particle, so neither on how many threads share the
work.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from localiser.geometry import Array

_CELL = np.array([0.5, 0.5, 2 * np.pi / 32])  # m, m, rad; larger where particles are few
_PER_CELL = 32  # particles, at least, if they were spread evenly
_BINS = 512  # of the compared angle
_PER_THREAD = 4096  # particles, below which another thread is not worth its start
_PART = 16384  # particles weighed by one thread at a time: poses and results stay in the second cache

EdgeBins = tuple[NDArray[np.uint64], tuple[float, float, float]]


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """What all particles share in a frame: landmarks, edges and the camera, as the loop takes them.

    landmarks: (L, 6) x, z, bottom and top above the camera (∓1e9 where unknown), all in m, variance of the position in
    m², mean polarity of its edges. edges: (E, 11) compared angle (rad, ascending, inf where unknown), its variance
    (rad²), upright image heights of the lower and upper end (∓1e9 where unknown), 1 / length, of both ends the room
    that clutter has and the peak beside it, polarity, 1 / how dense clutter is there. offset: right, back (m) and yaw
    (rad) of the camera on the robot.
    view: (7,) sine and cosine of the tilt; a_left, a_right, e_low, e_high of the image with its margin; the shortest
    length that counts. range_m: nearest, farthest. widest: bound on |tan(bearing)|. gate: reach beyond the landmark's
    own sigma: how many sigmas, and the largest variance of an edge. ends: how far an edge may stick out, 1 / sigma of
    its ends, p(missed). span: of the compared angle (rad). is_slope: whether that is the lean.
    """

    landmarks: Array
    edges: Array
    offset: tuple[float, float, float]
    view: tuple[float, ...]
    range_m: tuple[float, float]
    widest: float
    gate: tuple[float, float]
    ends: tuple[float, float, float]
    span: float
    is_slope: bool


def by_share(scene: Scene, columns: Array, shares: Array, threads: int = 1) -> Array:
    """Return log p(edges | pose, w_k) (K, N) of N particles for every share, relative to all edges being clutter.

    columns: (4, N) x, z, heading of the robot, and by how much the camera's yaw differs from the mount's. shares: (K,)
    ascending, at most 8 of them.
    """
    count = columns.shape[1]
    result = np.empty((len(shares), count))
    base, bins = len(scene.edges) * np.log1p(-shares), bins_of(scene.edges[:, 0][np.isfinite(scene.edges[:, 0])])

    def weigh(part: slice) -> None:
        result[:, part] = _weighed(scene, columns[:, part], shares, base, bins)

    size = min(max(-(-count // threads), _PER_THREAD), _PART)
    parts = [slice(begin, begin + size) for begin in range(0, count, size)]
    if min(threads, len(parts)) == 1:
        for part in parts:
            weigh(part)
    else:
        with ThreadPoolExecutor(min(threads, len(parts))) as pool:
            list(pool.map(weigh, parts))
    return result


def _weighed(scene: Scene, columns: Array, shares: Array, base: Array, edge_bins: EdgeBins) -> Array:
    """Return `by_share` of so few particles that all about them stays in the cache. base: (K,) to be added."""
    from localiser.observation import likelihood_kernel as loops

    low, per_unit, shape = _cells(columns[:3])
    poses = columns.T.copy()
    run, order = loops.ordered(loops.cells_of(poses, low, per_unit, shape), int(shape.prod()))
    half_view_rad = float(np.arctan(scene.widest) + np.abs(columns[3]).max())
    start, item = loops.candidates(
        run, low, per_unit, shape, scene.offset, scene.landmarks, half_view_rad, scene.range_m[1]
    )
    return loops.log_products(
        poses,
        order,
        run,
        scene.offset,
        start,
        item,
        scene.landmarks,
        (*(shares / (1.0 - shares)).tolist(), *[0.0] * (loops.LANES - len(shares))),
        scene.edges,
        *edge_bins,
        scene.view,
        (scene.range_m[0] ** 2, scene.range_m[1] ** 2, scene.widest),
        scene.gate,
        scene.ends,
        scene.span,
        scene.is_slope,
        base,
    )


def bins_of(angle: Array) -> EdgeBins:
    """Return where ascending angles (E,) begin in even bins: first (B,), and (lowest, bins per rad, last bin).

    Those from bin i on are angle[first[i]:]; the last bin is beyond all.
    """
    if len(angle) == 0:
        return np.zeros(1, dtype=np.uint64), (0.0, 1.0, 0.0)
    step = max(float(angle[-1] - angle[0]) / (_BINS - 2), 1e-12)
    first = np.searchsorted(angle, angle[0] + step * np.arange(_BINS)).astype(np.uint64)
    first[-1] = len(angle)
    return first, (float(angle[0]), 1.0 / step, _BINS - 1.0)


def _cells(columns: Array) -> tuple[Array, Array, NDArray[np.int64]]:
    """Return the corner (3,) of the cells that cover poses (3, N), cells per unit (3,), and their number (3,)."""
    low, extent = columns.min(axis=1), np.ptp(columns, axis=1)
    size = _CELL
    while True:
        shape = (extent / size).astype(np.int64) + 1
        if shape.prod() <= max(columns.shape[1] // _PER_CELL, 1):
            return low, 1.0 / size, shape
        size = size * 1.25
