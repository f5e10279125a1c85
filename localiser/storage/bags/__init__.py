"""ROS bags, read and written with no ROS installed: ROS 1, ROS 2 with sqlite3, ROS 2 with MCAP."""

from localiser.storage.bags.read import BagReader
from localiser.storage.bags.write import FILE_KINDS, KINDS, write_bag

__all__ = ["FILE_KINDS", "KINDS", "BagReader", "write_bag"]
