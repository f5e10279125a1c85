"""The founding paper, reproduced: its tables by our equations, and its motions measured from rendered images."""

from localiser.app.paper.measured import PLACES, steps
from localiser.app.paper.reproduce import Reproduction, reproduce, require_new

__all__ = ["PLACES", "Reproduction", "reproduce", "require_new", "steps"]
