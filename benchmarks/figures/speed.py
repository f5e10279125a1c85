"""Ratios of times that were taken in turns within one run, the least of five each: how fast, whatever the machine does.

    kernel / oracle   weighing 2000 particles by compiled loops, over the same with arrays
    edges / lsd       finding the vertical edges of an image, over OpenCV's line segments alone
    frame / lsd       that and the filter's step, over the same

Times are CPU times of the thread. Each repetition has a process of its own, with nothing beside it.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from time import thread_time
from typing import Any

import cv2
import numpy as np

from figures.inputs import CORRIDOR
from figures.measures import Measure
from figures.tasks import Task, Values
from localiser.config import read_config
from localiser.filter import Odometry
from localiser.localiser import Localiser
from localiser.storage import ImageEvent, Log, open_log

ROUNDS = 5
IMAGES = 40
MEASURES = {name: Measure("up") for name in ("kernel / oracle", "edges / lsd", "frame / lsd")}


def tasks(repetitions: int) -> list[Task]:
    """Return what is measured."""
    kernels = {f"kernel {kind}": partial(kernel, kind) for kind in ("line", "slope")}
    work = kernels | {"corridor": drive}
    return [Task("speed", name, seed, work[name]) for seed in range(repetitions) for name in work]


def kernel(kind: str) -> Values:
    """Return the time of the compiled loops over that of their oracle, for 100 landmarks and 30 edges."""
    import filter as weighing

    observation = weighing.EdgeObservation(weighing.CAMERA, weighing.ObservationParameters(kind=kind))
    frame = weighing.frame_of(2000, 100, 30)
    fast, plain = partial(observation.by_rate, *frame), partial(observation.by_rate_plain, *frame)
    weighing.fastest_ms([fast, plain], 1)
    fast_ms, plain_ms = weighing.fastest_ms([fast, plain], 4 * ROUNDS)
    return {"kernel / oracle": fast_ms / plain_ms}


def drive() -> Values:
    """Return the times of edges and of a whole frame over LSD's, summed over the beginning of a log."""
    log = open_log(CORRIDOR)
    passes = [one_pass(log) for _ in range(ROUNDS)]
    lsd, edges, step = np.array(passes).min(axis=0).sum(axis=0)
    return {"edges / lsd": float(edges / lsd), "frame / lsd": float((edges + step) / lsd)}


def one_pass(log: Log) -> list[tuple[float, float, float]]:
    """Return the seconds that LSD, edges and the filter took for every event from the second image to the last.

    What is prepared once for a camera and a map belongs to the first image.
    """
    localiser = Localiser(log.landmark_map, log.camera, read_config(None, [], log.settings))
    localiser.start(log.start.mean, log.start.cov, log.start.t_ns)
    detector, taken = cv2.createLineSegmentDetector(), []
    for event in log.events(anywhere=True):
        if event.t_ns > log.frames[IMAGES].t_ns:
            break
        lsd_s = edges_s = 0.0
        if isinstance(event, ImageEvent):
            image = event.load()
            lsd_s, _ = timed(partial(detector.detect, image))
            edges_s, measured = timed(partial(localiser.measure, image))
            step = partial(localiser.edges, event.t_ns, measured)
        elif isinstance(event, Odometry):
            step = partial(localiser.odometry, event.t_ns, event.pose)
        step_s, _ = timed(step)
        if event.t_ns >= log.frames[1].t_ns:
            taken.append((lsd_s, edges_s, step_s))
    return taken


def timed(work: Callable[[], Any]) -> tuple[float, Any]:
    """Return the seconds that work took this thread, and its result."""
    begin = thread_time()
    result = work()
    return thread_time() - begin, result
