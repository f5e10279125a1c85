"""What a view needs before the first image."""

from __future__ import annotations

from dataclasses import dataclass

from localiser.camera import Camera
from localiser.geometry import Array, Trajectory
from localiser.landmarks import LandmarkMap, landmark_ends


@dataclass(frozen=True, slots=True, eq=False)
class Context:
    """What does not change while a run is shown.

    name: of the log. truth: path of the robot in the map, where known. images: False leaves the image out of the
    layout, for logs that have none. application: which recordings share a layout in the viewer.
    """

    name: str
    camera: Camera
    landmark_map: LandmarkMap
    truth: Trajectory | None = None
    images: bool = True
    application: str = "localiser"

    @property
    def landmark_ends(self) -> Array:
        """Bottom and top (L, 2, 3) of each landmark in the map; see `landmarks.landmark_ends`."""
        return landmark_ends(self.landmark_map, self.camera)
