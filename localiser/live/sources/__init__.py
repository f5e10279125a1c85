"""Live input: messages of a robot over zenoh, frames of a camera, gathered in one bounded inbox."""

from localiser.live.sources.camera import CameraSource
from localiser.live.sources.inbox import Arrival, Inbox
from localiser.live.sources.keys import topic_of
from localiser.live.sources.network import ENDPOINT, Network
