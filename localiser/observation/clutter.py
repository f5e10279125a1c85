"""Clutter: what is on no map is expected where earlier images showed it, and beside its like (docs/observation.md).

Particles of one place are weighed by **persistent clutter**: what was clutter in the last image, over all poses which
they then had. At the mean pose alone, an edge of a landmark that misses it by an error of the pose would be taken for
clutter, and could not correct the pose.

The belief compares all places by **scene clutter**, of which at least one new edge is expected. In an image of one or
two edges this alone would expect nearly one more than there are, and every place would lose by it. So the intensity is
scaled to the integral that it has without this least number.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from localiser.geometry import Array, Increment, between, compose, wrap_angle
from localiser.geometry.compiled import compiled
from localiser.landmarks import half_view_rad
from localiser.observation.frame import ROW_PX, SIGMA_PX, Frame

NEAREST_M = 1.0  # things on no map are farther away
SEEN_AGAIN = 0.8  # how often an edge of the earlier image is seen again
NEW = 0.3  # how many of the edges may be new, at least
GROUP_RAD = np.radians(3.0)  # how far apart the edges of one group are
STILL_THERE = 0.5  # how often an edge that later images do not show is there still
SHORT = 0.3  # how often an end is not where the same edge ended before
_GATE = 3.0  # sigmas within which an edge may continue another


@dataclass(frozen=True, slots=True, eq=False)
class EarlierFrame:
    """The frame of an earlier image.

    motion: (3,) of the camera since, in its own frame then (m, m, rad). turn_var: variance of its turn (rad²).
    """

    frame: Frame
    motion: Array
    turn_var: float

    @classmethod
    def of(cls, frame: Frame, now: Frame, since: Increment, turn_var: float) -> EarlierFrame:
        """Return an earlier frame, since which the robot moved until the frame `now`, and the camera on it."""
        mount, then = now.camera.robot_from_level, frame.camera.robot_from_level
        right, back, _ = between(then, compose(since.mean, mount))
        return cls(frame, np.array([right, back, since.mean[2] + (mount[2] - then[2])]), turn_var)


# -- persistent clutter -----------------------------------------------------------------------------------------------


def persistent_clutter(now: Frame, image: EarlierFrame, clutter: Array | None = None) -> Array:
    """Return how much denser clutter is at each edge (E,) than spread over the image, at least 1.

    clutter: (B,) probability that an edge of the last image was clutter; None: all were. Denser only where just one
    edge of the last image may be continued, and by one edge: else nothing is known of where a single one would be.
    """
    (bearing, sigma), (before, before_sigma) = now.bearings, image.frame.bearings
    right, back, turn = image.motion
    across = right * np.cos(before) + back * np.sin(before)
    variance = before_sigma**2 + image.turn_var + (across / NEAREST_M) ** 2 / 12 + sigma[:, None] ** 2
    square = wrap_angle(bearing[:, None] - (before + turn - across / (2 * NEAREST_M))) ** 2 / variance
    may = square < _GATE**2
    edge, of = np.nonzero(may & (may.sum(axis=0) == 1) & (may.sum(axis=1) == 1)[:, None])
    peak = np.exp(-0.5 * square[edge, of]) / np.sqrt(2 * np.pi * variance[edge, of])
    share = 1.0 if clutter is None else clutter[of]
    density = np.ones(len(bearing))
    density[edge] = np.maximum(share * now.clutter[edge, _SPAN] * peak + 1.0 - share, 1.0)
    return density


# -- scene clutter ----------------------------------------------------------------------------------------------------


def scene_clutter(now: Frame, earlier: Sequence[EarlierFrame]) -> tuple[Array, Array]:
    """Return how dense clutter is at each edge (E,), and how much likelier it is if it continues an earlier one (E,).

    The density is relative to E edges spread evenly over the field of view, with ends as `association` has them. The
    ratio is that to a new edge, 1 where there is no earlier image. earlier: images of the same scene that show edges,
    the one that is believed most first. The others tell of edges that it missed.
    """
    count, grouped = len(now.clutter), grouped_density(now)
    if not earlier:
        return grouped, np.ones(count)
    again, expected = np.zeros(count), 0.0
    for index, image in enumerate(earlier):
        shown, (density, bearing) = _missed_by(image, earlier[:index]), continued_density(now, image)
        again += SEEN_AGAIN * density @ shown
        stays = np.abs(wrap_angle(bearing)) <= half_view_rad(now.camera)  # edges that the camera still sees
        expected += SEEN_AGAIN * float(shown @ stays)
    new = max(count - expected, NEW * count)
    spread = max(new, 1.0)  # an image with one edge may show another one next time
    density = (again + spread * grouped) * (expected + new) / (expected + spread)
    return density / count, again / max(expected, 1e-9) / grouped


def _missed_by(image: EarlierFrame, others: Sequence[EarlierFrame]) -> Array:
    """Return how probably each edge (B,) of an image is there still and none of the others shows it; 1 without others.

    An edge that another image shows is expected from there. One that none shows was missed, or is out of view.
    """
    missed = np.full(len(image.frame.clutter), STILL_THERE if others else 1.0)
    for other in others:
        since = compose(image.motion, between(other.motion, np.zeros(3)))
        before = EarlierFrame(image.frame, since, max(image.turn_var - other.turn_var, 0.0))
        missed *= 1.0 / (1.0 + SEEN_AGAIN * continued_density(other.frame, before)[0].sum(axis=0))
    return missed


@lru_cache(maxsize=4)  # an image is compared with several earlier ones
def grouped_density(now: Frame) -> Array:
    """Return Λ (E,), relative to an even density."""
    others, edges = now.clutter.copy(), now.clutter.copy()
    others[:, _VAR], edges[:, _VAR] = 0.0, np.fmax(edges[:, _VAR], 0.0)  # 0 where it is not known
    mount, end_var = (*now.sight[0][:2], 0.0), (ROW_PX / now.camera.focal_px) ** 2 if now.has_ends else np.inf
    density, _ = compiled(continued_loop)(edges, others, np.zeros(3), float(GROUP_RAD**2), mount, end_var)
    np.fill_diagonal(density, 0.0)
    return np.asarray((1.0 + density.sum(axis=1)) / len(edges))


def continued_density(now: Frame, image: EarlierFrame) -> tuple[Array, Array]:
    """Return K (E, B), relative to an even density, and the bearings (B,) after half of the largest parallax."""
    then = image.frame
    mount = (*now.sight[0][:2], (then.camera.mount.height_m - now.camera.mount.height_m) / NEAREST_M)
    end_var = (SIGMA_PX / now.camera.focal_px) ** 2 if now.has_ends and then.has_ends else np.inf
    return compiled(continued_loop)(now.clutter, then.clutter, image.motion, image.turn_var, mount, end_var)


# Columns of `Frame.clutter`; of `_E` to `_CUT` there are two each, for the lower and the upper end.
_BEARING, _VAR, _COS, _SIN, _SPAN, _E, _SLOPE, _ROOM, _CUT, _PER_LENGTH = 0, 1, 2, 3, 4, 5, 7, 9, 11, 13


def continued_loop(
    now: Array, then: Array, motion: Array, turn_var: float, mount: tuple[float, ...], end_var: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return what `continued_density` does of edges (E, 14) and earlier ones (B, 14), see `Frame.clutter`.

    motion: (3,) of the camera since, in its own frame then; turn_var: variance of its turn. mount: sine and cosine
    of the camera's tilt now, and by how much it was higher before, over `NEAREST_M`. end_var: variance of an end's
    height; infinite where nothing is known of ends. A density is 0 where something is not known.

    The camera comes nearer to an edge by `approach` of the nearest distance. An end at upright height e of a thing at
    distance D has the slope t = (e c - s) / (c + e s), which grows by t · approach / D. A camera that was mounted
    higher by h sees it lower by h / D.
    """
    result, bearing = np.zeros((len(now), len(then))), np.empty(len(then))
    right, back, turn = motion[0], motion[1], motion[2]
    s, c, rise = mount
    for j in range(len(then)):
        across = (right * then[j, _COS] + back * then[j, _SIN]) / NEAREST_M
        approach = (right * then[j, _SIN] - back * then[j, _COS]) / NEAREST_M
        bearing[j] = expected = then[j, _BEARING] + turn - across / 2
        variance = then[j, _VAR] + turn_var + across * across / 12
        for i in range(len(now)):
            error = now[i, _BEARING] - expected
            error -= 2 * np.pi * np.floor((error + np.pi) / (2 * np.pi))
            spread = variance + now[i, _VAR]
            if error * error > 100.0 * spread:  # nothing beside the rest, and most pairs are so far apart
                continue
            density = np.exp(-0.5 * error * error / spread) / np.sqrt(2 * np.pi * spread) * now[i, _SPAN]
            if density == 0.0 or not np.isfinite(density):
                continue
            if np.isfinite(end_var):
                for end in range(2):
                    slope, room = then[j, _SLOPE + end], now[i, _ROOM + end]
                    shift = (slope * approach + rise) / (c - slope * s) ** 2
                    off = now[i, _E + end] - (slope * c + s) / (c - slope * s) - shift / 2
                    spread = shift * shift / 12 + end_var
                    at = np.exp(-0.5 * off * off / spread) / np.sqrt(2 * np.pi * spread)
                    at = at if np.isfinite(at) else 0.0
                    alike = SHORT * min(room * then[j, _PER_LENGTH], 1.0) + (1.0 - SHORT) * room * at
                    if now[i, _CUT + end] > 0:  # the border ends an edge wherever the thing itself does
                        alike = 1.0 if then[j, _CUT + end] > 0 else SHORT
                    density *= alike
            result[i, j] = density
    return result, bearing
