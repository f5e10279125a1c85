"""Global localisation: poses proposed from the edges of one image, and the places that they are at."""

from localiser.relocalisation.candidates import Candidates
from localiser.relocalisation.global_localisation import BLUR_RAD, POWER, Clues, GlobalLocalisation, SearchParameters
from localiser.relocalisation.history import History, Limits, beyond
from localiser.relocalisation.hypotheses import Feet, feet_of
from localiser.relocalisation.places import Places, Region
from localiser.relocalisation.resection import from_three_bearings, from_two_bearings
