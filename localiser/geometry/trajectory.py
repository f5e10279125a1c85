"""Poses at times, and between them; times without their long pauses."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from localiser.geometry.angles import Array
from localiser.geometry.poses import interpolate_pose


@dataclass(frozen=True, slots=True, eq=False)
class Trajectory:
    """Poses over time. t_ns: (T,) int64, strictly increasing. poses: (T, 3) x, z, heading."""

    t_ns: NDArray[np.int64]
    poses: Array

    def __len__(self) -> int:
        return len(self.t_ns)

    def covers(self, t_ns: int) -> bool:
        """Whether `t_ns` lies between the first and the last pose."""
        return len(self) > 0 and int(self.t_ns[0]) <= t_ns <= int(self.t_ns[-1])

    def at(self, t_ns: int) -> Array:
        """Return the pose (3,) at a time, interpolated along the arc; the first or last pose outside."""
        after = int(np.searchsorted(self.t_ns, t_ns, side="left"))
        if after == 0:
            return np.asarray(self.poses[0].copy())
        if after == len(self):
            return np.asarray(self.poses[-1].copy())
        start_ns, end_ns = int(self.t_ns[after - 1]), int(self.t_ns[after])
        return interpolate_pose(self.poses[after - 1], self.poses[after], (t_ns - start_ns) / (end_ns - start_ns))

    def sampled(self, times_ns: ArrayLike) -> Trajectory:
        """Return the trajectory at the given times (T',)."""
        times = np.asarray(times_ns, dtype=np.int64)
        poses = np.array([self.at(int(t)) for t in times]).reshape(-1, 3)
        return Trajectory(times, poses)


def without_pauses(t_ns: ArrayLike, longest_ns: int) -> NDArray[np.int64]:
    """Return increasing times (T,), the first as it is, with every longer pause between two cut to `longest_ns`."""
    times = np.asarray(t_ns, dtype=np.int64)
    steps = np.minimum(np.diff(times), longest_ns)
    return np.concatenate([times[:1], times[:1] + np.cumsum(steps)])
