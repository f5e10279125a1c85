"""Replay logs: measurements in, results out; and evaluate what a run wrote."""

from localiser.replay.evaluation import evaluate_run
from localiser.replay.folder import SINKS, FolderRun, Outputs, Stop, asked_to_stop
from localiser.replay.run import Replay, Sink, close_all, given_pose, prepare, replay_log, stated_start
