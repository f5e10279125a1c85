"""Read and write ROS bags with no ROS installed: ROS 1, ROS 2 with sqlite3, ROS 2 with MCAP."""

from localiser.storage.bags.bag import CAMERA_TOPIC, DECISIONS_TOPIC, LOG_TOPIC, MAP_TOPIC, STATE_TOPIC, Bag
from localiser.storage.bags.camera_finder import CameraFinder
from localiser.storage.bags.database import BagRecorder
from localiser.storage.bags.messages import MAP, ODOM, OPTICAL, Messages, grey_image, header, image_file, typestore
from localiser.storage.bags.read import BagReader
from localiser.storage.bags.records import RosType
from localiser.storage.bags.transforms import check_start, floor_pose, plain_frame, stamp_of, start_of_message
from localiser.storage.bags.write import (
    FILE_KINDS,
    WHEELS_TOPIC,
    NewBag,
    anywhere_decision,
    check_times,
    clock_decision,
    image_decision,
    live_label_text,
    log_messages,
    motion_settings,
    new_bag,
    odometry_decision,
    start_decision,
    write_bag,
    write_message,
)
