"""A robot among posts in a room: coarse bearings, and wheels of any quality, for tests and figures."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from localiser.edges import BearingSensor, Edges, complete
from localiser.geometry import Array, between, compose, wrap_angle
from localiser.mapping import Sightings, Wheels, direction_of

SENSOR = BearingSensor()
CAMERA = SENSOR.camera()
_STATED_RAD, _HALF_VIEW_RAD = np.deg2rad(SENSOR.bearing_sigma_deg), np.deg2rad(SENSOR.half_view_deg)
_TRUE_RAD = np.deg2rad(0.5)
_INTERVAL_S, _SPEED_M_S, _FASTEST_RAD_S = 0.25, 0.12, 0.35
_ROOM_M, _POSTS_M, _POSTS = (2.0, 3.5), (3.0, 4.5), 12
_FOUND, _CLUTTER = 0.7, 0.3  # chance that a post in view is seen; false bearings an image
_SCALES = np.array([1.02, 1.02, 0.99])  # of the wheels, for good
_ALPHA = (0.01, 0.01, 0.003, 0.001)  # turn by turn, turn by path, path by path, path by turn
_LEAST_SIGMA = np.array([1e-3, 1e-3, 5e-4])


@dataclass(frozen=True, slots=True, eq=False)
class CoarseDrive:
    """What was seen and what the wheels said, T images; true poses (T, 3) and true posts (L, 2)."""

    sightings: Sightings
    wheels: Wheels
    truth: Array
    posts: Array


def coarse_drive(seed: int, wheel_error: float, seconds: float = 600.0) -> CoarseDrive:
    """Return a drive from one random goal to the next; wheel_error: 1 is what commanded velocities are off by."""
    rng = np.random.default_rng(seed)
    posts = rng.uniform(-1, 1, (_POSTS, 2)) * _POSTS_M
    truth = _wandering(rng, int(seconds / _INTERVAL_S))
    frames = [_seen(camera, posts, rng) for camera in truth]
    motion = between(truth[:-1], truth[1:])
    path, turn = -motion[:, 1], np.abs(motion[:, 2])
    heading = np.sqrt(_ALPHA[0] * turn + _ALPHA[1] * path)
    ahead = np.sqrt(_ALPHA[2] * path + _ALPHA[3] * turn)
    noise = wheel_error * np.stack([path * heading / 2, ahead, heading], axis=-1)
    sigma = np.hypot(noise, _LEAST_SIGMA)
    measured = motion * _SCALES + sigma * rng.standard_normal(motion.shape)
    return CoarseDrive(
        Sightings.from_edges(frames, CAMERA), Wheels(measured, path, np.eye(3) * sigma[:, None] ** 2), truth, posts
    )


def _wandering(rng: np.random.Generator, images: int) -> Array:
    """Return poses (T, 3) of a robot that turns towards its goal and drives there."""
    poses, goal = [np.zeros(3)], np.array([1.0, -1.0])
    while len(poses) < images:
        offset = goal - poses[-1][:2]
        if np.hypot(*offset) < 0.3:
            goal = rng.uniform(-1, 1, 2) * _ROOM_M
            continue
        error = float(wrap_angle(np.arctan2(-offset[0], -offset[1]) - poses[-1][2]))
        turn = np.clip(error, -_FASTEST_RAD_S, _FASTEST_RAD_S)
        speed = _SPEED_M_S if abs(error) < 0.6 else 0.25 * _SPEED_M_S
        poses.append(compose(poses[-1], np.array([0.0, -speed, turn]) * _INTERVAL_S))
    return np.array(poses)


def _seen(camera: Array, posts: Array, rng: np.random.Generator) -> Edges:
    """Return the bearings of posts in view of a camera (3,), and false ones."""
    heading, _ = direction_of(posts, np.tile(camera, (len(posts), 1)))
    bearing = wrap_angle(camera[2] - heading)
    shown = np.flatnonzero((np.abs(bearing) < _HALF_VIEW_RAD) & (rng.random(len(posts)) < _FOUND))
    false = rng.uniform(-_HALF_VIEW_RAD, _HALF_VIEW_RAD, rng.poisson(_CLUTTER))
    bearings = np.concatenate([bearing[shown] + rng.normal(0, _TRUE_RAD, len(shown)), false])
    unknown = np.full(len(bearings), np.nan)
    columns = complete(bearings, np.full(len(bearings), _STATED_RAD), unknown, unknown, CAMERA.mount.tilt_rad)
    return Edges.from_columns(*columns, landmark_id=np.concatenate([shown, np.full(len(false), -1)]).astype(np.int64))


def matched(places: Array, points: Array) -> Array:
    """Return how far (L,) each place is from the point that is its own; each point is of one place."""
    from scipy.optimize import linear_sum_assignment

    apart = np.linalg.norm(places[:, None] - points[None], axis=-1)
    row, column = linear_sum_assignment(np.minimum(apart, 1.0))
    error = np.full(len(places), np.inf)
    error[row] = apart[row, column]
    return error
