"""The observation: how well what was measured fits a pose, log p(sighting | particle)."""

from localiser.observation.angle import Angle
from localiser.observation.detection_rate import DETECTION_RATES, DetectionRate
from localiser.observation.edge_observation import EdgeObservation
from localiser.observation.endpoint_likelihood import MISSED, at_border, end_per_height, ends_lower_first
from localiser.observation.endpoint_likelihood import SIGMA_PX as ENDPOINT_SIGMA_PX
from localiser.observation.inlier_rate import INLIER_RATES, InlierRate, log_sum_of_rates
from localiser.observation.known_association import IdentifiedObservation, observation_of
from localiser.observation.near_landmarks import NearLandmarks
from localiser.observation.parameters import ObservationParameters, novelty_of
from localiser.observation.protocols import (
    Associates,
    ComparesEnds,
    EarlierImage,
    EndOffsets,
    FollowsClutter,
    GuidesSteps,
    LocalisesGlobally,
    Matches,
    Observation,
    PredictsScenes,
    RatesInliers,
    ScalesMaps,
    Sighting,
    Targets,
    TempersByScale,
    likelihood_by_rate,
    matches_of,
)
from localiser.observation.visibility import Visibility
