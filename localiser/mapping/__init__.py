"""Build landmark maps: from logs with known poses, and from logs alone."""

from localiser.mapping.factors import CONSTANTS, Wheels
from localiser.mapping.known import build_from_poses
from localiser.mapping.landmarks import Built, measured_sigma
from localiser.mapping.parameters import MappingParameters
from localiser.mapping.quality import landmark_map_of
from localiser.mapping.sightings import Sightings, direction_of, parallax
from localiser.mapping.slam import Slam, build_from_log
from localiser.mapping.tracks import TrackParameters, follow

__all__ = [
    "CONSTANTS",
    "Built",
    "MappingParameters",
    "Sightings",
    "Slam",
    "TrackParameters",
    "Wheels",
    "build_from_log",
    "build_from_poses",
    "direction_of",
    "follow",
    "landmark_map_of",
    "measured_sigma",
    "parallax",
]
