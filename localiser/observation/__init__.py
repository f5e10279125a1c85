"""How well the edges of an image fit a pose: log p(edges | particle)."""

from localiser.observation.angle import Angle
from localiser.observation.edge_observation import (
    GATE_SIGMAS,
    SETTLED,
    EdgeObservation,
    Matches,
    Observation,
    ObservationParameters,
    Targets,
    independent_share,
)
from localiser.observation.endpoint_likelihood import at_border
from localiser.observation.inlier_rate import INLIER_SHARES, MEMORY_FRAMES, PRIOR_FRAMES, InlierShare
from localiser.observation.known_association import IdentifiedObservation, observation_of

__all__ = [
    "GATE_SIGMAS",
    "INLIER_SHARES",
    "MEMORY_FRAMES",
    "PRIOR_FRAMES",
    "SETTLED",
    "Angle",
    "EdgeObservation",
    "IdentifiedObservation",
    "InlierShare",
    "Matches",
    "Observation",
    "ObservationParameters",
    "Targets",
    "at_border",
    "independent_share",
    "observation_of",
]
