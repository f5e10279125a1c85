"""The landmark map, its index by place, and how a landmark is seen from a pose."""

from localiser.landmarks.landmark_map import FRAME, LandmarkMap, Quality, in_view_of_cells_loop, kept_with, reach_of
from localiser.landmarks.visibility import (
    SightParameters,
    field_of_view_rad,
    half_view_rad,
    image_heights,
    in_camera,
    landmark_ends,
    predicted_lines,
    sight,
    widest_tangent,
)
