"""Straight line segments with their errors, as detectors return them."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from localiser.geometry import Array


@dataclass(frozen=True, slots=True, eq=False)
class Segments:
    """Straight segments, S of them, in undistorted pixels: those of `Camera.undistorted`.

    ends_px: (S, 2, 2) bottom and top end. support_px: (S, 2, 2) lower and upper point whose errors across the line,
    sigma_px (S,) each and independent, say how certain the line is; those of a general detector are its ends, those
    of a line fitted to points all along it lie at the points' standard deviation from their middle.
    shift_sigma_px: (S,) by how much what lies beside the segment may have moved it, as a whole and, about as much, one
    end against the other. polarity: (S,) as in `Edges`, 0 not known yet.
    """

    ends_px: Array
    support_px: Array
    sigma_px: Array
    shift_sigma_px: Array
    polarity: NDArray[np.int8]

    def __len__(self) -> int:
        return len(self.ends_px)

    @property
    def end_sigma_px(self) -> Array:
        """The whole error (S,) of a support point against the other one."""
        return np.hypot(self.sigma_px, self.shift_sigma_px)

    @property
    def across_sigma_px(self) -> Array:
        """The error (S,) of two independent support points that leaves the middle as uncertain as it is."""
        return np.sqrt(self.sigma_px**2 + 3 * self.shift_sigma_px**2)

    def take(self, index: NDArray[np.bool_]) -> Segments:
        """Return the segments where the mask (S,) holds."""
        return Segments(*(getattr(self, column.name)[index] for column in fields(self)))

    @classmethod
    def of_ends(cls, ends_px: Array, sigma_px: float) -> Segments:
        """Return segments that are known by their ends (S, 2, 2), in any order."""
        upside_down = ends_px[:, 0, 1] < ends_px[:, 1, 1]
        ends = np.where(upside_down[:, None, None], ends_px[:, ::-1], ends_px)
        count = len(ends)
        none = np.zeros(count)
        return cls(ends, ends, np.full(count, sigma_px), none, np.zeros(count, dtype=np.int8))
