"""Landmarks from few, far images at known poses, and from several logs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from localiser.camera import Camera, Mount
from localiser.edges import Edges
from localiser.geometry import Array, robot_from_map
from localiser.mapping import MappingParameters, Sightings
from localiser.mapping.far_images import are_far, build_from_far_images

CAMERA = Camera(640, 480, 554.0, 554.0, 319.5, 239.5, Mount(np.deg2rad(20.0), 0.9))
SIGMA_RAD = 1e-3


def far_poses(count: int, seed: int) -> Array:
    """Return poses (T, 3) all over a room, looking outwards."""
    rng = np.random.default_rng(seed)
    return np.column_stack([rng.uniform(-1, 1, (count, 2)), rng.uniform(-np.pi, np.pi, count)])


def images(places: Array, looks: Array, poses: Array, seed: int, clutter: int = 8) -> list[Edges]:
    """Return the edges of places (L, 2) that look like `looks` (L, 2), and of other things, from poses (T, 3)."""
    rng, frames = np.random.default_rng(seed), []
    for pose in CAMERA.pose_in_map(poses):
        level = robot_from_map(pose, places)
        bearing = np.arctan2(level[:, 0], -level[:, 1])
        seen = (np.abs(bearing) < 0.5) & (rng.random(len(places)) < 0.7)
        bearing = np.concatenate([bearing[seen], rng.uniform(-0.5, 0.5, clutter)])
        bearing += SIGMA_RAD * rng.standard_normal(len(bearing))
        grey = np.concatenate([looks[seen] + rng.normal(0, 4, (seen.sum(), 2)), rng.uniform(30, 220, (clutter, 2))])
        known = np.full(len(bearing), SIGMA_RAD)
        edges = Edges.from_columns(bearing, known, bearing, known)
        polarity = np.sign(grey[:, 1] - grey[:, 0]).astype(np.int8)
        frames.append(replace(edges, profile=np.repeat(grey, [5, 4], axis=1), polarity=polarity))
    return frames


def room(seed: int) -> tuple[Array, Array]:
    """Return 24 places on the walls of a room, and how each looks."""
    rng = np.random.default_rng(seed)
    turn = np.linspace(0, 2 * np.pi, 24, endpoint=False) + rng.uniform(-0.08, 0.08, 24)
    places = 3.0 * np.stack([np.cos(turn), np.sin(turn)], axis=-1) + rng.uniform(-0.3, 0.3, (24, 2))
    left = rng.uniform(30, 220, 24)
    return places, np.stack([left, (left + rng.uniform(50, 140, 24)) % 256], axis=-1)


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
    built, probability = build_from_far_images(sightings, CAMERA.pose_in_map(poses), sigma, MappingParameters())
    kept = built.fit.points[probability > 0.9]
    apart = np.linalg.norm(kept[:, None] - places[None], axis=-1)
    assert (apart.min(axis=0) < 0.03).mean() >= 0.9
    assert (apart.min(axis=1) > 0.1).sum() <= 2


def test_edges_of_nothing_make_no_landmarks() -> None:
    poses = far_poses(40, 3)
    sightings = Sightings.from_edges(images(np.zeros((0, 2)), np.zeros((0, 2)), poses, 4), CAMERA)
    sigma = np.full(len(sightings), SIGMA_RAD)
    _, probability = build_from_far_images(sightings, CAMERA.pose_in_map(poses), sigma, MappingParameters())
    assert (probability > 0.9).sum() <= 2


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
