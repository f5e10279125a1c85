"""Image → vertical edges: find segments, keep those that meet the nadir point, measure them."""

from localiser.edges.find import DETECTORS, find_edges, warm_up
from localiser.edges.parameters import EdgeParameters
from localiser.edges.types import CommonError, Edges

__all__ = ["DETECTORS", "CommonError", "EdgeParameters", "Edges", "find_edges", "warm_up"]
