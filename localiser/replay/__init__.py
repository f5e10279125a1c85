"""Replay logs: measurements in, results out; and evaluate what a run wrote."""

from localiser.replay.evaluation import evaluate_run
from localiser.replay.folder import SINKS, FolderRun, Outputs
from localiser.replay.run import Replay, Sink, close_all, prepare, replay_log
from localiser.replay.start import Stop, asked_to_stop, given_pose, stated_start
