"""What recorder and layout share: what a view needs before the first image, names of entities and time lines."""

from __future__ import annotations

from dataclasses import dataclass, replace

from localiser.camera import Camera
from localiser.geometry import Array, Trajectory
from localiser.landmarks import LandmarkMap, landmark_ends

FRAME = "frame"
TIME = "time"

WORLD = "world"
LANDMARKS = f"{WORLD}/map/unseen"
VISIBLE = f"{WORLD}/map/visible"
MATCHED = f"{WORLD}/map/matched"
SIGHTS = f"{WORLD}/sights"
PARTICLES = f"{WORLD}/particles"
ESTIMATE = f"{WORLD}/estimate/arrow"
ELLIPSE = f"{WORLD}/estimate/ellipse"
PLACES = f"{WORLD}/places/ellipses"
PLACE_ARROWS = f"{WORLD}/places/arrows"
TRUTH = f"{WORLD}/truth/arrow"
TRUTH_PATH = f"{WORLD}/truth/path"
ESTIMATE_TRAIL = f"{WORLD}/trails/estimate"
TRUTH_TRAIL = f"{WORLD}/trails/truth"
ODOMETRY_TRAIL = f"{WORLD}/trails/odometry"
TRAILS = (ESTIMATE_TRAIL, TRUTH_TRAIL, ODOMETRY_TRAIL)

CAMERA = f"{WORLD}/camera"
IMAGE = f"{CAMERA}/image"
OVERLAY = f"{CAMERA}/overlay"
REJECTED = f"{OVERLAY}/rejected"
PREDICTED = f"{OVERLAY}/predicted"
EDGES = f"{OVERLAY}/edges"
JOINS = f"{OVERLAY}/joins"

ERROR = "plots/position"
HEADING = "plots/heading"
ESS = "plots/ess"
P_CORRECT = "plots/p_correct"
COUNTS = "plots/edges"
STAGES = "plots/stage_ms"
TEXT = "text"


@dataclass(frozen=True, slots=True, eq=False)
class Context:
    """What does not change while a run is shown.

    name: of the log. truth: path of the robot in the map, where known. images: False leaves the image out of the
    layout, for logs that have none.
    """

    name: str
    camera: Camera
    landmark_map: LandmarkMap
    truth: Trajectory | None = None
    images: bool = True

    @property
    def of_first_map(self) -> Context:
        """The same of the first of several maps."""
        return replace(self, landmark_map=self.landmark_map.maps[0])

    @property
    def landmark_ends(self) -> Array:
        """Bottom and top (L, 2, 3) of each landmark in the map; see `landmarks.landmark_ends`."""
        return landmark_ends(self.landmark_map, self.camera)
