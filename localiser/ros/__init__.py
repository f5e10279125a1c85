"""What is located, as messages of ROS 2: the same for every transport, and for bags."""

from localiser.ros.interfaces import (
    LAYOUTS,
    MAP_INVALID,
    MAP_LOADED,
    MAP_NOT_THERE,
    OUTPUTS,
    SERVICES,
    Service,
    Topic,
    outputs_named,
    service_bytes,
    service_message,
    topic_in,
)
from localiser.ros.outgoing import Frames, Message, Outgoing, map_frames
