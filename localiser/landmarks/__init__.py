"""The landmark map, its index by place, and how a landmark is seen from a pose."""

from localiser.landmarks.image_lines import landmark_ends, predicted_lines
from localiser.landmarks.index import CELL_M, HEADINGS, LandmarkIndex, in_view_of_cells
from localiser.landmarks.landmark_map import FRAME, LandmarkMap, Quality
from localiser.landmarks.reach import Reach, kept_with, reach_of, sigmas_m
from localiser.landmarks.visibility import (
    Sight,
    SightParameters,
    bearing_jacobian,
    by_robot_pose,
    field_of_view_rad,
    half_view_rad,
    image_heights,
    in_camera,
    sight,
    visible_length_px,
    widest_tangent,
)
