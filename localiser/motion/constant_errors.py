"""Constant errors of wheels and mount, estimated with the pose: a Kalman filter inside every particle.

Five errors of a robot stay constant while it drives: the scale of the wheels' distance, the scale of their turn, the
veer (a turn while the wheels measure straight motion), the delay behind its odometry, and the camera's yaw. Given the
path of the camera, they are observed through a linear model with Gaussian noise, so they need not be sampled. A
particle has their mean. Their covariance depends on the odometry alone, so it is the same for all particles
(Rao-Blackwell) [Doucet, de Freitas, Murphy, Russell 2000; Schön, Gustafsson, Nordlund 2005].

    step = (along, left, turn) = odometry + H β + noise,    β = (distance_scale, turn_scale, veer, delay, camera_yaw)

A particle's pose and its mean yaw together are one pose of the *camera*, which is what edges measure. The yaw is the
direction in which the camera is moved, so driving straight ahead determines it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
from pydantic import Field

from localiser.geometry import Array, wrap_angle
from localiser.particles import CAMERA_YAW, Particles, centred, estimate

CONSTANT_ERRORS = ("distance_scale", "turn_scale", "veer", "delay", CAMERA_YAW)


@dataclass(frozen=True, slots=True)
class ConstantErrorParameters:
    """How far wheels and mount may be wrong all the time (one sigma each); 0: not at all."""

    distance_sigma: Annotated[float, Field(ge=0, le=1, description="of the wheels' distance, as a share")] = 0.02
    turn_sigma: Annotated[float, Field(ge=0, le=1, description="of the wheels' turn, as a share")] = 0.03
    veer_sigma_deg_per_m: Annotated[
        float, Field(ge=0, le=90, description="turn of the robot while the wheels say straight on (degrees/m)")
    ] = 0.5
    delay_sigma_s: Annotated[
        float, Field(ge=0, le=1, description="by how much the robot is later, or earlier, than odometry says (s)")
    ] = 0.0
    yaw_sigma_deg: Annotated[float, Field(ge=0, le=90, description="of the camera's stated yaw (degrees)")] = 1.0
    memory_m: Annotated[
        float, Field(gt=0, description="way after which an estimate of them is forgotten: tyres, floors, loads (m)")
    ] = 500.0

    @property
    def cov(self) -> Array:
        """Prior covariance (5, 5) of `CONSTANT_ERRORS`: shares, rad/m, s, rad."""
        veer, yaw = np.deg2rad([self.veer_sigma_deg_per_m, self.yaw_sigma_deg])
        return np.diag(np.square([self.distance_sigma, self.turn_sigma, veer, self.delay_sigma_s, yaw]))


EXACT = ConstantErrorParameters(0.0, 0.0, 0.0, 0.0, 0.0)
"""Of a robot without constant errors."""


def with_constant_errors(particles: Particles, parameters: ConstantErrorParameters) -> Particles:
    """Return particles of poses that a camera was found at, with columns of `CONSTANT_ERRORS` as the prior has them."""
    columns = np.concatenate([particles.columns, np.zeros((len(CONSTANT_ERRORS), len(particles)))])
    return replace(
        particles, names=(*particles.names, *CONSTANT_ERRORS), columns=columns, constant_error_cov=parameters.cov
    )


def at_start(particles: Particles, parameters: ConstantErrorParameters, rng: np.random.Generator) -> Particles:
    """Return particles of stated robot poses, with columns of `CONSTANT_ERRORS` as the prior has them.

    Each pose becomes one of the camera by a draw of the yaw. What is then known of the yaw follows from how wide the
    headings were: all where they are certain, nothing where they go all around.
    """
    found, cloud = with_constant_errors(particles, parameters), estimate(particles)
    yaw_var = parameters.cov[-1, -1]
    share = yaw_var / max(yaw_var + cloud.cov[2, 2], 1e-300)
    camera_heading = particles["heading"] + np.sqrt(yaw_var) * rng.standard_normal(len(particles))
    found.columns[-1] = share * wrap_angle(camera_heading - cloud.mean[2])
    found.columns[2] = wrap_angle(camera_heading - found.columns[-1])
    found.constant_error_cov[-1, -1] *= 1 - share
    return found


@dataclass(frozen=True, slots=True, eq=False)
class StepSpread:
    """What is not known of a step before it is made: covariance H P Hᵀ + noise, as axes (3, 3) and variances (3,)."""

    axes: Array
    variance: Array

    @property
    def root(self) -> Array:
        """S^½ (3, 3): a step is its mean plus this times three standard normal draws."""
        return np.asarray(self.axes * np.sqrt(np.maximum(self.variance, 0.0)))

    @property
    def whitened(self) -> Array:
        """S^(-½) (3, 3), 0 along directions in which nothing can happen."""
        floor = 1e-14 * self.variance[-1]
        return np.asarray(self.axes / np.sqrt(np.where(self.variance > floor, self.variance, np.inf)))


def projected(particles: Particles) -> Particles:
    """Return the particles with constant errors whose means are linear in the camera's pose.

    What is lost widens their covariance. Mean and covariance of poses and constant errors together stay as they are, so
    nothing is lost where they are normal. It keeps what is known of constants from depending on which of many past
    paths happened to survive resampling.
    """
    _, residual, weight = centred(particles)
    pose, bias = residual[:3].copy(), residual[3:]
    if CAMERA_YAW in particles.names:
        pose[2] += residual[particles.names.index(CAMERA_YAW)]
    pose_cov = (pose * weight) @ pose.T
    # In units of their spread, so that metres and radians are cut off alike.
    unit = np.sqrt(np.maximum(np.diag(pose_cov), 1e-300))
    variance, axes = np.linalg.eigh(pose_cov / np.outer(unit, unit))
    axes /= np.sqrt(np.where(variance > 1e-9 * variance[-1], variance, np.inf)) * unit[:, None]
    inverse = axes @ axes.T
    rest = (bias * weight) @ pose.T @ inverse @ pose
    rest -= bias
    lost = (rest * weight) @ rest.T
    return replace(_moved(particles, rest), constant_error_cov=particles.constant_error_cov + lost)


def forgotten(particles: Particles, path_m: float, parameters: ConstantErrorParameters) -> Particles:
    """Return the particles after a way, with constant errors that drifted: an Ornstein-Uhlenbeck process."""
    if particles.names[3:] != CONSTANT_ERRORS or path_m == 0:
        return particles
    kept = np.exp(-path_m / parameters.memory_m)
    drifted = _moved(particles, (kept - 1) * particles.columns[3:])
    return replace(drifted, constant_error_cov=kept**2 * particles.constant_error_cov + (1 - kept**2) * parameters.cov)


def _moved(particles: Particles, change: Array) -> Particles:
    """Return the particles with other constant errors (B, N), the camera's heading being as it was."""
    columns = particles.columns.copy()
    columns[3:] += change
    if CAMERA_YAW in particles.names:
        columns[2] = wrap_angle(columns[2] - change[particles.names.index(CAMERA_YAW) - 3])
    return replace(particles, columns=columns)
