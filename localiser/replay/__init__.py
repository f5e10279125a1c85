"""Replay a log: events in, results out."""

from localiser.replay.checkpoints import Checkpoints
from localiser.replay.run import Outputs, prepare
from localiser.replay.sinks import Sink, close_all
from localiser.replay.start import START_SIGMA, given_pose
from localiser.replay.stop import asked_to_stop, stop_request
from localiser.replay.tilt import Tilt, find_tilt, usable_images, write_plot, write_tilt

__all__ = [
    "START_SIGMA",
    "Checkpoints",
    "Outputs",
    "Sink",
    "Tilt",
    "asked_to_stop",
    "close_all",
    "find_tilt",
    "given_pose",
    "prepare",
    "stop_request",
    "usable_images",
    "write_plot",
    "write_tilt",
]
