"""Makes logs: worlds of walls, doors, posts and boxes; images, odometry and edges as a robot would record them."""

from localiser.simulate.edges import EdgeNoise, simulated_edges
from localiser.simulate.render import Scene, expose, render, scene_of
from localiser.simulate.structure import landmarks_of
from localiser.simulate.world import World, world_of

__all__ = [
    "EdgeNoise",
    "Scene",
    "World",
    "expose",
    "landmarks_of",
    "render",
    "scene_of",
    "simulated_edges",
    "world_of",
]
