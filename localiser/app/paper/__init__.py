"""The founding paper, reproduced: its tables by our equations, and its motions measured from rendered images."""

from localiser.app.paper.measured import steps
from localiser.app.paper.reproduce import Reproduction, reproduce

__all__ = ["Reproduction", "reproduce", "steps"]
