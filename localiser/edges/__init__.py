"""Image → vertical edges: find segments, keep those that meet the nadir point, measure them."""

from localiser.edges.bearings import BearingSensor, complete
from localiser.edges.find import DETECTORS, find_edges, warm_up
from localiser.edges.measure import FOOT_SIGMA_PX, foot_of_edges
from localiser.edges.mount import mount_error_of_edges
from localiser.edges.parameters import EdgeParameters
from localiser.edges.profile import PROFILE_OFFSETS_PX
from localiser.edges.types import CommonError, Edges

__all__ = [
    "DETECTORS",
    "FOOT_SIGMA_PX",
    "PROFILE_OFFSETS_PX",
    "BearingSensor",
    "CommonError",
    "EdgeParameters",
    "Edges",
    "complete",
    "find_edges",
    "foot_of_edges",
    "mount_error_of_edges",
    "warm_up",
]
