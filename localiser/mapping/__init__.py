"""Build landmark maps: from logs with known poses, from logs alone, and from floor plans."""

from localiser.mapping.align import Alignment, align, matches
from localiser.mapping.ambiguity import ALIKE, Ambiguity, Spot, ambiguity, best_spots
from localiser.mapping.check import ENOUGH, LogFit, doubtful, duplicates, in_view, log_fit
from localiser.mapping.factors import CONSTANTS, Wheels
from localiser.mapping.known import build_from_poses, build_from_votes
from localiser.mapping.landmarks import Built, measured_sigma
from localiser.mapping.live_map import Followed, LiveMap
from localiser.mapping.merge import agreeing, fused, joined_maps
from localiser.mapping.parameters import MappingParameters
from localiser.mapping.plan import MOST_CELLS, FloorPlan, Mask, cells_from_map, map_from_cells
from localiser.mapping.plan_corners import plan_landmarks
from localiser.mapping.quality import landmark_map_of
from localiser.mapping.sightings import Sightings, direction_of, parallax
from localiser.mapping.slam import Slam, build_from_log
from localiser.mapping.tracks import TrackParameters, follow
from localiser.mapping.update import existence_after, with_existence
from localiser.mapping.votes import COARSE_RAD, landmarks_by_votes

__all__ = [
    "ALIKE",
    "COARSE_RAD",
    "CONSTANTS",
    "ENOUGH",
    "MOST_CELLS",
    "Alignment",
    "Ambiguity",
    "Built",
    "FloorPlan",
    "Followed",
    "LiveMap",
    "LogFit",
    "MappingParameters",
    "Mask",
    "Sightings",
    "Slam",
    "Spot",
    "TrackParameters",
    "Wheels",
    "agreeing",
    "align",
    "ambiguity",
    "best_spots",
    "build_from_log",
    "build_from_poses",
    "build_from_votes",
    "cells_from_map",
    "direction_of",
    "doubtful",
    "duplicates",
    "existence_after",
    "follow",
    "fused",
    "in_view",
    "joined_maps",
    "landmark_map_of",
    "landmarks_by_votes",
    "log_fit",
    "map_from_cells",
    "matches",
    "measured_sigma",
    "parallax",
    "plan_landmarks",
    "with_existence",
]
