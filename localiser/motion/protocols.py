"""Protocols of motion models: predict particles, and optional abilities.

The filter asks for each optional ability with `isinstance` and runs without it where it is missing.
"""

from __future__ import annotations

from typing import Protocol, runtime_checkable

import numpy as np

from localiser.geometry import Array, Increment
from localiser.motion.odometry_model import Step
from localiser.particles import Particles


@runtime_checkable
class MotionModel(Protocol):
    """Anything that moves particles by an increment."""

    def predict(self, particles: Particles, increment: Increment, rng: np.random.Generator) -> Particles:
        """Return the particles moved by `increment`, each with its own draw of the noise."""
        ...


@runtime_checkable
class LinearisedMotion(MotionModel, Protocol):
    """A model whose noise is normal, so that the optimal proposal can draw steps from odometry and edges together."""

    def expected_step(self, particles: Particles, increment: Increment) -> Step:
        """Return where particles are expected, and the derivatives of that by the standardised step."""
        ...

    def stepped(self, particles: Particles, step: Step, normal: Array, increment: Increment) -> Particles:
        """Return the particles after standardised steps (3, N)."""
        ...


@runtime_checkable
class MotionCovariance(MotionModel, Protocol):
    """A model that can say how certain odometry is, which visual odometry and persistent clutter use."""

    def covariance(self, increment: Increment) -> Array:
        """Return the covariance (3, 3) of a motion in the robot frame, constant errors included."""
        ...


@runtime_checkable
class EstimatesConstantErrors(MotionModel, Protocol):
    """A model whose particles carry constant errors of wheels and mount in columns of their own."""

    @property
    def delay_sigma_s(self) -> float:
        """By how much the robot may be later than its odometry, one sigma."""
        ...

    def at_start(self, particles: Particles, rng: np.random.Generator) -> Particles:
        """Return particles of stated robot poses with the columns of the constant errors."""
        ...

    def with_constant_errors(self, particles: Particles) -> Particles:
        """Return particles of poses that a camera was found at with the columns of the constant errors."""
        ...


def covariance_of(model: MotionModel, increment: Increment) -> Array:
    """Return the covariance (3, 3) of a motion as the model has it, else as the increment states it."""
    return model.covariance(increment) if isinstance(model, MotionCovariance) else increment.cov
