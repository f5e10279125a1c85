"""The particle filter: Monte Carlo localisation and what it believes."""

from localiser.filter.attitude import Attitude, Level
from localiser.filter.events import (
    CORRECT_M,
    CORRECT_RAD,
    LEAST_SURE,
    NOT_FOUND,
    SURE,
    Anywhere,
    Event,
    Located,
    Odometry,
    Start,
    track_of,
)
from localiser.filter.frames import Finding, Image, LocatedFrame, Markers
from localiser.filter.mcl import FilterState, Mcl, MclParameters, finish, step
from localiser.filter.optimal_proposal import warm_up
from localiser.observation import Sighting
