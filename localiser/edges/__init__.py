"""Image → vertical edges: find segments, keep those that meet the nadir point, measure them."""

from localiser.edges.types import CommonError, Edges

__all__ = ["CommonError", "Edges"]
