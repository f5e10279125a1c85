"""Read and write ROS bags with no ROS installed: ROS 1, ROS 2 with sqlite3, ROS 2 with MCAP."""

from localiser.storage.bags.bag import (
    CAMERA_INFO,
    CAMERA_TOPIC,
    CLOCK,
    COMPRESSED,
    DECISIONS_TOPIC,
    DIAGNOSTICS,
    IMAGE,
    LOG_TOPIC,
    MAP_TOPIC,
    MARKERS,
    ODOMETRY,
    PATH,
    POSE,
    POSES,
    STATE_TOPIC,
    TEXT,
    TRANSFORMS,
    Bag,
    typestore,
)
from localiser.storage.bags.camera_finder import CameraFinder
from localiser.storage.bags.frames import (
    FrameTree,
    check_start,
    floor_pose,
    plain_frame,
    stamp_of,
    start_of_message,
)
from localiser.storage.bags.messages import MAP, ODOM, OPTICAL, Messages, grey_image, header, image_file, stated_size
from localiser.storage.bags.read import BagReader
from localiser.storage.bags.recorded import (
    anywhere_decision,
    clock_decision,
    image_decision,
    live_label_text,
    odometry_decision,
    start_decision,
)
from localiser.storage.bags.write import (
    FILE_KINDS,
    KINDS,
    WHEELS_TOPIC,
    BagRecorder,
    NewBag,
    check_times,
    log_messages,
    new_bag,
    write_bag,
    write_message,
)
