"""A map that grows while the robot drives: an extended Kalman filter for each landmark, edges associated by gates.

In every image, edges are associated with the features that are being tracked. The remaining edges begin new features. A
feature begins with the inverse-depth model and becomes a landmark, a point, when bearings from positions far enough
apart determine its place, and when it is likelier an edge than clutter. Landmarks that are out of sight are not matched
with single edges, because a single edge often matches some landmark by chance. Instead, a new feature at the place of
an old landmark, with a similar appearance, is that landmark seen again.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from localiser.camera import Camera
from localiser.edges import Edges
from localiser.geometry import Array, forward, wrap_angle
from localiser.landmarks import LandmarkMap, Quality
from localiser.mapping.landmarks import measured_sigma
from localiser.mapping.sightings import Index, Sightings, direction_of, per_point
from localiser.mapping.tracks import MappingParameters, assign, association_scores, first_state, looks_alike, predicted

# -- one feature ------------------------------------------------------------------------------------------------------

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


# -- the map ----------------------------------------------------------------------------------------------------------

_MOST_EVIDENCE = 30.0  # log-odds beyond which nothing changes in what is printed
_UNLIKE = -3.0  # log-likelihood ratio of looks below which two features are not one edge
_ONE_SIGN = 0.6  # four of five sightings show an edge that has a polarity with that one
_WELL_INSIDE = 0.9  # share of the image's width in which an edge is expected to be found


@dataclass(frozen=True, slots=True, eq=False)
class Followed:
    """What became of the edges (E) of one image: number of the feature that each shows, whether it is a landmark."""

    feature: Index
    is_landmark: NDArray[np.bool_]


@dataclass(frozen=True, slots=True, eq=False)
class _View:
    """One image: camera (3,) in the map, its edges (E), headings (E,) in the map and their sigmas."""

    camera: Array
    edges: Edges
    side: Array
    heading: Array
    sigma: Array

    def __len__(self) -> int:
        return len(self.heading)


class LiveMap:
    """Landmarks that become known image by image, seen from poses that are known.

    What is kept grows with the landmarks, not with the images; no landmark moves another one.
    """

    def __init__(self, camera: Camera, parameters: MappingParameters) -> None:
        self._camera, self._parameters = camera, parameters
        self._half_view_rad = float(np.arctan(camera.width / 2 / camera.focal_px))
        self._followed: list[LiveFeature] = []
        self._landmarks: list[LiveFeature] = []
        self._frame, self._begun = 0, 0

    def __len__(self) -> int:
        return len(self._landmarks)

    @property
    def points(self) -> Array:
        """Where the landmarks (L, 2) are, in the order in which they were found."""
        return np.array([feature.filter.x for feature in self._landmarks]).reshape(-1, 2)

    @property
    def cov(self) -> Array:
        """Their covariances (L, 2, 2) m²."""
        return np.array([feature.filter.P for feature in self._landmarks]).reshape(-1, 2, 2)

    @property
    def numbers(self) -> Index:
        """The number (L,) by which `Followed` calls each."""
        return np.array([feature.number for feature in self._landmarks], dtype=np.int64)

    def step(self, pose: Array, edges: Edges, turn_sigma_rad: float = 0.0) -> Followed:
        """Take in the edges (E) of one image, seen by a robot at `pose` (3,) in the map.

        turn_sigma_rad: error of the turn since the image before, as far as it is known.
        """
        view = self._view(pose, edges, turn_sigma_rad)
        row, column, score = self._matched(view)
        self._expect(view.camera, score, row)
        shows = {int(edge): self._followed[k] for k, edge in zip(row, column, strict=True)}
        for edge, feature in shows.items():
            feature.see(view.camera, float(view.heading[edge]), float(view.sigma[edge]))
        fresh = {edge: self._begin(view, edge) for edge in range(len(view)) if edge not in shows}
        shows |= fresh
        for edge, feature in shows.items():
            self._note(view, edge, feature)
        lost = self._frame - self._parameters.tracks.missed_most
        self._followed = [feature for feature in (*self._followed, *fresh.values()) if feature.last >= lost]
        again = self._promoted()
        self._frame += 1
        features = [again.get(shows[edge].number, shows[edge]) for edge in range(len(view))]
        numbers = np.array([feature.number for feature in features], dtype=np.int64)
        return Followed(numbers, np.array([feature.is_point for feature in features], dtype=bool))

    def landmark_map(self, name: str, source: str) -> LandmarkMap:
        """Return the landmarks as a map: places, covariances and quality; heights and profiles are not known."""
        found, count = self._landmarks, len(self._landmarks)
        sightings = np.array([feature.count for feature in found], dtype=np.float64)
        evidence = np.array([feature.evidence for feature in found])
        signs = np.array([feature.signs for feature in found], dtype=np.float64)
        parallax = np.array([feature.parallax for feature in found])
        return replace(
            LandmarkMap.from_points(self.points, name=name, source=source),
            cov=self.cov,
            polarity=np.where(np.abs(signs) > _ONE_SIGN * sightings, np.sign(signs), 0).astype(np.int8),
            quality=Quality(sightings, parallax, 1 / (1 + np.exp(-evidence)), np.zeros((count, 0))),
        )

    def _view(self, pose: Array, edges: Edges, turn_sigma_rad: float) -> _View:
        camera = self._camera.pose_in_map(pose)
        seen = Sightings.from_edges([edges], self._camera)
        sigma = np.hypot(measured_sigma(seen, self._camera.focal_px, self._parameters), turn_sigma_rad)
        return _View(camera, edges, seen.side, wrap_angle(camera[2] - seen.bearing), sigma)

    def _matched(self, view: _View) -> tuple[Index, Index, Array]:
        """Return which followed feature (row) shows in which edge (column), and by how much that is likelier.

        Likelier than the feature being missed, and the edge being of something new, anywhere in view.
        """
        none = np.zeros(0, dtype=np.int64)
        if not self._followed or not len(view):
            return none, none, np.zeros(0)
        followed = self._followed
        expected, own = np.array([feature.predicted(view.camera) for feature in followed]).T
        sides = np.array([feature.side for feature in followed])
        signs = np.array([feature.polarity for feature in followed])
        looks = looks_alike(sides[:, None], signs[:, None], view.side, view.edges.polarity)
        score = association_scores(expected, own, view.heading, view.sigma, looks, self._parameters.tracks)
        row, column = assign(score)
        return row, column, score[row, column]

    def _expect(self, camera: Array, score: Array, row: Index) -> None:
        """Weigh for each followed feature whether it was found in the image [Blackman, Popoli 1999, ch. 6]."""
        gain = np.zeros(len(self._followed))
        gain[row] = score
        missed = np.log(1 - self._parameters.tracks.found)
        for number, feature in enumerate(self._followed):
            bearing = wrap_angle(camera[2] - feature.predicted(camera)[0])
            if gain[number] > 0 or abs(bearing) < _WELL_INSIDE * self._half_view_rad:
                feature.evidence = min(feature.evidence + missed + gain[number], _MOST_EVIDENCE)

    def _begin(self, view: _View, edge: int) -> LiveFeature:
        self._begun += 1
        nearest_m = self._parameters.tracks.nearest_m
        heading, sigma = float(view.heading[edge]), float(view.sigma[edge])
        return started(self._begun - 1, view.camera, heading, sigma, nearest_m, self._frame)

    def _note(self, view: _View, edge: int, feature: LiveFeature) -> None:
        """Keep how the feature looks in this image."""
        edges = view.edges
        feature.last, feature.side, feature.polarity = self._frame, view.side[edge], edges.polarity[edge]
        feature.signs += int(edges.polarity[edge])

    def _promoted(self) -> dict[int, LiveFeature]:
        """Make landmarks of what is known well enough; return by their numbers those that are landmarks seen again."""
        again: dict[int, LiveFeature] = {}
        for number, feature in enumerate(self._followed):
            if feature.is_point or not self._is_known(feature):
                continue
            feature.become_point()
            old = self._same(feature)
            if old is None:
                self._landmarks.append(feature)
                continue
            old.join(feature, self._parameters.plumb_sigma_m)
            self._followed[number] = again[feature.number] = old
        return again

    def _is_known(self, feature: LiveFeature) -> bool:
        parameters = self._parameters
        likely = np.log(parameters.existence_min / (1 - parameters.existence_min))
        return (
            feature.count >= parameters.sightings_min
            and feature.evidence >= likely
            and feature.parallax >= np.deg2rad(parameters.parallax_min_deg)
            and feature.is_near_enough_gaussian
            and feature.distance_m <= parameters.range_max_m
        )

    def _same(self, feature: LiveFeature) -> LiveFeature | None:
        """Return the landmark, lost from sight before the feature came, that stands where it does and looks alike."""
        extra = feature.filter.P + self._parameters.plumb_sigma_m**2 * np.eye(2)
        nearest, best = self._parameters.tracks.gate_sigma**2, None
        for old in self._landmarks:
            distance2 = old.distance2(feature.filter.x, extra) if old.last < feature.begun else np.inf
            looks = looks_alike(old.side, old.polarity, feature.side, feature.polarity)
            if distance2 < nearest and looks > _UNLIKE:
                nearest, best = distance2, old
        return best
