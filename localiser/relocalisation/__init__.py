"""Where may the robot be? Poses proposed from one image's edges, as a density to draw particles from."""

from localiser.relocalisation.evidence import warm_up
from localiser.relocalisation.global_localisation import SEEN_FIRST, Clues, Search, SearchParameters, only, resampled
from localiser.relocalisation.lost_probability import Doubt
from localiser.relocalisation.mixture import Proposals, Region
from localiser.relocalisation.places import Places
from localiser.relocalisation.proposals import ProposalParameters, propose
from localiser.relocalisation.resection import from_three_bearings, from_two_bearings
from localiser.relocalisation.views import View, view_of

__all__ = [
    "SEEN_FIRST",
    "Clues",
    "Doubt",
    "Places",
    "ProposalParameters",
    "Proposals",
    "Region",
    "Search",
    "SearchParameters",
    "View",
    "from_three_bearings",
    "from_two_bearings",
    "only",
    "propose",
    "resampled",
    "view_of",
    "warm_up",
]
