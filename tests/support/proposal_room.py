"""A room with landmarks of known heights, for the tests of proposals."""

import numpy as np
from simulated_edges import EdgeNoise, simulated_edges

from localiser.camera import Camera, Mount
from localiser.geometry import Trajectory
from localiser.landmarks import LandmarkMap

CAMERA = Camera(640, 480, 554.0, 554.0, 319.5, 239.5, Mount(np.radians(20.0), 0.9, yaw_rad=0.03, back_m=-0.1))


def room(count=40, seed=0):
    """Landmarks in 8 m × 6 m: most stand on the floor, some begin above it."""
    rng = np.random.default_rng(seed)
    bottom = np.where(rng.random(count) < 0.7, 0.0, rng.uniform(0.2, 0.6, count))
    return LandmarkMap.from_points(
        rng.uniform([-4, -3], [4, 3], (count, 2)), bottom_m=bottom, top_m=bottom + rng.uniform(0.8, 2.0, count)
    )


def drawn_frames(landmark_map, count, seed, clutter=0.0, camera=CAMERA):
    """Poses (count, 3) in the room and what the camera sees there."""
    rng = np.random.default_rng(seed)
    poses = rng.uniform([-3.5, -2.5, -np.pi], [3.5, 2.5, np.pi], (count, 3))
    noise = EdgeNoise(detection_probability=0.8, clutter_per_frame=clutter)
    return poses, simulated_edges(landmark_map, camera, Trajectory(np.arange(count), poses), rng, noise=noise)
