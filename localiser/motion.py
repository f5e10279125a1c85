"""Predict particles from an increment of odometry: Thrun's rotation-translation-rotation model.

The noise grows with the path, as a random walk does, so that it does not depend on how finely the path is cut:
variances add up over a chain of increments. The parameters carry AMCL's names; AMCL's own are per step of a filter
that runs at one fixed rate, these are per metre and per radian.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from pydantic import Field

from localiser.geometry import Array, Increment, compose, wrap_angle
from localiser.particles import Particles


@dataclass(frozen=True, slots=True)
class MotionParameters:
    """How good the odometry is. Each is a variance per unit of path: double the path, double the variance."""

    alpha1: Annotated[float, Field(ge=0, description="heading variance from turning (rad² per rad)")] = 1.2e-3
    alpha2: Annotated[float, Field(ge=0, description="heading variance from driving (rad² per m)")] = 7e-4
    alpha3: Annotated[float, Field(ge=0, description="distance variance from driving (m² per m)")] = 9e-4
    alpha4: Annotated[float, Field(ge=0, description="distance variance from turning (m² per rad)")] = 1e-4


def noise_variances(increment: Increment, parameters: MotionParameters) -> tuple[float, float]:
    """Return the variances (m², rad²) of the distance driven and of the turn made during `increment`.

    Both are 0 for an increment that knows its own covariance.
    """
    if increment.cov.any():
        return 0.0, 0.0
    path, turned = increment.path_m, increment.turned_rad
    distance = parameters.alpha3 * path + parameters.alpha4 * turned
    turn = parameters.alpha1 * turned + parameters.alpha2 * path
    return distance, turn


def direction_of_travel(increment: Increment) -> float:
    """Return the angle (rad) from the robot's forward axis, anticlockwise, along which distance noise acts.

    The chord of the motion, as a line: forward and backward count alike; straight ahead when the robot stood.
    """
    right, backward = increment.mean[:2]
    if np.hypot(right, backward) < 1e-9:
        return float(increment.mean[2] / 2)
    angle = np.arctan2(-right, -backward)
    return float((angle + np.pi / 2) % np.pi - np.pi / 2)


def predict(
    particles: Particles, increment: Increment, parameters: MotionParameters, rng: np.random.Generator
) -> Particles:
    """Return the particles moved by `increment`, each with its own draw of the noise.

    Half of the turn's noise comes before the translation and half after it, so that heading and sideways error are
    correlated as on a wheeled robot [Thrun, Burgard, Fox 2005, table 5.6]. An increment that knows its own covariance
    (vision) errs by a draw from that instead. Bias columns stay as they are.
    """
    count = len(particles)
    distance_var, turn_var = noise_variances(increment, parameters)
    draws = rng.standard_normal((3, count))
    before, after = draws[:2] * np.sqrt(turn_var / 2)
    along = draws[2] * np.sqrt(distance_var)

    direction = direction_of_travel(increment)
    motion = np.empty((count, 3))
    motion[:, 0] = increment.mean[0] - along * np.sin(direction)
    motion[:, 1] = increment.mean[1] - along * np.cos(direction)
    motion[:, 2] = increment.mean[2] + after
    if increment.cov.any():
        variance, axes = np.linalg.eigh(increment.cov)
        motion += (rng.standard_normal((count, 3)) * np.sqrt(np.maximum(variance, 0.0))) @ axes.T

    poses = particles.poses
    poses[:, 2] += before
    columns = particles.columns.copy()
    columns[:3] = compose(poses, motion).T
    columns[2] = wrap_angle(columns[2])
    return Particles(particles.names, columns, particles.log_weight, particles.circular)


def linearised(pose: Array, increment: Increment, parameters: MotionParameters) -> tuple[Array, Array]:
    """Return F = ∂(next pose)/∂(pose) and Q, the covariance of the noise, both (3, 3) in the map, at `pose` (3,).

    The first-order form of `predict`, for the posterior Cramér-Rao bound.
    """
    cos, sin = np.cos(pose[2]), np.sin(pose[2])
    right, backward = increment.mean[:2]
    by_heading = np.array([-sin * right + cos * backward, -cos * right - sin * backward])
    jac_pose = np.eye(3)
    jac_pose[:2, 2] = by_heading
    direction = pose[2] + direction_of_travel(increment)
    distance_var, turn_var = noise_variances(increment, parameters)
    # Columns: distance, turn before, turn after.
    jac_noise = np.array([[-np.sin(direction), by_heading[0], 0], [-np.cos(direction), by_heading[1], 0], [0, 1, 1]])
    noise = jac_noise @ np.diag([distance_var, turn_var / 2, turn_var / 2]) @ jac_noise.T
    to_map = np.array([[cos, sin, 0.0], [-sin, cos, 0.0], [0.0, 0.0, 1.0]])
    return jac_pose, np.asarray(noise + to_map @ increment.cov @ to_map.T)
