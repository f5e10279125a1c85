"""Edges of one room as seen from several poses, simulated from the equations alone."""

import numpy as np
from cameras import vga_camera

from localiser import geometry
from localiser.camera import Mount
from localiser.edges import Edges
from localiser.geometry import Array

CAMERA = vga_camera(Mount(np.radians(20.0), 0.9, yaw_rad=np.radians(3.0), right_m=0.05, back_m=-0.1))
BEARING_SIGMA, INVERSE_SIGMA = np.radians(0.02), 0.004
POINTS = np.array(
    [
        [-1.5, -3.0],
        [-1.4, -4.5],
        [-0.8, -2.6],
        [-0.3, -6.0],
        [0.2, -3.4],
        [0.6, -5.2],
        [1.1, -2.9],
        [1.6, -4.0],
        [2.2, -4.9],
    ]
)


def edges_from(pose: Array, rng: np.random.Generator, points: Array = POINTS, feet: bool = True) -> Edges:
    """Return what a robot at `pose` sees of edges at `points` (E, 2), each with a look of its own."""
    at = geometry.robot_from_map(CAMERA.pose_in_map(pose), points)
    bearing = np.arctan2(at[:, 0], -at[:, 1]) + BEARING_SIGMA * rng.standard_normal(len(points))
    inverse = 1.0 / np.hypot(*at.T) + INVERSE_SIGMA * rng.standard_normal(len(points))
    unknown = np.full(len(points), np.nan)
    look = np.random.default_rng(1).uniform(0, 255, (len(POINTS) + 20, 8))[: len(points)]
    return Edges.from_columns(
        bearing,
        np.full(len(points), BEARING_SIGMA),
        unknown,
        unknown,
        polarity=np.where(np.arange(len(points)) % 2, 1, -1).astype(np.int8),
        foot_range_m=1.0 / inverse if feet else unknown,
        foot_range_sigma_m=INVERSE_SIGMA / inverse**2 if feet else unknown,
        profile=look,
    )
