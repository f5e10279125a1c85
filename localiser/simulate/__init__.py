"""Makes logs: worlds of walls, doors, posts and boxes; images, odometry and edges as a robot would record them."""

from localiser.simulate.drive import Drive, drive_of, odometry_of, truth_of
from localiser.simulate.edges import EdgeNoise, simulated_edges
from localiser.simulate.log import SimulatedLog, simulate_log
from localiser.simulate.render import Scene, expose, render, scene_of
from localiser.simulate.structure import Structure, landmarks_of, structure_of
from localiser.simulate.visible import Visible, visible_landmarks, visible_mask
from localiser.simulate.world import World, world_of

__all__ = [
    "Drive",
    "EdgeNoise",
    "Scene",
    "SimulatedLog",
    "Structure",
    "Visible",
    "World",
    "drive_of",
    "expose",
    "landmarks_of",
    "odometry_of",
    "render",
    "scene_of",
    "simulate_log",
    "simulated_edges",
    "structure_of",
    "truth_of",
    "visible_landmarks",
    "visible_mask",
    "world_of",
]
