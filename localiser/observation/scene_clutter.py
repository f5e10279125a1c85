"""Scene clutter: what is on no map is expected where an earlier image showed it, and beside its like.

The belief compares places with the hypothesis that all edges of an image are clutter. Edges predict those of later
images, whatever they are. If clutter were independent in each image, a wrong place that fits one image by chance would
gain by every image of the same things. So the clutter is a Poisson process with the intensity

    λ(e) = s Σ_j K(e; j) + m Λ(e)

j: the edges of the earlier image, of which a fraction s is seen again, and those of still earlier ones that it missed.
K: edge j turned with the robot and shifted by the parallax of an unknown distance r, as in `persistent_clutter`, and
ending where j ended, shifted by the same parallax, by the model of `endpoint_likelihood`. m is the expected number of
new edges. They stand in groups, as books on a shelf: Λ is a Dirichlet process of concentration 1 whose other draws are
the other edges of the image, 3° wide and with ends in the same rows.

All hypotheses about where the robot is share this intensity. A place must predict the edges better.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from localiser.camera import Camera
from localiser.edges import Edges
from localiser.geometry import Array, between, compose
from localiser.observation.angle import Angle
from localiser.observation.endpoint_likelihood import ROW_PX, SIGMA_PX, endpoints_of
from localiser.observation.persistent_clutter import NEAR_M, errors_of_continuing

SEEN_AGAIN = 0.8  # how often an edge of the earlier image is seen again
NEW = 0.3  # how many of the edges may be new, at least
GROUP_RAD = np.radians(3.0)  # how far apart the edges of one group are
STILL_THERE = 0.5  # how often an edge that later images do not show is there still
SHORT = 0.3  # how often an end is not where the same edge ended before


@dataclass(frozen=True, slots=True, eq=False)
class EarlierEdges:
    """The edges of an earlier image.

    motion: (3,) of the camera since, in its own frame then (m, m, rad). turn_var: variance of its turn (rad²). camera:
    as it was mounted then; None: as now.
    """

    edges: Edges
    motion: Array
    turn_var: float
    camera: Camera | None = None

    def angle(self, now: Angle) -> Angle:
        """Return the angle that this image compares; now: that of the image it is compared with."""
        return now if self.camera is None or self.camera is now.camera else replace(now, camera=self.camera)


def scene_clutter(angle: Angle, edges: Edges, earlier: Sequence[EarlierEdges]) -> tuple[Array, Array]:
    """Return how dense clutter is at each edge (E,), and how much likelier it is if it continues an earlier one (E,).

    The density is relative to E edges spread evenly over the field of view, with ends as `endpoint_likelihood` has
    them. The ratio is that to a new edge, 1 where there is nothing to continue. earlier: images of the same scene, the
    one that is believed most first. The others tell of edges that it missed.
    """
    count = len(edges)
    if not count:
        return np.ones(0), np.ones(0)
    grouped = _grouped(angle, edges)
    images = [one for one in earlier if len(one.edges)]
    if not images:
        return grouped, np.ones(count)
    again, expected = np.zeros(count), 0.0
    for index, image in enumerate(images):
        shown = _missed_by(angle, image, images[:index])
        again += SEEN_AGAIN * _continued(angle, edges, image) @ shown
        expected += SEEN_AGAIN * float(shown.sum())
    new = max(count - expected, NEW * count, 1.0) * grouped
    return (again + new) / count, again / max(expected, 1e-9) / grouped


def _missed_by(angle: Angle, image: EarlierEdges, others: Sequence[EarlierEdges]) -> Array:
    """Return how probably each edge (B,) of an image is there still and none of the others shows it; 1 without others.

    An edge that another image shows is expected from there. One that none shows was missed, or is out of view.
    """
    missed = np.full(len(image.edges), STILL_THERE if others else 1.0)
    for other in others:
        since = compose(image.motion, between(other.motion, np.zeros(3)))
        turn_var = max(image.turn_var - other.turn_var, 0.0)
        before = EarlierEdges(image.edges, since, turn_var, image.angle(angle).camera)
        shows = _continued(other.angle(angle), other.edges, before).sum(axis=0)
        missed *= 1.0 / (1.0 + SEEN_AGAIN * shows)
    return missed


def _continued(angle: Angle, edges: Edges, image: EarlierEdges) -> Array:
    """Return K (E, B), relative to an even density."""
    before, motion = image.edges, image.motion
    with_ends = bool(np.isfinite(edges.ends_px).all() and np.isfinite(before.ends_px).all())
    of_before = image.angle(angle)
    earlier, earlier_sigma = of_before.bearings(before)
    bearing, sigma = angle.bearings(edges)
    error, variance = errors_of_continuing(bearing, sigma, earlier, earlier_sigma, motion, image.turn_var)
    density = _normal(error, variance) * angle.span_at(bearing)[:, None]
    if with_ends:
        ahead = motion[0] * np.sin(earlier) - motion[1] * np.cos(earlier)
        density *= _ends_alike(angle, edges, of_before, before, ahead / NEAR_M, SIGMA_PX)
    return density


@lru_cache(maxsize=4)  # an image is compared with several earlier ones
def _grouped(angle: Angle, edges: Edges) -> Array:
    """Return Λ (E,), relative to an even density."""
    bearing, sigma = angle.bearings(edges)
    density = _normal(bearing[:, None] - bearing, GROUP_RAD**2 + np.nan_to_num(sigma)[:, None] ** 2)
    density *= angle.span_at(bearing)[:, None]
    if np.isfinite(edges.ends_px).all():
        density *= _ends_alike(angle, edges, angle, edges, np.zeros(len(edges)), ROW_PX)
    np.fill_diagonal(density, 0.0)
    return np.asarray((1.0 + density.sum(axis=1)) / len(edges))


def _ends_alike(angle: Angle, edges: Edges, of_others: Angle, others: Edges, approach: Array, sigma_px: float) -> Array:
    """Return how much likelier the ends of edges (E) are if they are those of others (B), (E, B).

    approach: (B,) by how much of the nearest distance the camera came nearer to each of the others. An end at upright
    height e of a thing at distance D has the slope t = (e c - s) / (c + e s), which grows by t · approach / D. A camera
    that was mounted higher by h sees it lower by h / D.
    """
    camera, then = angle.camera, of_others.camera
    s, c = np.sin(camera.mount.tilt_rad), np.cos(camera.mount.tilt_rad)
    ends, earlier_ends = endpoints_of(edges, camera), endpoints_of(others, then)
    earlier, slope = _ends_from(earlier_ends.e, then, camera)
    rise = (then.mount.height_m - camera.mount.height_m) / NEAR_M
    shift = (slope * approach[:, None] + rise) / (c - slope * s) ** 2
    # From here on with both ends first: (2, E, 1) and (2, 1, B).
    shift, room = shift.T[:, None], ends.room.T[..., None]
    variance = shift**2 / 12 + (sigma_px / camera.focal_px) ** 2
    at = _normal(ends.e.T[..., None] - earlier.T[:, None] - shift / 2, variance)
    alike = SHORT * np.minimum(room * earlier_ends.per_length, 1.0) + (1.0 - SHORT) * room * at
    # The border ends an edge wherever the thing itself does.
    cut = np.where(earlier_ends.cut.T[:, None], 1.0, SHORT)
    low, high = np.where(ends.cut.T[..., None], cut, alike)
    return np.asarray(low * high)


def _ends_from(e: Array, before: Camera, now: Camera) -> tuple[Array, Array]:
    """Return upright image heights as the camera of now would see them from the place before, and their slopes.

    e: as the camera was mounted before.
    """
    s, c = np.sin(before.mount.tilt_rad), np.cos(before.mount.tilt_rad)
    slope = (e * c - s) / (c + e * s)
    if now.mount.tilt_rad == before.mount.tilt_rad:
        return e, slope
    s, c = np.sin(now.mount.tilt_rad), np.cos(now.mount.tilt_rad)
    return (slope * c + s) / (c - slope * s), slope


def _normal(error: Array, variance: Array) -> Array:
    """Return the normal density, 0 where something is not known."""
    with np.errstate(invalid="ignore", divide="ignore"):
        density = np.exp(-0.5 * error**2 / variance) / np.sqrt(2 * np.pi * variance)
    return np.where(np.isfinite(density), density, 0.0)
