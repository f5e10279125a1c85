"""Monte Carlo localisation from the slopes of vertical edges, seen by a camera that is tilted at the floor.

The names below are the public API; docs/api.md describes them. Each is imported when it is first used.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from localiser.camera import Camera, Mount, MountSigma, RollingShutter
    from localiser.config import Config, read_config
    from localiser.edges import BearingSensor, Detector, EdgeParameters, Edges, find_edges
    from localiser.errors import InputError, LocaliserError
    from localiser.evaluate import Track
    from localiser.filter import Located, LocatedFrame, Start
    from localiser.geometry import Increment, Trajectory, Twist, compose, robot_from_map, wrap_angle
    from localiser.landmarks import LandmarkMap
    from localiser.localiser import Localiser
    from localiser.mapping import MapBuilt, build_map
    from localiser.motion import MotionModel
    from localiser.observation import Observation, Sighting
    from localiser.particles import Estimate, Particles
    from localiser.replay import Replay, Sink, evaluate_run, replay_log
    from localiser.simulate import World
    from localiser.storage import (
        ImageEvent,
        Log,
        LogReader,
        open_log,
        read_camera,
        read_map,
        simulate_log,
        write_camera,
        write_map,
    )

__version__ = "0.1.0"

_NAMES_OF = {
    "camera": ("Camera", "Mount", "MountSigma", "RollingShutter"),
    "config": ("Config", "read_config"),
    "edges": ("BearingSensor", "Detector", "EdgeParameters", "Edges", "find_edges"),
    "errors": ("InputError", "LocaliserError"),
    "evaluate": ("Track",),
    "filter": ("Located", "LocatedFrame", "Start"),
    "geometry": ("Increment", "Trajectory", "Twist", "compose", "robot_from_map", "wrap_angle"),
    "landmarks": ("LandmarkMap",),
    "localiser": ("Localiser",),
    "mapping": ("MapBuilt", "build_map"),
    "motion": ("MotionModel",),
    "observation": ("Observation", "Sighting"),
    "particles": ("Estimate", "Particles"),
    "replay": ("Replay", "Sink", "evaluate_run", "replay_log"),
    "simulate": ("World",),
    "storage": (
        "ImageEvent",
        "Log",
        "LogReader",
        "open_log",
        "read_camera",
        "read_map",
        "simulate_log",
        "write_camera",
        "write_map",
    ),
}
_HOME = {name: module for module, names in _NAMES_OF.items() for name in names}
__all__ = [*_HOME]  # noqa: PLE0604 - all of them are texts


def __getattr__(name: str) -> object:
    """Return a public name, imported from its package."""
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value: object = getattr(import_module(f"{__name__}.{_HOME[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    """Return the public names, for editors and help."""
    return sorted({*globals(), *__all__})
