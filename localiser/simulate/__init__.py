"""Makes logs: worlds of walls, doors, posts and boxes; images, odometry and edges as a robot would record them."""

from localiser.simulate.edges import EdgeNoise, simulated_edges

__all__ = ["EdgeNoise", "simulated_edges"]
