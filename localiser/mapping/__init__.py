"""Build landmark maps: from logs with known poses, from logs alone, and from floor plans."""

from localiser.mapping.build import BUILDERS, COARSE_RAD, Builder, MapBuilt, build_map
from localiser.mapping.check import ENOUGH, Coverage, coverage, in_view, update_map
from localiser.mapping.factors import Prior, Steps
from localiser.mapping.known_poses import build_from_poses
from localiser.mapping.landmarks import Built, fit_landmarks, long_enough, measured_sigma, renumber
from localiser.mapping.merge import (
    Alignment,
    agreeing,
    align,
    common_landmarks,
    duplicates,
    fuse_maps,
    join_maps,
    matches,
    merge_duplicates,
)
from localiser.mapping.plan import MOST_CELLS, FloorPlan, Mask, map_from_cells, plan_landmarks
from localiser.mapping.quality import landmark_map_of
from localiser.mapping.recorded import default_poses, edges_of_log, known_poses, start_on_map, wheels_of
from localiser.mapping.sightings import Index, Sightings, direction_of
from localiser.mapping.slam import Slam, build_from_log
from localiser.mapping.tracks import MappingParameters, follow
