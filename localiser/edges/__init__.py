"""Image → vertical edges: find segments, keep those that meet the nadir point, measure them."""

from localiser.edges.detectors import DETECTORS, Detector, EdgeParameters, on_ideal_image, register
from localiser.edges.find import DARK_GREY, WASHED_OUT, Light, find_edges, light_of
from localiser.edges.measure import FOOT_SIGMA_PX, foot_of_edges
from localiser.edges.mount import mount_error_of_edges
from localiser.edges.types import TURN_RATE, BearingSensor, CommonError, Edges, Segments, complete
