"""Live input: what came over a network, and frames of a camera, gathered in one bounded inbox."""

from localiser.live.sources.camera import CameraSource
from localiser.live.sources.inbox import Arrival, Inbox
