"""Edges of two frames → how the robot moved between them ([Taylor06] section 3), alone or together with wheels."""

from localiser.increments.estimate import Followed, follow
from localiser.increments.odometer import Odometer
from localiser.increments.parameters import IncrementParameters
from localiser.increments.solve import Gaussian

__all__ = ["Followed", "Gaussian", "IncrementParameters", "Odometer", "follow"]
