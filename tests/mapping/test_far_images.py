"""Landmarks from few, far images at known poses, and from several logs."""

from __future__ import annotations

import numpy as np
import pytest
from far_room import CAMERA, SIGMA_RAD, far_poses, images, room

from localiser.mapping import MappingParameters, Sightings, landmark_map_of
from localiser.mapping.known_poses import POSE_SIGMA_RAD, are_far, build_from_far_images


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
    for name in ("first", "frame", "bearing", "polarity", "side", "profile"):
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
