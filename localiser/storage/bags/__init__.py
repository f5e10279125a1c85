"""Read and write ROS bags with no ROS installed: ROS 1, ROS 2 with sqlite3, ROS 2 with MCAP."""

from localiser.storage.bags.bag import (
    CAMERA_INFO,
    CLOCK,
    COMPRESSED,
    DIAGNOSTICS,
    IMAGE,
    MARKERS,
    ODOMETRY,
    PATH,
    POSE,
    POSES,
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
from localiser.storage.bags.images import grey_image, image_file, stated_size
from localiser.storage.bags.messages import MAP, ODOM, OPTICAL, Messages, header
from localiser.storage.bags.read import BagReader
from localiser.storage.bags.recorded import (
    anywhere_decision,
    clock_decision,
    image_decision,
    live_label_text,
    odometry_decision,
    start_decision,
)
from localiser.storage.bags.topics import CAMERA_TOPIC, DECISIONS_TOPIC, LOG_TOPIC, MAP_TOPIC, STATE_TOPIC
from localiser.storage.bags.write import (
    FILE_KINDS,
    KINDS,
    WHEELS_TOPIC,
    BagRecorder,
    NewBag,
    check_times,
    log_messages,
    new_bag,
    require_new,
    write_bag,
    write_message,
)
