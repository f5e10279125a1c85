"""The frame: the edges of one image as they are compared with landmarks and with other edges, worked out once.

Edges are compared by an angle and by their ends (docs/observation.md). `line` compares bearings; `slope` leans,
as the founding paper does, whose tangent is that of the bearing times the sine of the tilt [Taylor06, eq. 7].
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from localiser import geometry
from localiser.camera import Camera
from localiser.edges import Edges
from localiser.geometry import Array, Indices
from localiser.landmarks import LandmarkMap, kept_with, widest_tangent
from localiser.markers import code_of
from localiser.observation.sighting import ObservationParameters

EdgeBins = tuple[Indices, tuple[float, float, float]]

SIGMA_PX = 3.0  # where an edge ends in the image: 2 px of finding it, 2 px of the mount's tilt and roll
TOLERANCE_PX = 6.0  # how far an edge may stick out
MISSED = 0.5  # how often an edge ends before its landmark does: hidden, faint or cut in two
ROW_PX = 10.0  # how far from each other the ends of clutter that stands in a row are
UNKNOWN = 1e9  # beyond every height
# An edge of a landmark has its polarity with probability 0.9, and clutter has both alike. So p(polarity | landmark) / ½
# is 1 + MEAN_POLARITY · polarity_e · polarity_l, and 1 where either is unknown (0). See docs/notes/observation.md.
MEAN_POLARITY = 2 * 0.9 - 1.0
_BINS = 512  # of the compared angle


@dataclass(frozen=True, slots=True, eq=False)
class Endpoints:
    """Where the edges of a frame end, lower and upper end each: (E, 2) in the order of the columns.

    e: upright heights in the image. sigma: of an end that is its landmark's, in e. per_length: (E,) 1 / length in e,
    1e9 where unknown. room: the height over which clutter ends, were it everywhere as dense as here. peak: what an edge
    that reaches where its landmark ends has there beside clutter.
    """

    e: Array
    sigma: Array
    per_length: Array
    room: Array
    peak: Array

    @property
    def cut(self) -> NDArray[np.bool_]:
        """Whether (E, 2) the image's border ends an edge there."""
        return self.room >= UNKNOWN


@dataclass(frozen=True, eq=False)
class Frame:
    """The edges (E) of one image, and the camera as it was mounted then. All angles in rad."""

    edges: Edges
    camera: Camera
    parameters: ObservationParameters = field(default_factory=ObservationParameters)

    # -- the compared angle -------------------------------------------------------------------------------------------

    @cached_property
    def measured(self) -> tuple[Array, Array]:
        """The measured angle (E,) and its variance (E,), the mount's common error included.

        The common error is shared by all edges of a frame; here it widens each of them: safe while it is small.
        """
        edges, common = self.edges, self.edges.common
        by_mount = common.bearing_from_line if self.parameters.kind == "line" else common.bearing_from_lean
        mount_var = np.einsum("ek,kl,el->e", by_mount, common.cov, by_mount)
        if self.parameters.kind == "line":
            return edges.bearing, edges.bearing_sigma**2 + mount_var
        per_bearing = 1.0 / geometry.bearing_per_lean(self.bearings[0], self.camera.mount.tilt_rad)
        return edges.lean, edges.lean_sigma**2 + mount_var * per_bearing**2

    @cached_property
    def is_known(self) -> NDArray[np.bool_]:
        """Whether (E,) the angle of an edge was measured: an observation of bearings knows nothing of a lean."""
        return np.asarray(np.isfinite(self.measured).all(axis=0))

    @cached_property
    def bearings(self) -> tuple[Array, Array]:
        """The bearing (E,) that the compared angle tells, and its sigma (E,); what is common does not move."""
        edges, tilt_rad = self.edges, self.camera.mount.tilt_rad
        if self.parameters.kind == "line":
            return edges.bearing, edges.bearing_sigma
        bearing = geometry.bearing_from_lean(edges.lean, tilt_rad)
        return bearing, edges.lean_sigma * np.abs(geometry.bearing_per_lean(bearing, tilt_rad))

    def predicted(self, tangent: Array) -> tuple[Array, Array]:
        """Return the angle that is compared (P,) for tan(bearing) (P,), and its derivative by the bearing."""
        if self.parameters.kind == "line":
            return np.arctan(tangent), np.ones_like(tangent)
        s = np.sin(self.camera.mount.tilt_rad)
        return np.arctan(s * tangent), s * (1 + tangent**2) / (1 + (s * tangent) ** 2)

    @cached_property
    def span_rad(self) -> float:
        """The angle that clutter is spread over."""
        predicted, _ = self.predicted(np.array(self.camera.upright_bounds[:2]) / np.cos(self.camera.mount.tilt_rad))
        return float(abs(predicted[1] - predicted[0]))

    # -- ends ---------------------------------------------------------------------------------------------------------

    @cached_property
    def has_ends(self) -> bool:
        """Whether it is known where the edges end."""
        return bool(np.isfinite(self.edges.ends_px).all())

    @cached_property
    def end_heights(self) -> tuple[Array, NDArray[np.bool_]]:
        """Upright image heights (E, 2) of the ends, the lower first, and whether they lie at the border."""
        ends_px = self.edges.ends_px
        e, cut = self.camera.upright_from_pixels(ends_px)[..., 1], at_border(ends_px, self.camera)
        turned = e[:, :1] > e[:, 1:]
        return np.where(turned, e[:, ::-1], e), np.where(turned, cut[:, ::-1], cut)

    @cached_property
    def ends(self) -> Endpoints:
        """Where the edges end, and how densely clutter does there: (1 / height + Σ_j N(e; e_j, row²)) / E."""
        count, camera, known_sigma = len(self.edges.bearing), self.camera, SIGMA_PX / self.camera.focal_px
        if not self.has_ends:  # measured by something that tells no ends
            e, unknown = np.tile([-UNKNOWN, UNKNOWN], (count, 1)), np.full((count, 2), UNKNOWN)
            return Endpoints(e, np.full((count, 2), known_sigma), unknown[:, 0], unknown, np.zeros((count, 2)))
        e, cut = self.end_heights
        _, _, e_low, e_high = camera.upright_bounds
        row = ROW_PX / camera.focal_px
        near = np.exp(-0.5 * ((e.T[:, :, None] - e.T[:, None]) / row) ** 2).sum(axis=1).T - 1.0
        room = count / (1.0 / (e_high - e_low) + near / (np.sqrt(2 * np.pi) * row))
        sigma = known_sigma * np.hypot(1.0, self.edges.height_sigma_m * end_per_height(e, camera) / known_sigma)
        peak = (1.0 - MISSED) * room / (np.sqrt(2 * np.pi) * sigma)
        per_length = 1.0 / np.maximum(e[:, 1] - e[:, 0], 1e-12)
        # The border ends an edge wherever its landmark does.
        return Endpoints(e, sigma, per_length, np.where(cut, UNKNOWN, room), np.where(cut, 0.0, peak))

    # -- as loops take them -------------------------------------------------------------------------------------------

    @cached_property
    def table(self) -> tuple[Array, Indices, EdgeBins, float]:
        """The edges by their compared angle, as the loop over landmarks takes them.

        Rows (E, 13): compared angle (rad, ascending, inf where unknown), its variance (rad²), upright image heights of
        the lower and upper end (∓1e9 where unknown), 1 / length, of both ends the room that clutter has, the peak
        beside it and 1 / sigma, mean polarity, landmark that it is said to show, -1 for any. Then which edge a row is
        (E,), bins of the angles, see `bins_of`, and the largest known variance.
        """
        edges, ends, identified = self.edges, self.ends, self.parameters.association == "known"
        known = self.is_known & (edges.landmark_id >= 0) if identified else self.is_known
        # Edges of which this observation knows nothing go to the end: no landmark comes near them.
        measured, variance = np.where(known, self.measured, [[np.inf], [1.0]])
        columns: list[NDArray[Any]] = [measured, variance, ends.e, ends.per_length, ends.room, ends.peak]
        columns += [1.0 / ends.sigma, MEAN_POLARITY * edges.polarity, edges.landmark_id.astype(np.float64)]
        order = np.argsort(measured, kind="stable")[: known.sum() if identified else None]
        rows = np.column_stack(columns)[order]
        return rows, order, bins_of(rows[: known.sum(), 0]), float(variance[known].max(initial=0.0))

    @cached_property
    def sight(self) -> tuple[tuple[float, ...], tuple[float, float, float, float]]:
        """The image that landmarks are seen in, with the camera's height, and how far away they may be."""
        sight, camera = self.parameters.sight, self.camera
        margin = sight.margin_px / camera.focal_px * np.array([-1.0, 1.0, -1.0, 1.0])
        bounds: list[float] = (np.array(camera.upright_bounds) + margin).tolist()
        tilt_rad, shortest = camera.mount.tilt_rad, max(sight.length_min_px, 1e-9) / camera.focal_px
        image = (float(np.sin(tilt_rad)), float(np.cos(tilt_rad)), *bounds, shortest, camera.mount.height_m)
        return image, (sight.range_min_m**2, sight.farthest_m**2, sight.range_max_m**2, widest_tangent(camera, sight))

    @cached_property
    def clutter(self) -> Array:
        """The edges (E, 14) as the loop of `clutter` takes them.

        Bearing, its variance, cosine and sine, and the angle at which a density per rad of bearing is that of evenly
        spread clutter, which is denser where the compared angle changes faster; of both ends the upright height, its
        slope, the room that clutter has, whether the border made it; and 1 / length.
        """
        (bearing, sigma), ends, tilt_rad = self.bearings, self.ends, self.camera.mount.tilt_rad
        s, c = np.sin(tilt_rad), np.cos(tilt_rad)
        span = self.span_rad / self.predicted(np.tan(bearing))[1]
        columns: list[NDArray[Any]] = [bearing, sigma**2, np.cos(bearing), np.sin(bearing), span]
        columns += [ends.e, (ends.e * c - s) / (c + ends.e * s), ends.room, ends.cut, ends.per_length]
        return np.column_stack(columns)


def bins_of(angle: Array) -> EdgeBins:
    """Return where ascending angles (E,) begin in even bins: first (B,), and (lowest, bins per rad, last bin).

    Those from bin i on are angle[first[i]:]; the last bin is beyond all.
    """
    if len(angle) == 0:
        return np.zeros(1, dtype=np.int64), (0.0, 1.0, 0.0)
    step = max(float(angle[-1] - angle[0]) / (_BINS - 2), 1e-12)
    bin_of_angle = ((angle - angle[0]) * (1.0 / step)).astype(np.int64)  # by the sum that is done with those looked for
    first = np.searchsorted(bin_of_angle, np.arange(_BINS))
    return first, (float(angle[0]), 1.0 / step, _BINS - 1.0)


def marked_landmarks(edges: Edges, landmark_map: LandmarkMap) -> Indices:
    """Return the landmark (E,) that each edge is by the marker whose side it is; -1 for others.

    A side that the map has twice tells none of them. Raises InputError where the map names a side that is none.
    """

    def of_sides() -> dict[int, int]:
        codes = [(k, code_of(one["identity"])[0]) for k, one in enumerate(landmark_map.extra) if "identity" in one]
        count = Counter(code for _, code in codes)
        return {code: k for k, code in codes if count[code] == 1}

    if not (edges.landmark_id < -1).any():
        return np.full(len(edges.landmark_id), -1)
    landmark_of = kept_with(landmark_map, ("markers",), of_sides)
    return np.array([landmark_of.get(code, -1) for code in edges.landmark_id.tolist()], dtype=np.int64)


def end_per_height(e: Array, camera: Camera) -> Array:
    """Return by how much ends e (E, 2), the lower first, move for each metre of the camera's height, unsigned, 1/m.

    They are at the distance d ahead where the lower one is on the floor; an end at e then moves by (c + e s)² / d.
    """
    s, c = np.sin(camera.mount.tilt_rad), np.cos(camera.mount.tilt_rad)
    per_ahead = np.maximum(s - e[:, :1] * c, 0.0) / (camera.mount.height_m * (c + e[:, :1] * s))
    return np.asarray((c + e * s) ** 2 * per_ahead)


def at_border(ends_px: Array, camera: Camera) -> NDArray[np.bool_]:
    """Return whether ends (E, 2, 2) lie at the image's border (E, 2)."""
    from_border = np.minimum(ends_px, np.array([camera.width, camera.height]) - 1 - ends_px)
    return np.asarray(from_border.min(axis=-1) < TOLERANCE_PX)
