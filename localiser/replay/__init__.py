"""Replay logs: measurements in, results out; and evaluate what a run wrote."""

from localiser.replay.evaluation import evaluate_run
from localiser.replay.run import FolderRun, Replay, prepare, replay_log
from localiser.replay.sinks import SINKS, Outputs, Sink, close_all
from localiser.replay.start import given_pose, stated_start
from localiser.replay.stop import Stop, asked_to_stop
