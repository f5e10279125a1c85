"""Landmarks from few, far images at known poses and from several logs; how edges are followed, against filterpy."""

import numpy as np
import pytest
from far_room import CAMERA, SIGMA_RAD, far_poses, images, room
from filterpy.kalman import ExtendedKalmanFilter
from mapping_worlds import with_looks, world

from localiser import mapping
from localiser.geometry import Array, forward, wrap_angle
from localiser.mapping import MappingParameters, Sightings, landmark_map_of
from localiser.mapping.known_poses import POSE_SIGMA_RAD, are_far, build_from_far_images
from localiser.mapping.sightings import Index
from localiser.mapping.tracks import TrackParameters, assign, association_scores, looks_alike


def test_images_apart_are_far_and_those_of_a_drive_are_not() -> None:
    assert are_far(far_poses(30, 0))
    drive = np.column_stack([np.zeros(30), -0.05 * np.arange(30), np.zeros(30)])
    assert not are_far(drive)
    assert not are_far(drive[:1])


def test_places_are_found_where_no_edge_can_be_followed() -> None:
    places, looks = room(0)
    poses = far_poses(90, 1)
    sightings = Sightings.from_edges(images(places, looks, poses, 2), CAMERA)
    sigma = np.full(len(sightings), SIGMA_RAD)
    built, probability = build_from_far_images([CAMERA.pose_in_map(poses)], sightings, sigma, MappingParameters())
    kept = built.fit.points[probability > 0.9]
    apart = np.linalg.norm(kept[:, None] - places[None], axis=-1)
    assert (apart.min(axis=0) < 0.03).mean() >= 0.9
    assert (apart.min(axis=1) > 0.1).sum() <= 2


def test_two_logs_together_are_as_one() -> None:
    places, looks = room(5)
    poses = far_poses(40, 6)
    frames = images(places, looks, poses, 7)
    whole = Sightings.from_edges(frames, CAMERA)
    parts = [Sightings.from_edges(frames[:15], CAMERA), Sightings.from_edges(frames[15:], CAMERA)]
    together = Sightings.together(parts, [CAMERA, CAMERA])
    for name in ("first", "frame", "bearing", "polarity", "side"):
        np.testing.assert_array_equal(getattr(together, name), getattr(whole, name))
    assert together.mounts == (CAMERA.mount,) * 40


@pytest.mark.slow
def test_landmarks_are_as_far_off_as_their_covariance_says() -> None:
    """At headings that are off as true ones are: the median error is what the covariance tells, to 30 %."""
    normalised = []
    for seed in (10, 20):
        places, looks = room(seed)
        poses = far_poses(90, seed + 1)
        frames = images(places, looks, poses, seed + 2)
        stated = poses + np.random.default_rng(seed + 3).normal(0, [0, 0, POSE_SIGMA_RAD], poses.shape)
        sightings, cameras = Sightings.from_edges(frames, CAMERA), CAMERA.pose_in_map(stated)
        sigma, parameters = np.full(len(sightings), SIGMA_RAD), MappingParameters(place_sigma_m=0.0)
        built, probability = build_from_far_images([cameras], sightings, sigma, parameters)
        made = landmark_map_of(
            sightings, built, cameras, sigma, CAMERA, parameters, "room", "test", probability=probability
        )
        apart = np.linalg.norm(made.points[:, None] - places[None], axis=-1)
        found = apart.min(axis=1) < 0.1
        offset = (made.points - places[apart.argmin(axis=1)])[found]
        normalised.append(np.einsum("li,lij,lj->l", offset, np.linalg.inv(made.cov[found]), offset))
    honesty = np.sqrt(np.median(np.concatenate(normalised)) / (2 * np.log(2)))
    assert 0.75 < honesty < 1.3


def test_edges_of_nothing_make_no_landmarks() -> None:
    poses = far_poses(40, 3)
    sightings = Sightings.from_edges(images(np.zeros((0, 2)), np.zeros((0, 2)), poses, 4), CAMERA)
    sigma = np.full(len(sightings), SIGMA_RAD)
    _, probability = build_from_far_images([CAMERA.pose_in_map(poses)], sightings, sigma, MappingParameters())
    assert (probability > 0.9).sum() <= 2


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
