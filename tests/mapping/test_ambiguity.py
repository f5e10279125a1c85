"""What looks like what: twins of a building that repeats itself, and the landmark that tells them apart."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from mapping_worlds import world

from localiser.geometry import Array
from localiser.landmarks import LandmarkMap
from localiser.mapping import ALIKE, Ambiguity, best_spots, find_aliasing, find_ambiguity

ALCOVE = np.array([[-1.1, -4.0], [-0.3, -3.0], [0.2, -4.4], [0.9, -3.2], [1.3, -4.1]])
"""Posts that are seen together from the origin, looking along -z."""


def two_alcoves(away: Array) -> LandmarkMap:
    return LandmarkMap.from_points(np.concatenate([ALCOVE, ALCOVE + away]))


def ahead(found: Ambiguity, x: float, z: float) -> int:
    """Return the number of the pose nearest to (x, z, 0)."""
    return int((np.abs(found.poses - [x, z, 0.0]) @ np.ones(3)).argmin())


def places() -> Array:
    return np.stack([part.ravel() for part in np.meshgrid(np.arange(-1, 25, 0.5), [-0.5, 0.0])], axis=-1)


def test_the_same_posts_twice_are_twins_exactly_as_far_apart() -> None:
    """The shift of 20.17 m is no multiple of the grid's step."""
    camera = world("corridor").camera
    found = find_ambiguity(two_alcoves(np.array([20.17, 0.0])), camera, places())
    here = ahead(found, 0.0, 0.0)
    assert found.nats[here] < 0.5
    assert found.twins[here] == pytest.approx([20.17, 0.0, 0.0], abs=0.15)
    assert found.shown[here] == len(ALCOVE)


def test_posts_that_differ_are_no_twins() -> None:
    camera = world("corridor").camera
    other = np.array([[19.5, -3.0], [20.0, -4.0], [20.4, -3.6], [20.6, -4.4]])
    found = find_ambiguity(LandmarkMap.from_points(np.concatenate([ALCOVE, other])), camera, places())
    assert found.nats[ahead(found, 0.0, 0.0)] > ALIKE


def test_polarity_tells_twins_apart() -> None:
    camera = world("corridor").camera
    posts = two_alcoves(np.array([20.17, 0.0]))
    polarity = np.ones(len(posts), dtype=np.int8)
    polarity[len(ALCOVE) :] = -1
    found = find_ambiguity(replace(posts, polarity=polarity), camera, places())
    assert found.nats[ahead(found, 0.0, 0.0)] > ALIKE


def test_a_landmark_at_the_best_spot_parts_the_twins() -> None:
    """What is promised for one more landmark is what a map with it has."""
    camera = world("corridor").camera
    posts = two_alcoves(np.array([20.17, 0.0]))
    view = np.array([[0.0, 0.0], [0.0, -0.3], [20.0, 0.0], [20.0, -0.3]])
    before = find_ambiguity(posts, camera, view)
    spots = np.array([[0.0, -5.0], [10.0, -5.0], [20.0, 5.0]])
    best = best_spots(before, camera, spots, count=1)[0]
    assert best.alike_share < before.alike.mean()
    more = LandmarkMap.from_points(np.concatenate([posts.points, [[best.x, best.z]]]))
    after = find_ambiguity(more, camera, view)
    assert after.alike.mean() == pytest.approx(best.alike_share, abs=0.1)


@pytest.mark.slow  # quick: the other tests of this file
def test_near_a_path_only_what_the_path_reaches_is_looked_at() -> None:
    drive = world("corridor")
    path = drive.truth.poses[:20]
    look = find_aliasing(drive.landmark_map, drive.camera, path)
    apart = np.linalg.norm(look.places[:, None] - path[None, :, :2], axis=-1).min(axis=1)
    assert apart.max() <= 1.5
    assert "% of" in look.text()
    poses, twins = look.examples()
    assert len(poses) == len(twins)


def test_a_post_that_only_the_twin_shows_counts_as_missed() -> None:
    """What it costs is how often a landmark is found: from the twin it should be seen, and is not."""
    camera, away = world("corridor").camera, np.array([20.17, 0.0])
    more = np.array([[-0.8, -3.5]]) + away
    alike, differs = two_alcoves(away), LandmarkMap.from_points(np.concatenate([two_alcoves(away).points, more]))
    nats = []
    for landmark_map in (alike, differs):
        found = find_ambiguity(landmark_map, camera, places())
        nats.append(found.nats[ahead(found, 0.0, 0.0)])
    assert nats[1] - nats[0] == pytest.approx(0.8, abs=0.3)  # found in 0.8 of the cases
