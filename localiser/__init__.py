"""Monte Carlo localisation from the slopes of vertical edges, seen by a camera that is tilted at the floor."""

__version__ = "0.1.0"
