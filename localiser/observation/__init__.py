"""The observation: how well what was measured fits a pose, log p(sighting | particle)."""

from localiser.observation.association import Association
from localiser.observation.clutter import SEEN_AGAIN, EarlierFrame, persistent_clutter, scene_clutter
from localiser.observation.edge_observation import EdgeObservation
from localiser.observation.frame import SIGMA_PX as ENDPOINT_SIGMA_PX
from localiser.observation.frame import Frame, at_border, end_per_height, marked_landmarks
from localiser.observation.inlier_rate import DETECTION_RATES, INLIER_RATES, UNKNOWN_RATE, InlierRate, log_sum_of_rates
from localiser.observation.place_landmarks import FEWEST_EDGES, PlaceLandmarks
from localiser.observation.sighting import (
    Matches,
    Observation,
    ObservationParameters,
    Sighting,
    Targets,
    novelty_of,
    own_log_likelihood,
)
