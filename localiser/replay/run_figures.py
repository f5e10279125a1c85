"""The figures of a run: metrics, the bound where it is known, the report."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from localiser import evaluate, motion
from localiser.edges import Edges
from localiser.geometry import Array
from localiser.replay.run_inputs import RunInputs
from localiser.replay.sinks import History
from localiser.replay.tilt import mount_figures
from localiser.storage import RunFolder


def write_figures(
    inputs: RunInputs,
    folder: RunFolder,
    history: History,
    timing: Mapping[str, Sequence[float]],
    *,
    complete: bool,
) -> dict[str, Any]:
    """Write `metrics.json`, `timing.json` and `report.png` of what was located, and return the metrics.

    timing: by stage, what each frame took (ms). complete: whether the run got to the end of its log.
    """
    from localiser.evaluate import save_report

    log, config, track = inputs.log, inputs.config, history.track
    edges = [frame.located.edges for frame in history.frames]
    truth = log.groundtruth
    if truth is not None and not any(truth.covers(int(t_ns)) for t_ns in track.t_ns):
        truth = None  # a run that ended before the truth begins
    bound = _bound(inputs, history)
    figures = evaluate.metrics(
        track,
        truth,
        log=log.name,
        about=inputs.about,
        bound=bound,
        sighted=_sighted(edges),
        reasons=[frame.located.reason for frame in history.frames],
    )
    figures["biases"] = _biases(inputs, history)
    figures["complete"] = complete
    figures |= mount_figures(log, edges, track.odometry, config)
    times = evaluate.timing_metrics(timing)
    folder.write_json("metrics.json", figures | times)
    folder.write_json("timing.json", times)
    save_report(folder.path / "report.png", track, figures, truth=truth, landmark_map=inputs.landmark_map, bound=bound)
    return figures | times


def _biases(inputs: RunInputs, history: History) -> dict[str, Any]:
    """Return what the run has learnt of its wheels and mount (rad), beside what the truth says of wheels."""
    truth, times = inputs.log.groundtruth, history.track.t_ns
    if truth is None or inputs.config.increments.source != "wheel":
        fit = {}
    else:
        fit = evaluate.fit_wheels(inputs.log.odometry, truth, int(times[0]), int(times[-1]))
    last = history.frames[-1].located
    return evaluate.bias_figures(last.estimate, fit) | evaluate.mount_figures(last.attitude)


def _bound(inputs: RunInputs, history: History) -> Array | None:
    """Return the posterior Cramér-Rao bound (T, 3, 3), where the log tells true poses and associations."""
    log, config, landmark_map = inputs.log, inputs.config, inputs.landmark_map
    located = [frame.located for frame in history.frames]
    if log.groundtruth is None or inputs.start is None or _sighted([result.edges for result in located]) is None:
        return None
    if landmark_map is not log.landmark_map:
        return None  # the log's associations are those of its own map
    poses = log.groundtruth.sampled(history.track.t_ns).poses
    steps = zip(poses[:-1], located[1:], strict=True)
    moves = [motion.linearised(pose, result.increment, config.motion) for pose, result in steps]
    informations = [
        evaluate.bearing_information(pose, log.camera, landmark_map.points, result.edges, config.observation.kind)
        for pose, result in zip(poses, located, strict=True)
    ]
    return evaluate.posterior_bound(
        inputs.start.cov,
        np.array([jac for jac, _ in moves]).reshape(-1, 3, 3),
        np.array([noise for _, noise in moves]).reshape(-1, 3, 3),
        np.array(informations),
    )


def _sighted(all_edges: Sequence[Edges]) -> NDArray[np.bool_] | None:
    """Return whether (T,) a landmark was seen, where the log tells which; None where it does not."""
    if not any((edges.landmark_id >= 0).any() for edges in all_edges):
        return None
    return np.array([(edges.landmark_id >= 0).any() for edges in all_edges])
