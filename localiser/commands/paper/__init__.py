"""The founding paper, reproduced: its tables by our equations, and its motions measured from rendered images."""

from localiser.commands.paper.measured import steps
from localiser.commands.paper.reproduce import Reproduction, reproduce

__all__ = ["Reproduction", "reproduce", "steps"]
