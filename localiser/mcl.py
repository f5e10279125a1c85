"""Monte Carlo localisation: predict → weigh → resample → estimate."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from localiser.edges import Edges
from localiser.geometry import Array, Increment
from localiser.particles import Estimate, Particles

# -- events: what a source yields, in the order of time ---------------------------------------------------------------


@dataclass(frozen=True, slots=True, eq=False)
class Start:
    """Where the robot is said to be: pose (3,) in the map and its covariance (3, 3)."""

    t_ns: int
    mean: Array
    cov: Array


@dataclass(frozen=True, slots=True, eq=False)
class Odometry:
    """A pose (3,) in the odometry's own frame; only increments between two of them count."""

    t_ns: int
    pose: Array


@dataclass(frozen=True, slots=True, eq=False)
class Sighting:
    """The edges of the image taken at this time."""

    t_ns: int
    edges: Edges


Event = Start | Odometry | Sighting


@dataclass(frozen=True, slots=True, eq=False)
class Located:
    """What the filter knows after one image.

    estimate: from the weighted particles, before resampling. particles: those it was computed from.
    ess: effective sample size. increment: motion since the last image. odometry: odometry's pose (3,) at the image.
    """

    t_ns: int
    estimate: Estimate
    particles: Particles
    ess: float
    edges: Edges
    increment: Increment
    odometry: Array = field(default_factory=lambda: np.full(3, np.nan))
