"""Topics of ROS 2 as key expressions of zenoh.

zenoh-bridge-ros2dds carries the topic `/camera/image_raw` under the key `camera/image_raw`. ROS 2's own middleware for
zenoh, rmw_zenoh, has `0/camera/image_raw/sensor_msgs::msg::dds_::Image_/RIHS01_…`: domain, topic, type, its hash.
"""

from __future__ import annotations

_TYPE_MARK = "::dds_::"


def keys_of(topic: str, msgtype: str) -> tuple[str, str]:
    """Return the keys under which a topic arrives: from a bridge, and from rmw_zenoh in any domain."""
    package, _, name = msgtype.split("/")
    key = topic.strip("/")
    return key, f"*/{key}/{package}::msg::dds_::{name}_/*"


def topic_of(key: str) -> tuple[str, str | None]:
    """Return the topic of a key, and the type of its messages where the key says it."""
    parts = key.split("/")
    if len(parts) >= 4 and parts[0].isdigit() and _TYPE_MARK in parts[-2]:
        package, _, rest = parts[-2].partition("::")
        name = rest.rsplit("::", 1)[-1].removesuffix("_")
        return "/" + "/".join(parts[1:-2]), f"{package}/msg/{name}"
    return "/" + key, None
