"""A located image with all results, which every sink takes."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from localiser.filter.events import LEAST_SURE, NOT_FOUND, SURE, Located
from localiser.geometry import Array
from localiser.landmarks import LandmarkMap
from localiser.observation import Matches, marked_landmarks

Image = NDArray[np.uint8] | bytes
"""Pixels (height, width) grey or (height, width, 3) BGR as OpenCV has them, or the bytes of a JPEG or PNG file."""


@dataclass(frozen=True, slots=True, eq=False)
class LocatedFrame:
    """One image, located.

    image: None where edges were measured elsewhere. truth: (3,) true pose then, where known. stage_ms: what each stage
    of the work took. wide_cov: (3, 3) of a pose that is no ordinary one, because the robot is not found yet, or lost:
    it may be anywhere; None for an ordinary pose. map_name: of several maps the one that the robot is most likely on,
    in whose frame all poses are; "" where there is but one. Landmarks keep their numbers among those of all maps.
    """

    located: Located
    image: Image | None
    truth: Array | None
    stage_ms: Mapping[str, float]
    wide_cov: Array | None = None
    map_name: str = ""

    @property
    def matches(self) -> Matches:
        """Which landmark each edge shows, seen from the estimate."""
        return self.located.matches

    @property
    def is_found(self) -> bool:
        """Whether the pose is an ordinary one: the robot was found, or its start stated, and it is not lost since."""
        return self.wide_cov is None

    @property
    def pose_cov(self) -> Array:
        """The covariance (3, 3) to tell others: the estimate's, or a wide one."""
        return self.located.estimate.pose_cov if self.wide_cov is None else self.wide_cov


MOVED_IMAGES = 5  # that contradict a marker, and not one that agrees between two of them


@dataclass(slots=True, eq=False)
class Markers:
    """Which markers are not where the map has them, by images whose pose is sure. off: images in succession."""

    off: Counter[int] = field(default_factory=Counter)
    moved: set[int] = field(default_factory=set)

    def after(self, located: Located, landmark_map: LandmarkMap) -> None:
        """Take one image."""
        edges = located.edges
        if located.p_correct <= SURE or not (edges.landmark_id < -1).any():
            return
        landmark = marked_landmarks(edges, landmark_map)
        agrees = landmark == located.matches.landmark
        number = (-2 - edges.landmark_id) // 2
        for one in np.unique(number[landmark >= 0]).tolist():
            self.off[one] = 0 if agrees[(number == one) & (landmark >= 0)].any() else self.off[one] + 1
        self.moved |= {one for one, count in self.off.items() if count >= MOVED_IMAGES}

    def warnings(self, landmark_map: LandmarkMap) -> list[str]:
        """Return what there is to say of markers, a text for each."""
        names = Counter(one["identity"] for one in landmark_map.extra if "identity" in one)
        twice = sorted({name.rpartition(":")[0] for name, count in names.items() if count > 1})
        return [
            *(f"Marker {name} is on the map twice: it tells no place." for name in twice),
            *(f"Marker {one} is not where the map has it: was it moved, or hung twice?" for one in sorted(self.moved)),
        ]


@dataclass(slots=True, eq=False)
class Finding:
    """Whether the robot is found: its start was stated, or the filter was sure once.

    From where it is more likely wrong than right until it is sure again, the robot is lost. anywhere: (3, 3) covariance
    of a pose that is as far off as the map is wide.
    """

    anywhere: Array
    is_found: bool = False
    was_found: bool = False

    @classmethod
    def on(cls, landmark_map: LandmarkMap) -> Finding:
        """Return it before anything is known."""
        extent = np.max([np.ptp(one.points, axis=0) for one in landmark_map.maps], axis=0)
        return cls(np.diag(np.square([*extent, np.pi]) / 3))

    def begin(self, *, found: bool) -> None:
        """Begin anew. found: whether it is known where."""
        self.is_found = self.was_found = found

    def after(self, located: Located) -> tuple[Located, Array | None]:
        """Return what was located, and the covariance (3, 3) of a pose that is no ordinary one."""
        p_correct = located.p_correct
        self.was_found |= p_correct > SURE
        self.is_found = p_correct > SURE or (self.is_found and not p_correct < LEAST_SURE)
        if not self.was_found:
            located = replace(located, reason=NOT_FOUND)
        if self.is_found:
            return located, None
        return located, p_correct * located.estimate.pose_cov + (1 - p_correct) * self.anywhere
