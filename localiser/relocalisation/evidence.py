"""A quick score of many poses: a table over the image that says which edge explains a landmark expected there.

A pose from which n landmarks are in view explains the edges by the mixture of `observation`,

    score = Σ_i log(1 - w + w a_i / n),   a_i = Σ_l span · N(b_i; b_l, σ) h_i(e_l)

at an inlier rate w of ½. h_i compares the upright height e_l of the landmark's foot with where edge i ends. Each
landmark counts for the one edge i that it fits best. That edge and the term are tabulated once a frame over
tan(bearing) and e, so a landmark costs one look-up whatever the number of edges. σ is widened to how far off the poses
may be.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from localiser.geometry import Array
from localiser.landmarks import field_of_view_rad, half_view_rad
from localiser.observation import MISSED
from localiser.relocalisation.places import Places
from localiser.relocalisation.views import View

COLUMNS, ROWS = 512, 48
GATE_SIGMAS = 5.0
BELOW = 0.05  # density, beside an even one, of edges that go on below the foot


@dataclass(frozen=True, slots=True, eq=False)
class Evidence:
    """The tables of one view, (ROWS + 2, COLUMNS): the edge that fits best, -1 for none, and how well, `fit`.

    Columns are even in tan(bearing), rows in e from the lower to the upper border; the first row is for feet below the
    image, the last for feet above it.
    """

    view: View
    edge: NDArray[np.int64]
    fit: Array
    tangent_low: float
    tangent_step: float
    e_low: float
    e_step: float

    def look_up(self, tangent: Array, e: Array) -> tuple[NDArray[np.int64], Array]:
        """Return the edge (P,), -1 for none, and its fit (P,), of feet at tan(bearing) and upright heights (P,)."""
        rows, columns = self.edge.shape
        column = np.floor((tangent - self.tangent_low) / self.tangent_step)
        row = np.clip(np.floor((e - self.e_low) / self.e_step) + 1, 0, rows - 1).astype(np.int64)
        inside = (column >= 0) & (column < columns)
        column = np.where(inside, column, 0).astype(np.int64)
        return np.where(inside, self.edge[row, column], -1), self.fit[row, column]


def evidence_of(view: View, blur_rad: float) -> Evidence:
    """Return the tables of a view, for poses that are off by about blur_rad in bearings and in feet's heights."""
    _, _, e_low, e_high = view.camera.upright_bounds
    widest = np.tan(half_view_rad(view.camera))
    left, tangent_step, e_step = -widest, 2 * widest / COLUMNS, (e_high - e_low) / ROWS
    tangent = left + (np.arange(COLUMNS) + 0.5) * tangent_step
    rows = np.concatenate([[-np.inf], e_low + (np.arange(ROWS) + 0.5) * e_step, [np.inf]])
    sigma = np.hypot(view.bearing_sigma, blur_rad)
    across = (np.arctan(tangent) - view.bearing[:, None]) / sigma[:, None]
    density = np.where(np.abs(across) < GATE_SIGMAS, np.exp(-0.5 * np.minimum(across**2, GATE_SIGMAS**2)), 0.0)
    density *= field_of_view_rad(view.camera) / (np.sqrt(2 * np.pi) * sigma[:, None])
    ends = _ends_match(view, rows, float(np.hypot(view.foot_sigma, blur_rad)), e_high - e_low)
    edge, fit = _likeliest(density, ends)
    return Evidence(view, edge, fit, left, tangent_step, e_low, e_step)


def _ends_match(view: View, rows: Array, sigma: float, height: float) -> Array:
    """Return h (E, rows): the density of each edge's lower end, over an even one, if the landmark's foot is there."""
    foot = view.foot[:, None]
    with np.errstate(invalid="ignore"):
        at_foot = np.exp(-0.5 * ((rows - foot) / sigma) ** 2) / (np.sqrt(2 * np.pi) * sigma) * height
        match = (1.0 - MISSED) * at_foot + np.where(rows < foot + sigma, MISSED, BELOW)
    # The border cuts the edge: its landmark's foot is below.
    below = np.where(np.isneginf(rows), 1.0, np.where(rows < foot + 2 * sigma, 0.5, BELOW))
    match = np.where(view.cut[:, None], below, match)
    match = np.where(np.isfinite(foot), match, 1.0)
    return np.where(np.isposinf(rows), 0.0, match)


def _likeliest(density: Array, ends: Array) -> tuple[NDArray[np.int64], Array]:
    """Return which edge explains each cell best (rows, COLUMNS), -1 where all are out of reach, and how well."""
    best = np.zeros((ends.shape[1], density.shape[1]))
    edge = np.full(best.shape, -1)
    for index, near in enumerate(density > 0):
        columns = np.flatnonzero(near)
        if len(columns):
            part = slice(columns[0], columns[-1] + 1)
            own = ends[index][:, None] * density[index, part]
            better = own > best[:, part]
            best[:, part][better] = own[better]
            edge[:, part][better] = index
    return edge, best


def score_poses(evidence: Evidence, places: Places, robot_poses: Array) -> Array:
    """Return the score (N,) of robot poses (N, 3), at an inlier rate of ½."""
    from localiser.relocalisation import evidence_kernel as kernel

    return np.asarray(kernel.score(*arguments(evidence, places, robot_poses)))


def warm_up(view: View, places: Places) -> None:
    """Compile the score, or load it from the cache, so that the first frame need not wait for it."""
    score_poses(evidence_of(view, 0.01), places, np.zeros((1, 3)))


def arguments(evidence: Evidence, places: Places, robot_poses: Array) -> tuple[Any, ...]:
    """Return what `evidence_kernel.score` takes."""
    mount, index = evidence.view.camera.mount, places.index
    return (
        np.ascontiguousarray(evidence.view.camera.pose_in_map(robot_poses)),
        places.from_camera,
        np.array([np.sin(mount.tilt_rad), np.cos(mount.tilt_rad), places.sight.range_min_m, places.sight.range_max_m]),
        np.array([*index.corner, index.cell_m]),
        index.shape,
        index.start,
        index.item,
        evidence.edge.astype(np.int16),  # small tables stay in the processor's cache
        evidence.fit.astype(np.float32),
        len(evidence.view),
        np.array([evidence.tangent_low, evidence.tangent_step, evidence.e_low, evidence.e_step]),
    )
