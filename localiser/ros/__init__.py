"""What is located, as messages of ROS 2: the same for every transport, and for bags."""

from localiser.ros.outgoing import Frames, Message, Outgoing
from localiser.ros.outputs import OUTPUTS, Output, outputs_named, topic_in
from localiser.ros.services import (
    MAP_INVALID,
    MAP_LOADED,
    MAP_NOT_THERE,
    SERVICES,
    Service,
    request_bytes,
    request_of,
    response_bytes,
    response_of,
)
