"""Live input: messages of a robot over zenoh, frames of a camera, gathered in one bounded inbox."""

from localiser.sources.camera import CameraSource
from localiser.sources.inbox import Arrival, Inbox
from localiser.sources.keys import topic_of
from localiser.sources.network import ENDPOINT, Network

__all__ = ["ENDPOINT", "Arrival", "CameraSource", "Inbox", "Network", "topic_of"]
