"""The landmark map, its index by place, and how a landmark is seen from a pose."""

from localiser.landmarks.index import (
    Reach,
    in_view_of_cells,
    kept_with,
    reach_of,
    sigmas_m,
)
from localiser.landmarks.landmark_map import FRAME, LandmarkMap, Quality
from localiser.landmarks.visibility import (
    Sight,
    SightParameters,
    bearing_jacobian,
    by_robot_pose,
    field_of_view_rad,
    half_view_rad,
    image_heights,
    in_camera,
    landmark_ends,
    predicted_lines,
    sight,
    visible_length_px,
    widest_tangent,
)
