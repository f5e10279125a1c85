"""Global localisation: poses proposed from the edges of one image, and the places that they are at."""

from localiser.relocalisation.candidates import Candidates
from localiser.relocalisation.global_localisation import BLUR_RAD, FEWEST, POWER, GlobalLocalisation, SearchParameters
from localiser.relocalisation.history import History, beyond
