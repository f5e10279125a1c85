"""How fast particles are weighed, and how long a whole step of the filter takes, by particles, landmarks and edges.

    step     moved, weighed, estimated and resampled: the plain particle filter, ms

Times are CPU times of the thread, the smallest of some rounds in which all paths take turns, so that other work on the
machine hardly counts. World: landmarks strewn over a square with 10 m² each, edges of those in view and as many clutter
as it takes, a cloud of 0.3 m and 10°.

python benchmarks/speed.py
python benchmarks/speed.py --observation slope --particles 1000 10000
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from functools import partial
from itertools import product
from time import thread_time

import numpy as np
from rich.console import Console
from rich.table import Table

from localiser.camera import Camera, Mount
from localiser.edges import Edges
from localiser.filter import Sighting
from localiser.geometry import Increment
from localiser.landmarks import LandmarkMap, sight
from localiser.motion import MotionParameters
from localiser.observation import EdgeObservation, ObservationParameters
from localiser.observation.inlier_rate import InlierRate
from localiser.particles import Particles, from_gaussian, systematic_resample, take

FOCAL = 554.0
CAMERA = Camera(640, 480, FOCAL, FOCAL, 319.5, 239.5, Mount(np.radians(20), 0.9))
CLOUD = np.diag([0.3, 0.3, np.radians(10)]) ** 2
SIGMA_RAD, LEAN_SIGMA_RAD = np.radians(0.05), np.radians(0.3)
Frame = tuple[Particles, Sighting, LandmarkMap]


def frame_of(count: int, landmarks: int, edges: int) -> Frame:
    """Return particles, what is seen from the origin (what is in view first, the rest clutter), and the map."""
    rng = np.random.default_rng(0)
    side = np.sqrt(10.0 * landmarks)
    points = rng.uniform(-side / 2, side / 2, (landmarks, 2))
    landmark_map = LandmarkMap.from_points(points, bottom_m=np.zeros(landmarks), top_m=np.full(landmarks, 2.0))
    seen = np.arctan(sight(CAMERA, np.zeros((1, 3)), landmark_map).tangent)
    bearing = np.concatenate([seen, rng.uniform(-0.5, 0.5, edges)])[:edges] + rng.normal(0, SIGMA_RAD, edges)
    lean = np.arctan(np.sin(CAMERA.mount.tilt_rad) * np.tan(bearing)) + rng.normal(0, LEAN_SIGMA_RAD, edges)
    foot = np.stack([FOCAL * np.tan(bearing) + 319.5, rng.uniform(250, 470, edges)], axis=-1)
    sigmas = np.full(edges, SIGMA_RAD), np.full(edges, LEAN_SIGMA_RAD)
    found = Edges.from_columns(bearing, sigmas[0], lean, sigmas[1], ends_px=np.stack([foot, foot - [0, 200]], axis=1))
    return from_gaussian(np.zeros(3), CLOUD, count, np.random.default_rng(1)), Sighting(0, found), landmark_map


def fastest_ms(works: Sequence[Callable[[], object]], times: int) -> list[float]:
    """Return the smallest time of each work; they take turns."""
    taken = np.zeros((times, len(works)))
    for row in taken:
        for column, work in enumerate(works):
            begin = thread_time()
            work()
            row[column] = 1e3 * (thread_time() - begin)
    return [float(least) for least in taken.min(axis=0)]


def step(observation: EdgeObservation, rng: np.random.Generator, frame: Frame) -> None:
    """Move, weigh, estimate and resample: the plain particle filter."""
    cloud, sighting, landmark_map = frame
    moved = MotionParameters().predict(cloud, Increment.from_mean([0.0, -0.1, 0.02]), rng)
    log_weight = InlierRate.unknown().log_mean(observation.by_rate(moved, sighting, landmark_map))
    weighed = Particles(moved.names, moved.columns, log_weight)
    _ = weighed.estimate
    take(weighed, systematic_resample(weighed.weight, len(weighed), rng))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--observation", default="line", choices=["line", "slope"])
    parser.add_argument("--particles", nargs="+", type=int, default=[2000, 10_000, 100_000])
    parser.add_argument("--landmarks", nargs="+", type=int, default=[20, 100, 500])
    parser.add_argument("--edges", nargs="+", type=int, default=[10, 30])
    parser.add_argument("--times", type=int, default=15, help="rounds at most")
    arguments = parser.parse_args()
    observation = EdgeObservation(CAMERA, ObservationParameters(kind=arguments.observation))
    observation.warm_up()
    heads = ("particles", "landmarks", "edges", "weighing ms", "particles/s", "step ms")
    table = Table(*heads, title=f"{arguments.observation}, one thread")
    for count, landmarks, edges in product(arguments.particles, arguments.landmarks, arguments.edges):
        frame = frame_of(count, landmarks, edges)
        works = [partial(observation.by_rate, *frame), partial(step, observation, np.random.default_rng(0), frame)]
        weighing, stepping = fastest_ms(works, max(min(arguments.times, round(3e5 / count)), 3))
        cells = (f"{weighing:.2f}", f"{1e3 * count / weighing:.3g}", f"{stepping:.2f}")
        table.add_row(str(count), str(landmarks), str(edges), *cells)
    Console().print(table)


if __name__ == "__main__":
    main()
