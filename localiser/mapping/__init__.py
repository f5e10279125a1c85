"""Build landmark maps: from logs with known poses, from logs alone, and from floor plans."""

from localiser.mapping.alignment import Alignment, align, matches
from localiser.mapping.build import BuildWatch, MapBuilt, build_map
from localiser.mapping.build_together import build_map_together
from localiser.mapping.check import (
    ENOUGH,
    Coverage,
    LogFit,
    coverage,
    doubtful,
    fit_to_log,
    in_view,
    log_fit,
)
from localiser.mapping.coarse_bearings import landmarks_of_coarse_bearings
from localiser.mapping.factors import Prior, Wheels
from localiser.mapping.from_known_poses import build_from_coarse, build_from_poses
from localiser.mapping.landmarks import Built, measured_sigma
from localiser.mapping.live_map import LiveMap
from localiser.mapping.log_edges import cache_folder, edges_of_log
from localiser.mapping.mappable import require_association, turn_drift
from localiser.mapping.merge import agreeing, common_landmarks, duplicates, fuse_maps, join_maps, merge_duplicates
from localiser.mapping.parameters import MappingParameters
from localiser.mapping.plan import MOST_CELLS, FloorPlan, Mask, cells_from_map, map_from_cells
from localiser.mapping.plan_corners import plan_landmarks
from localiser.mapping.quality import landmark_map_of
from localiser.mapping.recorded import known_poses, wheels_of
from localiser.mapping.sightings import Sightings, direction_of, parallax
from localiser.mapping.slam import Slam, build_from_log
from localiser.mapping.tracks import follow
from localiser.mapping.update import update_map
