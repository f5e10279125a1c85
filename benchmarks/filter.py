"""How fast particles are weighed: the compiled loop beside its oracle with arrays, and a whole filter step beside LSD.

Both weigh the same particles by the same edges in one process, so that their ratio holds for other machines. World:
landmarks strewn over a square with 10 m² each, edges of those in view and as many clutter as it takes, a cloud of
0.3 m and 10°.

python benchmarks/filter.py
python benchmarks/filter.py --particles 1000 10000 100000 --observation slope
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from functools import partial
from time import perf_counter

import cv2
import numpy as np

from localiser.camera import Camera, Mount
from localiser.edges import Edges
from localiser.geometry import Increment
from localiser.inliers import InlierShare
from localiser.landmarks import LandmarkMap, sight
from localiser.motion import MotionParameters, predict
from localiser.observation import EdgeObservation, ObservationParameters
from localiser.particles import Particles, estimate, from_gaussian, take
from localiser.resampling import systematic_resample

FOCAL = 554.0
CAMERA = Camera(640, 480, FOCAL, FOCAL, 319.5, 239.5, Mount(np.radians(20), 0.9))
CLOUD = np.diag([0.3, 0.3, np.radians(10)]) ** 2
SIGMA_RAD, LEAN_SIGMA_RAD = np.radians(0.05), np.radians(0.3)


def world(landmarks: int, edges: int, rng: np.random.Generator) -> tuple[LandmarkMap, Edges]:
    """Return a map around the origin, and edges seen from there: what is in view first, the rest clutter."""
    side = np.sqrt(10.0 * landmarks)
    points = rng.uniform(-side / 2, side / 2, (landmarks, 2))
    landmark_map = LandmarkMap.from_points(points, bottom_m=np.zeros(landmarks), top_m=np.full(landmarks, 2.0))
    seen = np.arctan(sight(CAMERA, np.zeros((1, 3)), landmark_map).tangent)
    bearing = np.concatenate([seen, rng.uniform(-0.5, 0.5, edges)])[:edges]
    bearing = bearing + rng.normal(0, SIGMA_RAD, edges)
    lean = np.arctan(np.sin(CAMERA.mount.tilt_rad) * np.tan(bearing)) + rng.normal(0, LEAN_SIGMA_RAD, edges)
    foot = np.stack([FOCAL * np.tan(bearing) + 319.5, rng.uniform(250, 470, edges)], axis=-1)
    ends_px = np.stack([foot, foot - [0.0, 200.0]], axis=1)
    return landmark_map, Edges.from_columns(
        bearing, np.full(edges, SIGMA_RAD), lean, np.full(edges, LEAN_SIGMA_RAD), ends_px=ends_px
    )


def milliseconds(work: Callable[[], object], times: int) -> float:
    """Return the median time of one call."""
    taken = []
    for _ in range(times):
        begin = perf_counter()
        work()
        taken.append(1e3 * (perf_counter() - begin))
    return float(np.median(taken))


def whole_step(observation: EdgeObservation, cloud: Particles, edges: Edges, landmark_map: LandmarkMap) -> None:
    """Move, weigh, estimate and resample, as one frame does that needs no stages."""
    rng = np.random.default_rng(0)
    moved = predict(cloud, Increment.from_mean([0.0, -0.1, 0.02]), MotionParameters(), rng)
    log_weight = InlierShare.unknown().log_mean(observation.by_share(moved, edges, landmark_map))
    weighed = Particles(moved.names, moved.columns, log_weight, moved.circular)
    estimate(weighed)
    take(weighed, systematic_resample(weighed.weight, len(weighed), rng))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--observation", nargs="+", default=["line", "slope"], choices=["line", "slope"])
    parser.add_argument("--particles", nargs="+", type=int, default=[1000, 10_000])
    parser.add_argument("--landmarks", nargs="+", type=int, default=[20, 100, 500])
    parser.add_argument("--edges", nargs="+", type=int, default=[10, 30])
    parser.add_argument("--times", type=int, default=5)
    arguments = parser.parse_args()

    print("observation particles landmarks edges  compiled ms  plain ms  ratio  particles/s  largest difference")
    for kind in arguments.observation:
        observation = EdgeObservation(CAMERA, ObservationParameters(kind=kind))
        observation.warm_up()
        for count in arguments.particles:
            cloud = from_gaussian(np.zeros(3), CLOUD, count, np.random.default_rng(1))
            for landmarks in arguments.landmarks:
                for edges in arguments.edges:
                    frame = (cloud, *reversed(world(landmarks, edges, np.random.default_rng(0))))
                    paths = [partial(observation.by_share, *frame), partial(observation.by_share_plain, *frame)]
                    fast, plain = (milliseconds(path, arguments.times) for path in paths)
                    results = [InlierShare.unknown().log_mean(path()) for path in paths]
                    off = np.abs(results[0] - results[1]).max()
                    print(
                        f"{kind:11} {count:9} {landmarks:9} {edges:5} {fast:12.2f} {plain:9.1f} {plain / fast:6.1f} "
                        f"{1e3 * count / fast:12.3g}  {off:.1e}"
                    )

    image = np.random.default_rng(0).integers(0, 255, (60, 80), dtype=np.uint8)
    image = cv2.resize(image, (640, 480), interpolation=cv2.INTER_CUBIC)
    lsd = milliseconds(lambda: cv2.createLineSegmentDetector().detect(image), arguments.times)
    cloud = from_gaussian(np.zeros(3), CLOUD, 5000, np.random.default_rng(1))
    landmark_map, seen = world(100, 10, np.random.default_rng(0))
    observation = EdgeObservation(CAMERA, ObservationParameters())
    step = milliseconds(lambda: whole_step(observation, cloud, seen, landmark_map), arguments.times)
    print(
        f"a whole step, 5000 particles, 100 landmarks, 10 edges: {step:.1f} ms, {step / lsd:.2f} of LSD's {lsd:.1f} ms"
    )


if __name__ == "__main__":
    main()
