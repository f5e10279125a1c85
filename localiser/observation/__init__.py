"""The observation: how well what was measured fits a pose, log p(sighting | particle)."""

from localiser.observation.angle import Angle
from localiser.observation.association import Association, EndOffsets, end_offsets
from localiser.observation.detection_rate import DETECTION_RATES, DetectionRate
from localiser.observation.edge_observation import EdgeObservation
from localiser.observation.endpoint_likelihood import MISSED, at_border, end_per_height, ends_lower_first
from localiser.observation.endpoint_likelihood import SIGMA_PX as ENDPOINT_SIGMA_PX
from localiser.observation.inlier_rate import INLIER_RATES, InlierRate, log_sum_of_rates
from localiser.observation.likelihood import View, marked_landmarks, sides_on
from localiser.observation.near_landmarks import NearLandmarks
from localiser.observation.parameters import ObservationParameters, novelty_of
from localiser.observation.sighting import (
    EarlierImage,
    Matches,
    Observation,
    Sighting,
    Targets,
    own_log_likelihood,
)
from localiser.observation.visibility import Visibility
