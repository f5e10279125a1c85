"""Edges of two frames → how the robot moved between them ([Taylor06] section 3), alone or together with wheels."""

from localiser.increments.estimate import Belief, Followed, Frames, follow
from localiser.increments.odometer import Odometer
from localiser.increments.parameters import IncrementParameters
from localiser.increments.twist import Gaussian

__all__ = ["Belief", "Followed", "Frames", "Gaussian", "IncrementParameters", "Odometer", "follow"]
