"""One vertical edge of the building, estimated while driving by its own extended Kalman filter.

It begins with the inverse-depth model (`inverse_depth`). When there is enough parallax it becomes a point.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from localiser.geometry import Array, forward, wrap_angle
from localiser.mapping.inverse_depth import first_state, predicted
from localiser.mapping.sightings import direction_of, per_point

_LINEAR = 0.1
"""Most that `LiveFeature.curvature` may be for a point to be as Gaussian as the inverse distance was: [Civera 2008]."""


@dataclass(slots=True, eq=False)
class LiveFeature:
    """What is known of one edge, frame by frame; angles in rad, places in the map.

    number: unlike any other's. origin: (2,) camera when it was first seen, under the heading `first`. lowest, highest:
    of its headings from `first`. filter: filterpy's; state (heading, inverse distance) from the origin, or (x, z) once
    `is_point`. evidence: log-odds of it being an edge and not clutter. side, polarity: how it looked last. signs: sum
    of polarities, count: images that showed it, last: the latest of them, begun: the first.
    """

    number: int
    origin: Array
    first: float
    filter: Any
    side: Array
    polarity: np.int8
    begun: int
    last: int
    evidence: float = 0.0
    lowest: float = 0.0
    highest: float = 0.0
    count: int = 1
    signs: int = 0
    is_point: bool = False

    @property
    def parallax(self) -> float:
        """The widest angle between the headings under which it was seen."""
        return self.highest - self.lowest

    @property
    def curvature(self) -> float:
        """How far from Gaussian its place is along its direction: 4 σ(d)/d, an upper bound of Civera's index."""
        return float(4 * np.sqrt(self.filter.P[1, 1]) / max(self.filter.x[1], 1e-9))

    @property
    def is_near_enough_gaussian(self) -> bool:
        """Whether a point (x, z) with a covariance says what is known of its place."""
        return self.curvature < _LINEAR

    @property
    def distance_m(self) -> float:
        """Its distance from where it was first seen; of what is no point yet."""
        return float(1 / max(self.filter.x[1], 1e-9))

    def predicted(self, camera: Array) -> tuple[float, float]:
        """Return the heading under which the camera (3,) sees it, and the variance of that."""
        heading, jacobian = self.prediction(self.filter.x, camera)
        return float(heading[0]), float((jacobian @ self.filter.P @ jacobian.T)[0, 0])

    def prediction(self, state: Array, camera: Array) -> tuple[Array, Array]:
        """Return the heading (1,) under which the camera (3,) sees a feature of `state`, and its derivative (1, 2)."""
        if self.is_point:
            return direction_of(state[None], camera[None])[0], per_point(state[None], camera[None])
        return predicted(self.origin[None], state[None], camera)

    def see(self, camera: Array, heading: float, sigma: float) -> None:
        """Take in that the camera (3,) sees it under a heading of the map."""
        self.filter.update(
            np.array([heading]),
            lambda state: self.prediction(state, camera)[1],
            lambda state: self.prediction(state, camera)[0],
            R=np.array([[sigma**2]]),
            residual=lambda one, other: wrap_angle(one - other),
        )
        if not self.is_point:
            self.filter.x[1] = max(self.filter.x[1], 0.0)
        turned = float(wrap_angle(heading - self.first))
        self.lowest, self.highest = min(self.lowest, turned), max(self.highest, turned)
        self.count += 1

    def become_point(self) -> None:
        """Turn direction and inverse distance into (x, z)."""
        heading, inverse = self.filter.x
        distance = 1 / inverse
        ahead = forward(heading)
        jacobian = np.stack([distance * forward(heading + np.pi / 2), -(distance**2) * ahead], axis=-1)
        self.filter.x = self.origin + distance * ahead
        self.filter.P = jacobian @ self.filter.P @ jacobian.T
        self.is_point = True

    def distance2(self, point: Array, cov: Array) -> float:
        """Return the squared Mahalanobis distance of a point (2,) with covariance (2, 2) from it."""
        offset = self.filter.x - point
        return float(offset @ np.linalg.solve(self.filter.P + cov, offset))

    def join(self, other: LiveFeature, extra_sigma_m: float) -> None:
        """Take in another point that turned out to be this one; extra_sigma_m: by how much both may differ."""
        noise = other.filter.P + extra_sigma_m**2 * np.eye(2)
        self.filter.update(other.filter.x, lambda _: np.eye(2), lambda x: x, R=noise)
        turned = wrap_angle(other.first + np.array([other.lowest, other.highest]) - self.first)
        self.lowest, self.highest = min(self.lowest, *turned), max(self.highest, *turned)
        self.count += other.count
        self.signs += other.signs
        self.evidence += other.evidence
        self.last, self.side, self.polarity = other.last, other.side, other.polarity


def started(number: int, camera: Array, heading: float, sigma: float, nearest_m: float, frame: int) -> LiveFeature:
    """Return a feature of unknown distance: between `nearest_m` and infinity within two sigmas."""
    from filterpy.kalman import ExtendedKalmanFilter

    ekf = ExtendedKalmanFilter(dim_x=2, dim_z=1)
    state, cov = first_state(np.array([heading]), np.array([sigma]), nearest_m)
    ekf.x, ekf.P = state[0], cov[0]
    return LiveFeature(number, camera[:2].copy(), heading, ekf, np.full(2, np.nan), np.int8(0), frame, frame)
