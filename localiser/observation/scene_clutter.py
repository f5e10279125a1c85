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

There may always be a new edge, so m is at least 1. In an image of one or two edges this alone would expect nearly one
more than there are, and every place would lose by it. So λ is scaled to the integral that it has without this least m.

All hypotheses about where the robot is share this intensity. A place must predict the edges better.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from localiser.camera import Camera
from localiser.edges import Edges
from localiser.geometry import Array, between, compose, wrap_angle
from localiser.landmarks import half_view_rad
from localiser.observation.angle import Angle
from localiser.observation.endpoint_likelihood import ROW_PX, SIGMA_PX, endpoints_of
from localiser.observation.persistent_clutter import NEAR_M

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
        return now if self.camera is None or self.camera is now.camera else _angle_by(self.camera, now.kind)


@lru_cache(maxsize=16)  # so that what is worked out of an image is found again
def _angle_by(camera: Camera, kind: Literal["line", "slope"]) -> Angle:
    return Angle(camera, kind)


def scene_clutter(angle: Angle, edges: Edges, earlier: Sequence[EarlierEdges]) -> tuple[Array, Array]:
    """Return how dense clutter is at each edge (E,), and how much likelier it is if it continues an earlier one (E,).

    The density is relative to E edges spread evenly over the field of view, with ends as `endpoint_likelihood` has
    them. The ratio is that to a new edge, 1 where there is nothing to continue. earlier: images of the same scene, the
    one that is believed most first. The others tell of edges that it missed.
    """
    count = len(edges)
    if not count:
        return np.ones(0), np.ones(0)
    grouped = grouped_density(angle, edges)
    images = [one for one in earlier if len(one.edges)]
    if not images:
        return grouped, np.ones(count)
    again, expected = np.zeros(count), 0.0
    for index, image in enumerate(images):
        shown = _missed_by(angle, image, images[:index])
        again += SEEN_AGAIN * continued_density(angle, edges, image) @ shown
        expected += SEEN_AGAIN * float(shown @ _stays_in_view(angle, image))
    new = max(count - expected, NEW * count)
    spread = max(new, 1.0)  # an image with one edge may show another one next time
    density = (again + spread * grouped) * (expected + new) / (expected + spread)
    return density / count, again / max(expected, 1e-9) / grouped


def _missed_by(angle: Angle, image: EarlierEdges, others: Sequence[EarlierEdges]) -> Array:
    """Return how probably each edge (B,) of an image is there still and none of the others shows it; 1 without others.

    An edge that another image shows is expected from there. One that none shows was missed, or is out of view.
    """
    missed = np.full(len(image.edges), STILL_THERE if others else 1.0)
    for other in others:
        since = compose(image.motion, between(other.motion, np.zeros(3)))
        turn_var = max(image.turn_var - other.turn_var, 0.0)
        before = EarlierEdges(image.edges, since, turn_var, image.angle(angle).camera)
        shows = continued_density(other.angle(angle), other.edges, before).sum(axis=0)
        missed *= 1.0 / (1.0 + SEEN_AGAIN * shows)
    return missed


def _stays_in_view(angle: Angle, image: EarlierEdges) -> NDArray[np.bool_]:
    """Return which edges (B,) of an image the camera still sees, if they moved by half of the largest parallax."""
    columns, _ = _columns(image.angle(angle), image.edges)
    bearing, _, cos, sin = columns[:, :4].T
    right, back, turn = image.motion
    across = (right * cos + back * sin) / NEAR_M
    return np.abs(wrap_angle(bearing + turn - across / 2)) <= half_view_rad(angle.camera)


def continued_density(angle: Angle, edges: Edges, image: EarlierEdges) -> Array:
    """Return K (E, B), relative to an even density."""
    then = image.angle(angle)
    (now, has_ends), (before, had_ends) = _columns(angle, edges), _columns(then, image.edges)
    return _density(angle, now, before, image, SIGMA_PX if has_ends and had_ends else np.inf)


@lru_cache(maxsize=4)  # an image is compared with several earlier ones
def grouped_density(angle: Angle, edges: Edges) -> Array:
    """Return Λ (E,), relative to an even density."""
    columns, has_ends = _columns(angle, edges)
    others, now = columns.copy(), columns.copy()
    others[:, 1], now[:, 1] = 0.0, np.nan_to_num(columns[:, 1])
    still = EarlierEdges(edges, np.zeros(3), GROUP_RAD**2)
    density = _density(angle, now, others, still, ROW_PX if has_ends else np.inf)
    np.fill_diagonal(density, 0.0)
    return np.asarray((1.0 + density.sum(axis=1)) / len(edges))


def _density(angle: Angle, now: Array, before: Array, image: EarlierEdges, end_sigma_px: float) -> Array:
    """Return how dense edges (E, 14) are that continue those of an image (B, 14), by `scene_clutter_kernel`.

    end_sigma_px: of where an edge ends; infinite where nothing is known of it.
    """
    from localiser.observation import scene_clutter_kernel as kernel

    mount, then = angle.camera.mount, image.angle(angle).camera.mount
    attitude = np.array([np.sin(mount.tilt_rad), np.cos(mount.tilt_rad), (then.height_m - mount.height_m) / NEAR_M])
    end_var = (end_sigma_px / angle.camera.focal_px) ** 2
    return kernel.continued(now, before, image.motion, image.turn_var, attitude, end_var, NEAR_M, SHORT)


@lru_cache(maxsize=32)  # an image is compared with those of the last scene
def _columns(angle: Angle, edges: Edges) -> tuple[Array, bool]:
    """Return the edges (E, 14) as `scene_clutter_kernel` takes them, and whether it is known where they end."""
    bearing, sigma = angle.bearings(edges)
    ends, tilt_rad = endpoints_of(edges, angle.camera), angle.camera.mount.tilt_rad
    s, c = np.sin(tilt_rad), np.cos(tilt_rad)
    columns: list[NDArray[Any]] = [bearing, sigma**2, np.cos(bearing), np.sin(bearing), angle.span_at(bearing)]
    columns += [ends.e, (ends.e * c - s) / (c + ends.e * s), ends.room, ends.cut, ends.per_length]
    return np.column_stack(columns), bool(np.isfinite(edges.ends_px).all())
