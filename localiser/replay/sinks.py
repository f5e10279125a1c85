"""Where results go: everything that takes located frames has one type."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Protocol

import numpy as np

from localiser import particles
from localiser.evaluate import Track
from localiser.filter import LocatedFrame


class Sink(Protocol):
    """Takes what was located, image by image: files, recordings, live views, figures."""

    def frame(self, frame: LocatedFrame) -> None:
        """Take one frame."""

    def close(self, complete: bool) -> None:
        """End. complete: whether the whole log was replayed."""


@dataclass(slots=True, eq=False)
class History:
    """Keeps the frames of a run for its metrics and its report, without what grows with pixels or particles."""

    frames: list[LocatedFrame] = field(default_factory=list)

    def frame(self, frame: LocatedFrame) -> None:
        """Keep one frame."""
        located = frame.located
        none = particles.take(located.particles, np.zeros(0, dtype=np.int64))
        clusters = located.clusters and replace(located.clusters, label=np.zeros(0, dtype=np.int64))
        self.frames.append(replace(frame, located=replace(located, particles=none, clusters=clusters), image=None))

    def close(self, complete: bool) -> None:
        """Nothing to end."""

    @property
    def track(self) -> Track:
        """The run so far."""
        located = [frame.located for frame in self.frames]
        return Track.from_poses(
            [result.t_ns for result in located],
            np.array([result.estimate.pose for result in located]).reshape(-1, 3),
            covs=np.array([result.estimate.pose_cov for result in located]).reshape(-1, 3, 3),
            odometry=np.array([result.odometry for result in located]).reshape(-1, 3),
            edges=[len(result.edges) for result in located],
            matched=[int((frame.matches.landmark >= 0).sum()) for frame in self.frames],
            p_correct=[result.p_correct for result in located],
        )


def close_all(sinks: Sequence[Sink], complete: bool) -> None:
    """Close every sink, the later ones also when an earlier one fails; then raise the first failure."""
    failures = []
    for sink in sinks:
        try:
            sink.close(complete)
        except Exception as failure:
            failures.append(failure)
    if failures:
        raise failures[0]
