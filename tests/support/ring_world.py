"""A drive round a ring of landmarks, with wrong wheels and a wrong mount."""

from dataclasses import replace

import numpy as np

from localiser.camera import Camera, Mount
from localiser.geometry import Array, between, compose, robot_from_map
from localiser.mapping import Prior, Steps
from localiser.mapping.factors import Bearings, Problem
from localiser.motion import MotionParameters

CAMERA = Camera(
    640, 480, 554.0, 554.0, 319.5, 239.5, Mount(np.deg2rad(20.0), 0.9, yaw_rad=0.03, right_m=0.02, back_m=-0.1)
)
CONSTANTS = np.array([0.04, -0.02, 0.01, 0.005])


def circle(noise: float, seed: int = 0, frames: int = 80, laps: int = 1) -> tuple[Problem, Array, Array]:
    """Return a drive round a ring of landmarks with wrong wheels and a wrong mount, true poses, and true landmarks."""
    rng = np.random.default_rng(seed)
    angle = np.linspace(0, 2 * np.pi * laps, frames)
    poses = np.stack([2 - 2 * np.cos(angle), -2 * np.sin(angle), -angle], axis=-1)
    poses = compose(np.zeros(3), between(poses[:1], poses))
    around = rng.uniform(0, 2 * np.pi, 30)
    points = np.array([2.0, 0.0]) + rng.uniform(3, 5, 30)[:, None] * np.stack([np.cos(around), np.sin(around)], axis=-1)
    motion = between(poses[:-1], poses[1:])
    path = np.hypot(motion[:, 0], motion[:, 1])
    measured = motion * [1 + CONSTANTS[0], 1 + CONSTANTS[0], 1 + CONSTANTS[1]]
    measured[:, 2] += path * CONSTANTS[2]
    sigma = np.tile([2e-3, 5e-3, 4e-3], (frames - 1, 1))
    wheels = Steps(measured + noise * sigma * rng.standard_normal(sigma.shape), path, np.eye(3) * sigma[:, None] ** 2)
    turned = CAMERA.with_mount(yaw_rad=CAMERA.mount.yaw_rad + CONSTANTS[3])
    frame, landmark = (index.ravel() for index in np.indices((frames, 30)))
    level = robot_from_map(turned.pose_in_map(poses)[frame], points[landmark])
    bearing = np.arctan2(level[:, 0], -level[:, 1])
    seen = np.abs(bearing) < 0.5
    error = noise * 1e-3 * rng.standard_normal(seen.sum())
    bearings = Bearings(frame[seen], landmark[seen], bearing[seen] + error, np.full(seen.sum(), 1e-3))
    prior = Prior.of(MotionParameters())
    known = replace(prior, mean=np.array([CONSTANTS[0], 0, 0, 0]), sigma=np.array([1e-4, *prior.sigma[1:]]))
    return Problem(wheels, bearings, np.tile(CAMERA.robot_from_level, (frames, 1)), known), poses, points
