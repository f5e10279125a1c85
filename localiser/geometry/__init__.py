"""Floor poses, increments, angles, and the equations of the paper; frames and signs are in docs/conventions.md."""

from localiser.geometry.compiled import private_folder, read_kept, write_kept
from localiser.geometry.poses import (
    MANY,
    Array,
    Increment,
    Indices,
    arc_log,
    arc_motion,
    bearing_from_lean,
    bearing_per_lean,
    between,
    compose,
    cos_sin,
    finite_numbers,
    forward,
    is_level,
    lean_from_bearing,
    map_from_robot,
    pose_from_ros,
    right,
    robot_from_map,
    ros_cov_from_cov,
    ros_from_pose,
    sin_of_tilt,
    slope_from_lean,
    wrap_angle,
    wrap_half_turn,
)
from localiser.geometry.trajectory import MOST_SPEED_M_S, UNKNOWN_TWIST, Trajectory, Twist, bridged, twist_at
