"""A running robot: messages in, poses out; the same filter as in a replay."""

from localiser.live.inbound import TOPICS, message_of, topic_for, type_of
from localiser.live.prepare import LiveOptions, opened
from localiser.live.stand_in import Passage, StandIn
from localiser.live.status import end_table, status_line
from localiser.live.topic_names import check_outputs, input_topics
from localiser.live.transports import ENDPOINT, Topic, endpoints_of, open_transport, prefix_of
