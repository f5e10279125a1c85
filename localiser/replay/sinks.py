"""Sinks: everything that takes located images. Each kind is registered here."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Literal, Protocol

import numpy as np

from localiser import particles
from localiser.evaluate import WorstMoments
from localiser.filter import LocatedFrame
from localiser.storage import TrackWriter
from localiser.view import Context, LiveView, RrdFile


class Sink(Protocol):
    """Takes what was located, image by image: files, recordings, live views."""

    def frame(self, frame: LocatedFrame) -> None:
        """Take one frame."""

    def close(self, complete: bool) -> None:
        """End. complete: whether the whole log was replayed."""


@dataclass(frozen=True, slots=True)
class Outputs:
    """What a replay writes and shows.

    results: folder of all results. rrd: whether to record. view: a live viewer. report: whether to draw report.png.
    bag: a ROS 2 bag of the log and what was located, None for none.
    """

    results: Path
    rrd: bool = True
    view: Literal["native", "web", "none"] = "none"
    report: bool = True
    bag: Path | None = None


SINKS: list[Callable[[Outputs, Path, Context], Sink | None]] = [
    lambda outputs, folder, context: TrackWriter(folder),
    lambda outputs, folder, context: WorstMoments(),
    lambda outputs, folder, context: RrdFile(folder / "run.rrd", context) if outputs.rrd else None,
    lambda outputs, folder, context: LiveView(outputs.view, context) if outputs.view != "none" else None,
]
"""What makes the sinks of a replay, each from what was asked for, the run's folder and what a view must know."""


def sinks_of(outputs: Outputs, folder: Path, context: Context) -> list[Sink]:
    """Return the sinks that were asked for, open. Raises OutputError."""
    return [sink for make in SINKS if (sink := make(outputs, folder, context)) is not None]


def close_all(sinks: Sequence[Sink], complete: bool) -> None:
    """Close every sink, the later ones also when an earlier one fails; then raise the first failure."""
    all_of([partial(sink.close, complete) for sink in sinks])


def all_of(steps: Iterable[Callable[[], object]]) -> None:
    """Take every step, the later ones also when an earlier one fails; then raise the first failure."""
    failures = []
    for step in steps:
        try:
            step()
        except Exception as failure:
            failures.append(failure)
    if failures:
        raise failures[0]


def without_bulk(frame: LocatedFrame) -> LocatedFrame:
    """Return a frame to be kept until the end of a run: without what grows with pixels or particles."""
    located = frame.located
    none = np.zeros(0, dtype=np.int64)
    clusters = located.clusters and replace(located.clusters, label=none)
    light = replace(located, particles=particles.take(located.particles, none), clusters=clusters, sighting=None)
    return replace(frame, located=light, image=None)
