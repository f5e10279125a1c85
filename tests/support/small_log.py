"""A small log with everything in it, for tests of the readers and writers."""

from pathlib import Path

import numpy as np

from localiser.camera import Camera, Mount
from localiser.edges import Edges
from localiser.filter import mcl
from localiser.geometry import Trajectory
from localiser.landmarks import LandmarkMap
from localiser.storage import Image, encode_image, write_log

CAMERA = Camera(
    width=64,
    height=48,
    fx=50.0,
    fy=51.0,
    cx=31.5,
    cy=23.5,
    mount=Mount(
        tilt_rad=np.radians(20.0),
        height_m=0.8,
        roll_rad=np.radians(1.0),
        yaw_rad=np.radians(2.0),
        right_m=0.02,
        back_m=-0.1,
    ),
    distortion_model="plumb_bob",
    distortion=(-0.25, 0.03, 1e-3, -1e-3, 0.0),
    name="small",
)
ODOMETRY = Trajectory(np.array([0, 50, 100, 150, 200]) * 10**6, np.linspace([0, 0, 3.1], [0.1, -0.4, 3.0], 5))
TRUTH = Trajectory(ODOMETRY.t_ns, np.linspace([1, 2, 3.1], [1.1, 1.6, 3.1], 5))
MAP = LandmarkMap.from_points(np.array([[0.5, -1.25], [2.0, -3.0], [-1.0, 0.1]]), name="small", ids=(7, 8, "door"))
START = mcl.Start(0, np.array([1.0, 2.0, np.radians(170.0)]), np.diag([0.1**2, 0.1**2, np.radians(3.0) ** 2]))
IMAGE_TIMES = (0, 100_000_000, 170_000_000)


def image(index: int) -> Image:
    """Return a grey image (48, 64) with texture of its own."""
    return np.random.default_rng(index).integers(0, 256, (CAMERA.height, CAMERA.width), dtype=np.uint8)


def write_small_log(folder: Path, suffix: str = ".jpg") -> Path:
    """Write the log with three images and return its folder."""
    images = ((t_ns, encode_image(image(index), suffix, 90)) for index, t_ns in enumerate(IMAGE_TIMES))
    write_log(
        folder,
        name="small",
        camera=CAMERA,
        odometry=ODOMETRY,
        images=images,
        landmark_map=MAP,
        groundtruth=TRUTH,
        start=START,
    )
    return folder


def sightings() -> list[mcl.Sighting]:
    """Return three frames of edges, the second with none."""
    bearing = np.array([-0.3, 0.4])
    edges = Edges.from_columns(
        bearing,
        np.array([0.01, 0.02]),
        np.arctan(np.sin(CAMERA.mount.tilt_rad) * np.tan(bearing)),
        np.array([0.005, 0.006]),
        length_px=np.array([40.0, np.nan]),
        polarity=np.array([1, 0], dtype=np.int8),
        landmark_id=np.array([2, -1]),
    )
    return [
        mcl.Sighting(IMAGE_TIMES[0], edges),
        mcl.Sighting(IMAGE_TIMES[1], Edges.none()),
        mcl.Sighting(IMAGE_TIMES[2], edges),
    ]


def write_edge_log(folder: Path) -> Path:
    """Write the log with edges in place of images and return its folder."""
    write_log(folder, name="small edges", camera=CAMERA, odometry=ODOMETRY, sightings=sightings(), landmark_map=MAP)
    return folder


NEWER = """\
format: localiser-map/1
name: hall
made: {by: someone, on: 2031-02-03}
frame: {axes: 'x right, y up, z backward', units: m, origin: north door}
landmarks:
- {id: 3, x: 1.25, z: -0.1, bottom_m: 0.0, top_m: 2.05, colour: [1, 2, 3]}
- {id: jamb, x: 1.0e-3, z: 7, cov: {xx: 1e-4, xz: 0.0, zz: 4e-4}, polarity: -1, source: floor plan}
"""
