"""The filter that replay and live share, made from the configuration."""

from __future__ import annotations

import math
from dataclasses import replace

from localiser.camera import Camera
from localiser.config import Config
from localiser.filter import Level, Mcl, optimal_proposal
from localiser.landmarks import LandmarkMap
from localiser.observation import EdgeObservation
from localiser.relocalisation import GlobalLocalisation
from localiser.storage import identity_of
from localiser.visual_odometry import Odometer


def filter_of(camera: Camera, landmark_map: LandmarkMap, observation: EdgeObservation, config: Config) -> Mcl:
    """Return the filter, all that it needs compiled, so that no frame has to wait for it."""
    observation.warm_up()
    optimal_proposal.warm_up()
    search = None  # looks for poses by edges that do not say what they are
    if config.observation.association == "unknown":
        search = GlobalLocalisation.of(observation, landmark_map, config.search)
        search.warm_up()
    return Mcl(
        landmark_map,
        observation,
        config.mcl,
        config.motion,
        config.observation,
        odometer=Odometer(camera, config.increments),
        search=search,
        level=Level(camera, math.radians(config.edges.plumb_sigma_deg)),
    )


def identity(config: Config, landmark_map: LandmarkMap, camera: Camera) -> dict[str, str]:
    """Return what a state belongs to: settings, map and camera."""
    return identity_of(
        config.model_dump(exclude={"versions"}),
        map=replace(landmark_map, frame={}, extra=(), header={}),
        camera=replace(camera, name=""),
    )
