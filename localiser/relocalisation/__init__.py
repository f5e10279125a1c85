"""Global localisation: poses proposed from the edges of one image, and the places that they are at."""

from localiser.relocalisation.candidates import Candidates, History, beyond
from localiser.relocalisation.global_localisation import BLUR_RAD, PLACE_POWER, GlobalLocalisation, SearchParameters
from localiser.relocalisation.hypotheses import MANY_PAIRS
