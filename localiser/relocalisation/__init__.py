"""Global localisation: poses proposed from the edges of one image, and the places that they are at."""

from localiser.relocalisation.candidates import Candidates
from localiser.relocalisation.evidence import warm_up
from localiser.relocalisation.global_localisation import (
    POWER,
    Clues,
    GlobalLocalisation,
    SearchParameters,
)
from localiser.relocalisation.history import History, Limits, beyond
from localiser.relocalisation.mixture import Proposals, Region
from localiser.relocalisation.places import Places
from localiser.relocalisation.proposals import ProposalParameters, propose
from localiser.relocalisation.resection import from_three_bearings, from_two_bearings
from localiser.relocalisation.views import View, view_of
