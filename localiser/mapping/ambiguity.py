"""Ambiguity of places: which poses look like others, and where one more landmark would distinguish them.

What a camera sees from a pose is a Poisson process of bearings: landmarks in view, each found with some probability,
and clutter of constant density. How well the view from pose a is distinguished from that of pose b is the divergence
of the two processes, D(a, b) = ∫ I_a ln(I_a / I_b) - I_a + I_b. This is the expected log-likelihood ratio of one image.
Every pose of a grid is compared with all others, with bearings blurred to the step of the grid, which never makes D
larger. The likeliest poses are then moved to where they look most alike.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from localiser.camera import Camera
from localiser.geometry import Array, robot_from_map, wrap_angle
from localiser.geometry.compiled import checked
from localiser.landmarks import LandmarkMap, SightParameters
from localiser.mapping.ambiguity_kernel import search_loop

ALIKE = 1.0
"""Two poses look alike when one image tells less (nats) than a single landmark does that only one of them has."""
_FOUND, _CLUTTER = 0.8, 3.0  # chance that a landmark in view is found; false edges in an image
_SIGMA_RAD = np.deg2rad(0.5)  # of a bearing: edges are better, but robots pitch and maps err
_BLUR_RAD = np.deg2rad(5.0)  # with which all poses are compared
_GATES_RAD = np.deg2rad([10.0, 10.0, 7.0, 5.0, 3.5, 2.5, 1.7, 1.2, 1.0, 1.0])  # of matches, on the way to a twin
_HEADINGS, _EVERY = 24, 2  # headings that are compared with; every second one is asked for
_BIN_RAD = np.deg2rad(2.5)
_APART_M, _TURNED_RAD = 1.0, np.deg2rad(30.0)  # what is nearer and turned by less is no other place
_ALTERNATIVES = 6  # for each pose, looked at closely
_WORTH_A_LOOK = 4.0  # times `ALIKE`: the grid's own places are not quite where poses look most alike
_AT_ONCE = 256
_SPOT_APART_M = 1.0


@dataclass(frozen=True, slots=True, eq=False)
class Ambiguity:
    """Camera poses (N, 3), for each the other pose (N, 3) that looks most like it, and the nats (N,) that part them.

    nats: expected log-likelihood ratio of one image; below `ALIKE` they look alike. shown: (N,) landmarks in view.
    """

    poses: Array
    twins: Array
    nats: Array
    shown: NDArray[np.int64]

    @property
    def alike(self) -> NDArray[np.bool_]:
        """Which poses (N,) look like another."""
        return self.nats < ALIKE


@dataclass(frozen=True, slots=True, eq=False)
class Spot:
    """Where a landmark would help: x, z, and the share of poses that would still look like another with it."""

    x: float
    z: float
    alike_share: float


def find_ambiguity(landmark_map: LandmarkMap, camera: Camera, places: Array) -> Ambiguity:
    """Return what looks like what, from places (P, 2), at headings all round. Walls hide nothing here."""
    angles = wrap_angle(2 * np.pi * np.arange(_HEADINGS) / _HEADINGS)
    others = np.concatenate([np.repeat(places, _HEADINGS, axis=0), np.tile(angles, len(places))[:, None]], axis=1)
    poses = others.reshape(len(places), _HEADINGS, 3)[:, ::_EVERY].reshape(-1, 3)
    alternatives, blurred = _alternatives(poses, others, landmark_map, camera)
    points, polarity = landmark_map.points, landmark_map.polarity.astype(np.int64)
    sigma, start_sigma = np.sqrt(2.0) * _SIGMA_RAD, np.array([_step(places), _step(places), _BLUR_RAD])
    limits, density = _limits(camera), _density(camera)
    first = blurred.argmin(axis=1)
    rows = np.arange(len(poses))
    twins, nats = others[alternatives[rows, first]], blurred[rows, first]
    close = np.full(len(poses), np.inf)
    for column in range(alternatives.shape[1]):
        # Blurred bearings part poses no better than sharp ones do: what they part is not looked at again.
        row = np.flatnonzero(blurred[:, column] < _WORTH_A_LOOK * ALIKE)
        start = others[alternatives[row, column]]
        found, apart = checked(search_loop)(
            poses[row], start, points, polarity, limits, _GATES_RAD, start_sigma, sigma, density, _FOUND
        )
        apart[_same_place(poses[row], found, 1.0)] = np.inf
        better = apart < close[row]
        twins[row[better]], close[row[better]] = found[better], apart[better]
    nats = np.where(np.isfinite(close), close, nats)
    shown = np.sum([_shown(poses, camera, point)[0] for point in points], axis=0)
    return Ambiguity(poses, twins, np.maximum(nats, 0.0), shown)


def best_spots(found: Ambiguity, camera: Camera, spots: Array, count: int = 3) -> list[Spot]:
    """Return where, of `spots` (S, 2), one more landmark tells most poses from their twins; each after those before.

    A landmark helps where one of the two poses shows it and the other does not, or elsewhere in the image.
    """
    nats, chosen = found.nats.copy(), []
    gain = np.stack([_gain(found, camera, spot) for spot in spots])
    open_spots = np.ones(len(spots), dtype=bool)
    for _ in range(count):
        helped = (np.minimum(nats + gain, ALIKE) - np.minimum(nats, ALIKE)).sum(axis=1)
        best = int(np.where(open_spots, helped, -1.0).argmax())
        if not open_spots[best] or helped[best] <= 0:
            break
        nats = nats + gain[best]
        chosen.append(Spot(float(spots[best, 0]), float(spots[best, 1]), float((nats < ALIKE).mean())))
        open_spots &= np.hypot(*(spots - spots[best]).T) > _SPOT_APART_M
    return chosen


def _gain(found: Ambiguity, camera: Camera, spot: Array) -> Array:
    """Return by how many nats (N,) a landmark at `spot` (2,) parts the poses from their twins."""
    (here, bearing), (there, twin_bearing) = (_shown(poses, camera, spot) for poses in (found.poses, found.twins))
    sigma = np.sqrt(2.0) * _SIGMA_RAD
    density = _density(camera)
    peak = _FOUND / (sigma * np.sqrt(2 * np.pi))
    beside = peak * np.exp(-0.5 * (wrap_angle(bearing - twin_bearing) / sigma) ** 2) * there
    right = _FOUND * np.log((density + peak) / (density + beside))
    return np.asarray(np.maximum(here * right + _FOUND * (there.astype(float) - here.astype(float)), 0.0))


def _shown(poses: Array, camera: Camera, spot: Array) -> tuple[NDArray[np.bool_], Array]:
    """Return whether each camera pose (N,) has a point (2,) in view, and its bearing (N,)."""
    tangent, nearest, farthest = (float(limit) for limit in _limits(camera))
    inside = robot_from_map(poses, np.tile(spot, (len(poses), 1)))
    range_m = np.hypot(inside[:, 0], inside[:, 1])
    shown = (inside[:, 1] < 0) & (np.abs(inside[:, 0]) < -inside[:, 1] * tangent)
    return shown & (range_m > nearest) & (range_m < farthest), np.arctan2(inside[:, 0], -inside[:, 1])


def _limits(camera: Camera) -> Array:
    """Return the tangent of half the field of view, and the least and largest distance (m) of what is seen."""
    p = SightParameters()
    return np.array([camera.width / 2 / camera.focal_px, p.range_min_m, p.range_max_m])


def _density(camera: Camera) -> float:
    """Return the density of clutter, 1/rad."""
    return _CLUTTER / (2 * float(np.arctan(_limits(camera)[0])))


def _step(places: Array) -> float:
    """Return the distance (m) between neighbouring places (P, 2)."""
    steps = [np.diff(np.unique(places[:, axis])) for axis in (0, 1)]
    return float(min((step.min() for step in steps if len(step)), default=_APART_M))


# -- all against all, with bearings blurred ----------------------------------------------------------------------------


def _alternatives(
    poses: Array, others: Array, landmark_map: LandmarkMap, camera: Camera
) -> tuple[NDArray[np.int64], Array]:
    """Return which of the others (M, 3) look most like each pose (N, R), and by how much (N, R); not its own place."""
    asked, compared = (_intensity(part, landmark_map, camera) for part in (poses, others))
    log_compared, total = np.log(compared), compared.sum(axis=1)
    count = min(_ALTERNATIVES, len(others))
    own = (asked * np.log(asked)).sum(axis=1) - asked.sum(axis=1)
    alternatives, nats = np.zeros((len(poses), count), dtype=np.int64), np.zeros((len(poses), count))
    for first in range(0, len(poses), _AT_ONCE):
        part = slice(first, first + _AT_ONCE)
        apart = total[None] - asked[part] @ log_compared.T
        # A little farther off than another place must be, so that the search does not end where it began.
        apart[_same_place(poses[part, None], others[None], 1.5)] = np.inf
        alternatives[part] = np.argpartition(apart, count - 1, axis=1)[:, :count]
        nats[part] = np.take_along_axis(apart, alternatives[part], axis=1) + own[part, None]
    return alternatives, nats


def _same_place(poses: Array, others: Array, share: float) -> NDArray[np.bool_]:
    """Return which poses (..., 3) are no other places, their distances and turns divided by `share`."""
    shift = poses[..., :2] - others[..., :2]
    turned = np.abs(wrap_angle(poses[..., 2] - others[..., 2]))
    near = shift[..., 0] ** 2 + shift[..., 1] ** 2 < (share * _APART_M) ** 2
    return np.asarray(near & (turned < share * _TURNED_RAD))


def _intensity(poses: Array, landmark_map: LandmarkMap, camera: Camera) -> NDArray[np.float32]:
    """Return the expected edges (N, 2 B) in bins of bearing, of either polarity; an unknown one is half of each."""
    half = float(np.arctan(_limits(camera)[0]))
    bins = np.arange(-half, half, _BIN_RAD) + _BIN_RAD / 2
    sigma = float(_BLUR_RAD)
    result = np.full((len(poses), 2, len(bins)), _density(camera) * _BIN_RAD / 2, dtype=np.float32)
    for point, polarity in zip(landmark_map.points, landmark_map.polarity, strict=True):
        shown, bearing = _shown(poses, camera, point)
        seen = np.flatnonzero(shown)
        bump = np.exp(-0.5 * ((bins - bearing[seen, None]) / sigma) ** 2) * _BIN_RAD / (sigma * np.sqrt(2 * np.pi))
        for sign, channel in ((1, 0), (-1, 1)):
            result[seen, channel] += _FOUND * (0.5 if polarity == 0 else float(polarity == sign)) * bump
    return result.reshape(len(poses), -1)
