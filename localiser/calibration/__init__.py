"""Calibration: tilt and roll from edges, all of a camera from a board, clocks, and the quality of odometry."""

from localiser.calibration.board import (
    FEWEST_VIEWS,
    Board,
    BoardView,
    FloorMount,
    Intrinsics,
    calibrate,
    mount_over_board,
)
from localiser.calibration.clock import MOST_PAIRS, ClockOffset, clock_offset
from localiser.calibration.mount import (
    Lines,
    LogMount,
    check_mount,
    down_in_camera,
    lines_of,
    mount_from_down,
    mount_of_images,
    mount_of_lines,
    spread,
)
from localiser.calibration.odometry import (
    ALPHAS,
    SCALES,
    Drive,
    OdometryFit,
    Pieces,
    fit_odometry,
    on_one_clock,
    smooth_path,
)
