"""A running robot: messages in, poses out; the same filter as in a replay."""

from localiser.live.inbox import TOPICS, Arrival, check_outputs, input_topics, message_of, topic_for, type_of
from localiser.live.loop import LiveRun
from localiser.live.monitor import status_line
from localiser.live.prepare import LiveOptions, open_run
from localiser.live.stand_in import Passage, StandIn
from localiser.live.transport import ENDPOINT, Topic, network_of, open_transport, prefix_of
