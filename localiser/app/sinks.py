"""Where results go: everything that takes located frames has one type."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from localiser.edges import Edges
from localiser.evaluate import Track
from localiser.geometry import Array, Increment
from localiser.mcl import Located
from localiser.observation import Matches

Image = NDArray[np.uint8] | bytes


class Sink(Protocol):
    """Takes what was located, image by image: files, recordings, live views, figures."""

    def frame(self, located: Located, image: Image | None, truth: Array | None, stage_ms: Mapping[str, float]) -> None:
        """Take one frame. image: pixels or the bytes of an image file. truth: (3,) pose. stage_ms: time of stages."""

    def close(self, complete: bool) -> None:
        """End. complete: whether the whole log was replayed."""


@dataclass(slots=True, eq=False)
class History:
    """Keeps the figures of a run for its metrics and its report: a few hundred bytes a frame."""

    associate: Callable[[Array, Edges], Matches]
    t_ns: list[int] = field(default_factory=list)
    poses: list[Array] = field(default_factory=list)
    covs: list[Array] = field(default_factory=list)
    odometry: list[Array] = field(default_factory=list)
    edges: list[Edges] = field(default_factory=list)
    matched: list[int] = field(default_factory=list)
    increments: list[Increment] = field(default_factory=list)

    def frame(self, located: Located, image: Image | None, truth: Array | None, stage_ms: Mapping[str, float]) -> None:
        """Keep one frame."""
        estimate = located.estimate
        self.t_ns.append(located.t_ns)
        self.poses.append(estimate.pose.copy())
        self.covs.append(estimate.pose_cov.copy())
        self.odometry.append(located.odometry)
        self.edges.append(located.edges)
        self.matched.append(int((self.associate(estimate.pose, located.edges).landmark >= 0).sum()))
        self.increments.append(located.increment)

    def close(self, complete: bool) -> None:
        """Nothing to end."""

    @property
    def track(self) -> Track:
        """The run so far."""
        return Track.from_poses(
            self.t_ns,
            np.array(self.poses).reshape(-1, 3),
            covs=np.array(self.covs).reshape(-1, 3, 3),
            odometry=np.array(self.odometry).reshape(-1, 3),
            edges=[len(edges) for edges in self.edges],
            matched=self.matched,
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
