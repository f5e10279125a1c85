"""What a view needs before the first image."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from localiser.camera import Camera
from localiser.geometry import Array, Trajectory
from localiser.landmarks import LandmarkMap


@dataclass(frozen=True, slots=True, eq=False)
class Context:
    """What does not change while a run is shown.

    name: of the log. truth: path of the robot in the map, where known. odometry: path by odometry alone, moved so that
    it starts at the start pose; without it, `Located.odometry` is moved onto the first estimate. images: False leaves
    the image out of the layout, for logs that have none. application: which recordings share a layout in the viewer.
    """

    name: str
    camera: Camera
    landmark_map: LandmarkMap
    truth: Trajectory | None = None
    odometry: Trajectory | None = None
    images: bool = True
    application: str = "localiser"

    @property
    def landmark_ends(self) -> Array:
        """Bottom and top (L, 2, 3) of each landmark in the map; from the floor to twice the camera's height if unknown.

        A height that is not known has to be drawn somehow: this spans the part that the camera looks at.
        """
        landmarks = self.landmark_map
        bottom = np.where(np.isnan(landmarks.bottom_m), 0.0, landmarks.bottom_m)
        top = np.where(np.isnan(landmarks.top_m), bottom + 2 * self.camera.mount.height_m, landmarks.top_m)
        x, z = landmarks.points.T
        return np.stack([np.stack([x, bottom, z], axis=-1), np.stack([x, top, z], axis=-1)], axis=1)
