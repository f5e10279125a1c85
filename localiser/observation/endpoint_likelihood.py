"""The endpoint likelihood: how well the ends of an edge agree with the ends of its landmark.

c_el is the squared part of the edge that lies between the landmark's ends, times for each end

    m min(R_e / v_l, 1) + (1 - m) R_e N(e; e_l(pose), σ²)

An edge either reaches where its landmark ends, or ends anywhere on the v_l that the image shows of it (m), while the
density of clutter's ends is 1 / R_e there. An end of a landmark beyond the image's border cannot be reached (min(R_e /
v_l, 1) is left). One that the map does not know tells nothing, and an edge that the border ends is not short.

Clutter often stands side by side: bricks, books, bars of a railing. Where other edges end, one more end is likely. So
1 / R_e is the density of a Dirichlet process with concentration 1 whose other draws are the ends of the other edges:
R_e is large where an end stands alone and small where other edges of the image end.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from localiser.camera import Camera
from localiser.edges import Edges
from localiser.geometry import Array

SIGMA_PX = 3.0  # where an edge ends in the image: 2 px of finding it, 2 px of the mount's tilt and roll
TOLERANCE_PX = 6.0  # how far an edge may stick out
MISSED = 0.5  # how often an edge ends before its landmark does: hidden, faint or cut in two
ROW_PX = 10.0  # how far from each other the ends of such clutter are
_UNKNOWN = 1e9  # beyond every height


@dataclass(frozen=True, slots=True, eq=False)
class Endpoints:
    """Where the edges of a frame end, lower and upper end each: (E, 2) in the order of the columns.

    e: upright heights in the image. sigma: of an end that is its landmark's, in e. per_length: (E,) 1 / length in e,
    1e9 where unknown. room: the height over which clutter ends, were it everywhere as dense as here. peak: what an edge
    that reaches where its landmark ends has there beside clutter. missed: how often an edge ends before its landmark
    does; 1 where nothing is known of ends.
    """

    e: Array
    sigma: Array
    per_length: Array
    room: Array
    peak: Array
    missed: float

    @property
    def cut(self) -> NDArray[np.bool_]:
        """Whether (E, 2) the image's border ends an edge there."""
        return self.room >= _UNKNOWN


@lru_cache(maxsize=16)  # the same ends are asked for several times in a frame
def endpoints_of(edges: Edges, camera: Camera) -> Endpoints:
    """Return where the edges end, and how densely clutter does there: (1 / height + Σ_j N(e; e_j, row²)) / E."""
    ends_px = edges.ends_px
    count = len(ends_px)
    known_sigma = SIGMA_PX / camera.focal_px
    if not np.isfinite(ends_px).all():  # measured by something that tells no ends
        e = np.tile([-_UNKNOWN, _UNKNOWN], (count, 1))
        sigma, room, peak = np.full((count, 2), known_sigma), np.full((count, 2), _UNKNOWN), np.zeros((count, 2))
        return Endpoints(e, sigma, np.full(count, _UNKNOWN), room, peak, 1.0)
    e, cut = ends_lower_first(ends_px, camera)
    _, _, e_low, e_high = camera.upright_bounds
    row = ROW_PX / camera.focal_px
    near = np.exp(-0.5 * ((e[:, None] - e[None]) / row) ** 2).sum(axis=1) - 1.0
    room = count / (1.0 / (e_high - e_low) + near / (np.sqrt(2 * np.pi) * row))
    sigma = known_sigma * np.hypot(1.0, edges.height_sigma_m * end_per_height(e, camera) / known_sigma)
    peak = (1.0 - MISSED) * room / (np.sqrt(2 * np.pi) * sigma)
    per_length = 1.0 / np.maximum(e[:, 1] - e[:, 0], 1e-12)
    # The border ends an edge wherever its landmark does.
    return Endpoints(e, sigma, per_length, np.where(cut, _UNKNOWN, room), np.where(cut, 0.0, peak), MISSED)


def end_per_height(e: Array, camera: Camera) -> Array:
    """Return by how much ends e (E, 2), the lower first, move for each metre of the camera's height, unsigned, 1/m.

    They are at the distance d ahead where the lower one is on the floor; an end at e then moves by (c + e s)² / d.
    """
    s, c = np.sin(camera.mount.tilt_rad), np.cos(camera.mount.tilt_rad)
    per_ahead = np.maximum(s - e[:, :1] * c, 0.0) / (camera.mount.height_m * (c + e[:, :1] * s))
    return np.asarray((c + e * s) ** 2 * per_ahead)


def ends_lower_first(ends_px: Array, camera: Camera) -> tuple[Array, NDArray[np.bool_]]:
    """Return upright image heights (E, 2) of ends (E, 2, 2), the lower first, and whether they lie at the border."""
    e, cut = camera.upright_from_pixels(ends_px)[..., 1], at_border(ends_px, camera)
    turned = e[:, :1] > e[:, 1:]
    return np.where(turned, e[:, ::-1], e), np.where(turned, cut[:, ::-1], cut)


def at_border(ends_px: Array, camera: Camera) -> NDArray[np.bool_]:
    """Return whether ends (E, 2, 2) lie at the image's border (E, 2)."""
    from_border = np.minimum(ends_px, np.array([camera.width, camera.height]) - 1 - ends_px)
    return np.asarray(from_border.min(axis=-1) < TOLERANCE_PX)


def agreement(
    ends: Endpoints, edge: NDArray[np.int64], expected: Array, known: NDArray[np.bool_], camera: Camera, margin: float
) -> Array:
    """Return c_el (P,) of pairs of an edge and a landmark: the equation of `observation`; 1 tells nothing.

    edge: (P,) indices. expected: (P, 2) upright heights of the landmark's lower and upper end, known: (P, 2) whether
    the map knows them; infinite where it does not, and where they lie beyond the image plane.
    margin: how far beyond the image's border, in upright heights, a landmark still counts as seen.
    """
    per_px = 1.0 / camera.focal_px
    border = np.array(camera.upright_bounds[2:]) + margin * np.array([-1.0, 1.0])
    cut = np.clip(expected, *border)
    per_visible = 1.0 / np.maximum(cut[:, 1] - cut[:, 0], 1e-12)
    in_image = (expected > border[0]) & (expected < border[1])
    bottom = np.where(in_image[:, 0], expected[:, 0], -np.inf)
    top = np.where(in_image[:, 1], expected[:, 1], np.inf)
    low, high = ends.e[edge].T
    inside = np.minimum(top, high) - np.maximum(bottom, low)
    covered = np.clip((inside + 2 * TOLERANCE_PX * per_px) * ends.per_length[edge], 0.0, 1.0)
    short = np.minimum(ends.room[edge] * per_visible[:, None], 1.0) * np.where(in_image, ends.missed, 1.0)
    off = np.where(in_image, ends.e[edge] - expected, np.inf) / ends.sigma[edge]
    at = np.where(known, short + ends.peak[edge] * np.exp(-0.5 * off**2), 1.0)
    return np.asarray(covered**2 * at.prod(axis=1))
