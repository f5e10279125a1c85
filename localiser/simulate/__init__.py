"""Makes logs: worlds of walls, doors, posts and boxes; images, odometry and edges as a robot would record them."""

from localiser.simulate.drive import odometry_of, truth_of
from localiser.simulate.log import SimulatedLog, simulated_log
from localiser.simulate.render import Scene, render, scene_of
from localiser.simulate.solids import Solids, clearance_m, solids_of
from localiser.simulate.structure import structure_of, vertical_edges, visible_landmarks
from localiser.simulate.world import World, world_of
