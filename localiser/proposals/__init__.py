"""Where may the robot be? Poses proposed from one image's edges, as a density to draw particles from."""

from localiser.proposals.evidence import warm_up
from localiser.proposals.mixture import Proposals, Region
from localiser.proposals.places import Places
from localiser.proposals.resection import from_three_bearings, from_two_bearings
from localiser.proposals.search import ProposalParameters, propose
from localiser.proposals.views import View, view_of

__all__ = [
    "Places",
    "ProposalParameters",
    "Proposals",
    "Region",
    "View",
    "from_three_bearings",
    "from_two_bearings",
    "propose",
    "view_of",
    "warm_up",
]
