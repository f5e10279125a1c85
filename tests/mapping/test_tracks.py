"""The compiled loop that follows edges against filterpy's Kalman filters and plain arrays; the best assignment."""

from __future__ import annotations

import numpy as np
import pytest
from filterpy.kalman import ExtendedKalmanFilter
from mapping_worlds import with_looks, world

from localiser import mapping
from localiser.geometry import Array, forward, wrap_angle
from localiser.mapping.sightings import Index, Sightings
from localiser.mapping.tracks import TrackParameters, assign, association_scores, looks_alike


class Track:
    """One edge by filterpy: its heading, and the inverse of its distance, from where it was seen first."""

    def __init__(self, number: int, sighting: int, camera: Array, heading: float, sigma: float, nearest_m: float):
        self.number, self.last, self.missed, self.origin = number, sighting, 0, camera[:2]
        self.filter, inverse = ExtendedKalmanFilter(dim_x=2, dim_z=1), 1 / (3 * nearest_m)
        self.filter.x, self.filter.P = np.array([heading, inverse]), np.diag([sigma**2, inverse**2])

    def heading(self, state: Array, camera: Array) -> Array:
        """Return the heading (1,) under which the camera (3,) sees an edge of this state (2,)."""
        x, z = forward(state[0]) + state[1] * (self.origin - camera[:2])
        return np.array([np.arctan2(-x, -z)])

    def by_state(self, state: Array, camera: Array) -> Array:
        """Return the derivative (1, 2) of that, by the angle between the ray and how it moves."""
        ray = forward(state[0]) + state[1] * (self.origin - camera[:2])
        moves = np.array([forward(state[0] + np.pi / 2), self.origin - camera[:2]])
        return ((moves[:, 0] * ray[1] - moves[:, 1] * ray[0]) / (ray @ ray))[None]

    def expected(self, camera: Array) -> tuple[float, float]:
        """Return the heading of the edge, and its variance."""
        jacobian = self.by_state(self.filter.x, camera)
        return self.heading(self.filter.x, camera)[0], (jacobian @ self.filter.P @ jacobian.T)[0, 0]

    def see(self, sighting: int, camera: Array, heading: float, sigma: float) -> None:
        """Take in an image that shows the edge."""
        self.filter.update(
            np.array([heading]),
            lambda state: self.by_state(state, camera),
            lambda state: self.heading(state, camera),
            R=np.array([[sigma**2]]),
            residual=lambda one, other: wrap_angle(one - other),
        )
        self.filter.x[1] = max(self.filter.x[1], 0.0)
        self.last, self.missed = sighting, 0


def followed(
    sightings: Sightings, cameras: Array, pose_sigma_rad: Array, parameters: TrackParameters, margin: float
) -> Index:
    """Return the track (S,) of each sighting, as `follow` should."""
    track, alive, count = np.full(len(sightings), -1, dtype=np.int64), [], 0
    side, polarity = sightings.side, sightings.polarity
    for frame, camera in enumerate(cameras):
        seen = np.arange(sightings.first[frame], sightings.first[frame + 1])
        heading, sigma = camera[2] - sightings.bearing[seen], np.hypot(sightings.sigma[seen], pose_sigma_rad[frame])
        pairs: dict[int, Track] = {}
        if len(seen) and alive:
            expected, own = np.array([each.expected(camera) for each in alive]).T
            last = np.array([each.last for each in alive])
            looks = looks_alike(side[last, None], polarity[last, None], side[seen], polarity[seen])
            row, column = assign(association_scores(expected, own, heading, sigma, looks, parameters), margin)
            pairs = {int(edge): alive[k] for k, edge in zip(row, column, strict=True)}
        for each in alive:
            each.missed += 1
        alive = [each for each in alive if each.missed <= parameters.missed_most or each in pairs.values()]
        for edge, sighting in enumerate(seen.tolist()):
            if edge in pairs:
                pairs[edge].see(sighting, camera, heading[edge], sigma[edge])
            else:
                pairs[edge] = Track(count, sighting, camera, heading[edge], sigma[edge], parameters.nearest_m)
                alive.append(pairs[edge])
                count += 1
            track[sighting] = pairs[edge].number
    return track


@pytest.mark.parametrize("margin", [0.0, 3.0])
@pytest.mark.parametrize("looking", [True, False])
def test_tracks_are_those_of_plain_arrays(margin: float, looking: bool) -> None:
    drive, parameters = world("office"), TrackParameters(missed_most=3)
    edges = drive.edges(0, clutter=8.0)[:300]
    edges[40] = edges[40].take(np.arange(0))
    if looking:
        edges = with_looks(edges, len(drive.landmark_map), 0)
    sightings = Sightings.from_edges(edges, drive.camera)
    cameras = drive.camera.pose_in_map(drive.truth.poses[:300])
    sigma = np.full(len(cameras), 0.01)
    expected = followed(sightings, cameras, sigma, parameters, margin)
    assert expected.max() > 500
    np.testing.assert_array_equal(mapping.follow(sightings, cameras, sigma, parameters, margin), expected)


def test_a_match_that_another_rivals_is_left_out_where_a_margin_is_asked_for() -> None:
    score = np.array([[9.0, 8.0, -np.inf], [-np.inf, -np.inf, 4.0], [-np.inf, -np.inf, -np.inf]])
    assert [pair.tolist() for pair in assign(score)] == [[0, 1], [0, 2]]
    assert [pair.tolist() for pair in assign(score, margin=3.0)] == [[1], [2]]
