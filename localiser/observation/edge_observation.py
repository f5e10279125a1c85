"""The observation of vertical edges: log p(edges | particle) with unknown association (docs/observation.md).

The sum over particles, landmarks and edges is one of compiled loops (`likelihood_kernel`). Four things make it fast;
none of them changes the result by more than 1e-5. Particles are sorted into cells of floor and heading, and only the
landmarks that can be in view from a cell are looked at. An edge that no landmark comes near costs nothing. Loops run as
vector instructions. No more particles are weighed at a time than the cache holds.
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
from localiser.geometry import Array, Indices
from localiser.geometry.compiled import entry
from localiser.landmarks import LandmarkMap, in_view_of_cells_loop, kept_with, reach_of
from localiser.observation.association import Association
from localiser.observation.clutter import EarlierFrame, scene_clutter
from localiser.observation.frame import MISSED, TOLERANCE_PX, UNKNOWN, Frame, marked_landmarks
from localiser.observation.inlier_rate import DETECTION_RATES, INLIER_RATES, InlierRate
from localiser.observation.sighting import ObservationParameters, Sighting
from localiser.particles import CAMERA_YAW, POSE, Particles

FRAMES = 64  # that are kept: an image is asked for some twenty times, and those of the last scenes with every image
INPUTS = 40  # of loops that are kept: an image is asked for with several blurs, of a lost robot with 24 earlier ones
_CELL = (0.5, 0.5, 2 * np.pi / 32)  # m, m, rad; larger where particles are few
_PER_CELL = 32  # particles, at least, if they were spread evenly
_SMALLEST = 1e-6  # m, m, rad
_LARGEST_M = 4.0  # side of a cell of a cloud that is spread over a building
_MOST_CELLS = 1 << 18  # of such a cloud, most of them empty
_PER_THREAD = 4096  # particles, below which another thread is not worth its start
_PART = 16384  # particles weighed by one thread at a time: poses and results stay in the second cache


@dataclass(frozen=True, eq=False)
class EdgeObservation:
    """The observation of vertical edges, as `slope` or as `line`, seen by one camera.

    An image whose edges state a mount of their own is seen by the camera as it was mounted then. With
    `parameters.association` known, an edge is of the landmark that it names, or clutter; others tell nothing.
    """

    camera: Camera
    parameters: ObservationParameters

    def frame(self, edges: Edges) -> Frame:
        """Return the edges of an image as they are compared, by the camera as it was mounted then."""
        return _frame(self, edges)

    def log_likelihood(self, particles: Particles, sighting: Sighting, landmark_map: LandmarkMap) -> Array:
        """Return log p(edges | particle) (N,), relative to all edges being clutter; the inlier rate is unknown."""
        return InlierRate.unknown().log_mean(self.by_rate(particles, sighting, landmark_map))

    def by_rate(
        self, particles: Particles, sighting: Sighting, landmark_map: LandmarkMap, blur_rad: float = 0.0
    ) -> Array:
        """Return log p(edges | particle, w_k) (K, N) for every inlier rate, relative to all edges being clutter.

        blur_rad: sigma of the compared angle that is added to every edge's own.
        """
        every = np.ones((1, len(landmark_map)))
        return np.asarray(self.by_views(particles, sighting, landmark_map, every, blur_rad, is_inlier_rate=True)[0])

    def by_views(
        self,
        particles: Particles,
        sighting: Sighting,
        landmark_map: LandmarkMap,
        visibility: Array,
        blur_rad: float = 0.0,
        *,
        is_inlier_rate: bool = False,
    ) -> Array:
        """Return log p(edges | particle, p_k) (V, K, N) for every detection rate, relative to all edges being clutter.

        The edges are a Poisson process, see `likelihood_kernel.log_products`: a pose that sees no landmark explains
        them as well as clutter does, which is that of the scene. visibility: (V, L) probability that a landmark in view
        is not hidden, for each of V views. is_inlier_rate: for inlier rates; clutter is then that of the last image.
        """
        frame, count = self.frame(sighting.edges), particles.columns.shape[1]
        if not len(frame.edges.bearing):
            return np.zeros((len(visibility), len(INLIER_RATES), count))
        poses = np.zeros((count, 4))  # the last column: the yaw of the camera on its mount
        poses[:, :3] = particles.columns[:3].T
        poses[:, 3] = particles[CAMERA_YAW] if CAMERA_YAW in particles.names else 0.0
        by_angle, inputs = frame.table[1], kernel_inputs(frame, sighting.map_scale, landmark_map, blur_rad)
        odds = INLIER_RATES / (1.0 - INLIER_RATES) if is_inlier_rate else DETECTION_RATES / len(by_angle)
        clutter = sighting.persistent if is_inlier_rate else sighting.scene
        rare = np.ones(len(by_angle)) if clutter is None else 1.0 / clutter[by_angle]
        result = np.empty((len(visibility), len(odds), count))

        def weigh(part: slice) -> None:
            from localiser.observation import likelihood_kernel as kernel

            some = poses[part]
            # By heading, so that the same edges are near those beside each other. Numbers of 16 bits are sorted several
            # times as fast, and are fine enough: no result depends on the order.
            heading = some[:, 2] + some[:, 3]
            low, extent = heading.min(), max(float(np.ptp(heading)), _SMALLEST)
            by_heading = np.argsort(((heading - low) * (65535.0 / extent)).astype(np.uint16), kind="stable")
            cells = in_cells(some, by_heading, frame, landmark_map, inputs)
            result[..., part] = kernel.log_products(some, cells, visibility, odds, is_inlier_rate, rare, inputs)

        threads = self.parameters.threads
        size = min(max(-(-count // threads), _PER_THREAD), _PART)
        parts = [slice(begin, begin + size) for begin in range(0, count, size)]
        if min(threads, len(parts)) == 1:
            list(map(weigh, parts))
        else:
            with ThreadPoolExecutor(min(threads, len(parts))) as pool:
                list(pool.map(weigh, parts))
        return result

    def warm_up(self) -> None:
        """Compile what compares edges, or load it from the disk, so that no frame has to wait for it."""
        origin, landmark_map = np.zeros(3), LandmarkMap.from_points(np.array([[0.0, -3.0]]))
        sighting = Sighting(0, Edges.from_bearings([0.0], 0.01))
        self.by_rate(Particles(POSE, origin[:, None], np.zeros(1)), sighting, landmark_map)
        self.associate(origin, sighting, landmark_map)
        frame = self.frame(sighting.edges)
        scene_clutter(frame, [EarlierFrame(frame, origin, 0.0)])

    def associate(
        self, pose: Array, sighting: Sighting, landmark_map: LandmarkMap, cov: Array | None = None
    ) -> Association:
        """Return how the edges compare with the landmarks that are seen from one robot pose (3,). cov: (3, 3) of it."""
        from localiser.observation import likelihood_kernel as kernel

        frame, cov = self.frame(sighting.edges), np.zeros((3, 3)) if cov is None else cov
        inputs = kernel_inputs(frame, sighting.map_scale, landmark_map)
        *_, near = in_cells(np.append(pose, 0.0)[None], np.arange(1), frame, landmark_map, inputs)
        seen, pairs = kernel.associate(pose, cov, near, inputs)
        landmark, (pair, row) = seen[:, 0].astype(np.int64), pairs[:, :2].astype(np.int64).T
        pair_columns = pair, frame.table[1][row], *pairs[:, 2:].T
        return Association(frame, sighting, landmark_map, landmark, *seen[:, 1:].T, *pair_columns)

    def scales(self, particles: Particles, sighting: Sighting, landmark_map: LandmarkMap) -> tuple[float, float]:
        """Return two angles (rad), medians over landmarks and edges: the spread of predictions, the measured sigma.

        Both are of the angle that is compared. (0, inf) where nothing is expected or nothing is measured.
        """
        seen = particles.estimate.as_seen
        found = self.associate(seen.pose, sighting, landmark_map, seen.cov)
        variance = found.frame.measured[1]
        if not len(found.landmark) or not np.isfinite(variance).any():
            return 0.0, np.inf
        sigma = np.sqrt(np.nanmedian(variance) + np.median(found.map_var))
        return float(np.sqrt(np.median(found.pose_var))), float(sigma)


@lru_cache(FRAMES)
def _frame(observation: EdgeObservation, edges: Edges) -> Frame:
    return Frame(edges, observation.camera.at(edges.mount), observation.parameters)


@lru_cache(INPUTS)
def kernel_inputs(frame: Frame, map_scale: float, landmark_map: LandmarkMap, blur_rad: float = 0.0) -> tuple[Any, ...]:
    """Return how `likelihood_kernel` takes the camera, landmarks and edges.

    Landmarks are rows (L, 6): x, z, heights (m), sigma (m) and polarity as the map has them. Edges are rows as in
    `Frame.table`, -1 for an edge of any landmark. Before them, the camera on the robot and the map's scale; then the
    first edge of each bin, how landmarks are seen, how ends are compared, the span of clutter. blur_rad: see `by_rate`.
    """

    def table() -> Array:
        columns: list[NDArray[Any]] = [landmark_map.points, np.nan_to_num(landmark_map.bottom_m, nan=-UNKNOWN)]
        columns += [np.nan_to_num(landmark_map.top_m, nan=UNKNOWN), landmark_map.sigma_m(sigma_m)]
        return np.ascontiguousarray(np.column_stack([*columns, landmark_map.polarity]))

    mount, sigma_m = frame.camera.mount, frame.parameters.landmark_sigma_m
    rows, by_angle, (first, bins), largest_var = frame.table
    rows = rows.copy()
    rows[:, 1] += blur_rad**2
    if frame.parameters.association == "unknown":
        rows[:, -1] = marked_landmarks(frame.edges, landmark_map)[by_angle]
    offset, landmarks = (mount.right_m, mount.back_m, mount.yaw_rad), kept_with(landmark_map, ("table", sigma_m), table)
    seen_in = (*frame.sight, bins, largest_var + blur_rad**2, frame.parameters.kind == "slope")
    ends = (TOLERANCE_PX / frame.camera.focal_px, MISSED if frame.has_ends else 1.0)
    return offset, map_scale, landmarks, rows, first, seen_in, ends, frame.span_rad


def in_cells(
    poses: Array, sequence: Indices, frame: Frame, landmark_map: LandmarkMap, inputs: tuple[Any, ...]
) -> tuple[Indices, Indices, Indices, NDArray[np.int32]]:
    """Return order (N,) and run (cells + 1,) of poses (N, 4), see `in_cells_loop`, and what can be in view from cells.

    Of start (cells + 1,) and item, that are item[start[c] : start[c + 1]] of cell c. inputs: of `kernel_inputs`.
    """
    run, order, low, per_unit, shape = entry(in_cells_loop)(poses, sequence)
    half_view_rad = float(np.arctan(frame.sight[1][3]) + np.abs(poses[:, 3]).max())
    (offset, _, landmarks), farthest_m = inputs[:3], frame.parameters.sight.farthest_m
    in_view = half_view_rad, farthest_m, reach_of(landmark_map, farthest_m)
    start, item = entry(in_view_of_cells_loop)(run, low, per_unit, shape, offset, landmarks, *in_view)
    return order, run, start, item


def in_cells_loop(poses: Array, sequence: Indices) -> tuple[Indices, Indices, Array, Array, Indices]:
    """Return run (cells + 1,) and order (N,): poses (N, 3+) of cell c are order[run[c] : run[c + 1]].

    Then, of the cells, the corner (3,), how many are in a unit (3,), and how many there are (3,). They are no larger
    than the cloud, so that fewer landmarks can be in view from them. sequence: (N,) indices, whose order is kept.
    """
    low, high = poses[0, :3].copy(), poses[0, :3].copy()
    for n in range(len(poses)):
        for k in range(3):
            low[k], high[k] = min(low[k], poses[n, k]), max(high[k], poses[n, k])
    extent, size = high - low, np.array(_CELL)
    shape = np.floor(extent / size) + 1.0  # as floats: their product does not overflow, however far poses lie apart
    while shape.prod() > max(len(poses) // _PER_CELL, 1) and (size[0] < _LARGEST_M or shape.prod() > _MOST_CELLS):
        size *= 1.25
        shape = np.floor(extent / size) + 1.0
    per_unit, (rows, columns, turns) = 1.0 / np.minimum(size, np.maximum(extent, _SMALLEST)), shape.astype(np.int64)
    run, cell, order = np.zeros(rows * columns * turns + 1, np.int64), np.empty_like(sequence), np.empty_like(sequence)
    for n in range(len(poses)):
        i = min(int((poses[n, 0] - low[0]) * per_unit[0]), rows - 1)
        j = min(int((poses[n, 1] - low[1]) * per_unit[1]), columns - 1)
        k = min(int((poses[n, 2] - low[2]) * per_unit[2]), turns - 1)
        cell[n] = (i * columns + j) * turns + k
        run[cell[n] + 1] += 1
    run = run.cumsum()
    place = run.copy()
    for n in sequence:
        order[place[cell[n]]] = n
        place[cell[n]] += 1
    return run, order, low, per_unit, shape.astype(np.int64)
