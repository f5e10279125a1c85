"""Image → vertical edges: find segments, keep those that meet the nadir point, measure them."""

from localiser.edges.bearings import BearingSensor, complete
from localiser.edges.detectors import DETECTORS, Detector, register, registered
from localiser.edges.find import find_edges, warm_up
from localiser.edges.foot import FOOT_SIGMA_PX, foot_of_edges
from localiser.edges.light import DARK_GREY, WASHED_OUT, Light, light_of
from localiser.edges.line_detectors import on_ideal_image
from localiser.edges.mount import mount_error_of_edges
from localiser.edges.parameters import EdgeParameters
from localiser.edges.profile import PROFILE_OFFSETS_PX
from localiser.edges.segments import Segments
from localiser.edges.types import TURN_RATE, CommonError, Edges
