"""Floor poses, increments, angles, and the equations of the paper; frames and signs are in docs/conventions.md."""

from localiser.geometry.compiled import private_folder, read_kept, write_kept
from localiser.geometry.poses import (
    MANY,
    Array,
    Increment,
    arc_log,
    arc_motion,
    between,
    circular_mean,
    compose,
    cos_sin,
    finite_numbers,
    forward,
    map_from_robot,
    pose_from_ros,
    right,
    robot_from_map,
    ros_cov_from_cov,
    ros_from_pose,
    wrap_angle,
    wrap_half_turn,
)
from localiser.geometry.slopes import (
    bearing_from_lean,
    bearing_from_point,
    bearing_per_lean,
    edge_a_at,
    lean_from_bearing,
    sin_of_tilt,
    slope_from_lean,
)
from localiser.geometry.trajectory import (
    MOST_SPEED_M_S,
    UNKNOWN_TWIST,
    Trajectory,
    Twist,
    bridged,
    twist_at,
)
