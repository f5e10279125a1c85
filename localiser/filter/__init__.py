"""The particle filter: Monte Carlo localisation and what it believes."""

from localiser.filter.attitude import MOUNT, Attitude, Level
from localiser.filter.confidence import CORRECT_M, CORRECT_RAD, SURE
from localiser.filter.frames import Image, LocatedFrame
from localiser.filter.mcl import (
    Event,
    FilterState,
    Located,
    Mcl,
    MclParameters,
    Odometry,
    Sighting,
    Start,
    finish,
    step,
)
from localiser.filter.optimal_proposal import warm_up

__all__ = [
    "CORRECT_M",
    "CORRECT_RAD",
    "MOUNT",
    "SURE",
    "Attitude",
    "Event",
    "FilterState",
    "Image",
    "Level",
    "Located",
    "LocatedFrame",
    "Mcl",
    "MclParameters",
    "Odometry",
    "Sighting",
    "Start",
    "finish",
    "step",
    "warm_up",
]
