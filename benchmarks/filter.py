"""How fast particles are weighed, in one run and one table: the compiled loops, their oracles, and a whole filter step.

    oracle   the same model with arrays in float64, over the pairs of landmark and edge near each other
    direct   the same with arrays over all pairs, gathered by nothing, 1000 particles at a time
    pairs    particles × landmarks × edges that a second decides on, most of them by a list or a glance
    limit    share of what the machine could do if it only read the particles and wrote their log-weights

Times are CPU times of the thread, the smallest of some rounds in which all paths take turns, so that other work on the
machine hardly counts; with two threads it is the time that passes, and needs an idle machine. World: landmarks strewn
over a square with 10 m² each, edges of those in view and as many clutter as it takes, a cloud of 0.3 m and 10°. A whole
step is timed twice, bare and with all that the filter does as it ships (edges that guide, a look elsewhere, places),
along a drive through the same world, beside LSD on an image of the simulated office.

How close to the bound so many particles come is measured by benchmarks/efficiency.py --particles 300 1000 3000.

python benchmarks/filter.py
python benchmarks/filter.py --observation line slope --particles 1000 10000 --json filter.json
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from time import perf_counter, thread_time

import cv2
import numpy as np
import yaml
from rich.console import Console
from rich.table import Table
from simulated_edges import EdgeNoise, simulated_edges

from localiser.camera import Camera, Mount
from localiser.config import Config
from localiser.edges import Edges
from localiser.filter import MclParameters, Sighting
from localiser.geometry import Array, Increment, Trajectory, compose
from localiser.landmarks import LandmarkMap, in_camera, sight
from localiser.localiser import Localiser
from localiser.motion import MotionParameters, predict
from localiser.observation import EdgeObservation, ObservationParameters
from localiser.observation.inlier_rate import INLIER_RATES, InlierRate
from localiser.particles import Particles, estimate, from_gaussian, take
from localiser.particles.resampling import systematic_resample
from localiser.simulate import render, scene_of, truth_of, world_of

FOCAL = 554.0
CAMERA = Camera(640, 480, FOCAL, FOCAL, 319.5, 239.5, Mount(np.radians(20), 0.9))
CLOUD = np.diag([0.3, 0.3, np.radians(10)]) ** 2
SIGMA_RAD, LEAN_SIGMA_RAD = np.radians(0.05), np.radians(0.3)
Frame = tuple[Particles, Sighting, LandmarkMap]


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


def frame_of(count: int, landmarks: int, edges: int) -> Frame:
    """Return particles, sighting and map."""
    landmark_map, seen = world(landmarks, edges, np.random.default_rng(0))
    return from_gaussian(np.zeros(3), CLOUD, count, np.random.default_rng(1)), Sighting(0, seen), landmark_map


def fastest_ms(
    works: Sequence[Callable[[], object]], times: int, clock: Callable[[], float] = thread_time
) -> list[float]:
    """Return the smallest time of each work; they take turns."""
    taken = np.zeros((times, len(works)))
    for row in taken:
        for column, work in enumerate(works):
            begin = clock()
            work()
            row[column] = 1e3 * (clock() - begin)
    return [float(least) for least in taken.min(axis=0)]


def direct(observation: EdgeObservation, particles: Particles, sighting: Sighting, landmark_map: LandmarkMap) -> Array:
    """Return roughly what `by_rate` does, by a table of all particles × landmarks × edges: bearings alone, no ends."""
    parts, edges = [], sighting.edges
    for first in range(0, len(particles), 1000):
        poses = observation.camera.pose_in_map(particles.poses[first : first + 1000])
        right, ahead = in_camera(poses, landmark_map.points)
        square = right**2 + ahead**2
        in_view = (ahead > 0) & (np.abs(right) < 0.6 * ahead) & (square < 144.0)
        residual = edges.bearing - np.arctan2(right, ahead)[..., None]
        variance = edges.bearing_sigma**2 + (0.01**2 / square)[..., None]
        density = np.exp(-0.5 * residual**2 / variance) / np.sqrt(2 * np.pi * variance) * in_view[..., None]
        ratio = density.sum(axis=1) * (1.0 / np.maximum(in_view.sum(axis=1), 1))[:, None]
        parts.append([np.log1p(share * (ratio - 1.0)).sum(axis=1) for share in INLIER_RATES])
    return np.concatenate(parts, axis=1)


def streaming(particles: Particles, result: Array) -> float:
    """Read every particle and write as many numbers as its log-weights have."""
    np.multiply(particles.columns.sum(axis=0), 0.5, out=result[0])
    for row in result[1:]:
        np.copyto(row, result[0])
    return float(result[-1, -1])


def bare_step(
    observation: EdgeObservation,
    rng: np.random.Generator,
    cloud: Particles,
    sighting: Sighting,
    landmark_map: LandmarkMap,
) -> None:
    """Move, weigh, estimate and resample: the plain particle filter."""
    moved = predict(cloud, Increment.from_mean([0.0, -0.1, 0.02]), MotionParameters(), rng)
    log_weight = InlierRate.unknown().log_mean(observation.by_rate(moved, sighting, landmark_map))
    weighed = Particles(moved.names, moved.columns, log_weight, moved.circular)
    estimate(weighed)
    take(weighed, systematic_resample(weighed.weight, len(weighed), rng))


def rows_of(kind: str, counts: Sequence[int], landmarks: Sequence[int], edges: Sequence[int], times: int) -> list[dict]:
    """Return the figures of one observation for every number of particles, landmarks and edges."""
    observation = EdgeObservation(CAMERA, ObservationParameters(kind=kind))
    shared = EdgeObservation(CAMERA, ObservationParameters(kind=kind, threads=2))
    observation.warm_up()
    rows = []
    for count in counts:
        result = np.zeros((len(INLIER_RATES), count))
        for some in landmarks:
            for many in edges:
                frame = frame_of(count, some, many)
                rounds = max(min(times, round(3e5 / count)), 3)
                compiled = partial(observation.by_rate, *frame)
                fast, least = fastest_ms([compiled, partial(streaming, frame[0], result)], rounds)
                one, two = fastest_ms([compiled, partial(shared.by_rate, *frame)], rounds, perf_counter)
                row = {"observation": kind, "particles": count, "landmarks": some, "edges": many, "fast_ms": fast}
                row |= {"limit": least / fast, "threads": one / two, "oracle": None, "direct": None, "off": None}
                if count <= 100_000:
                    plain = partial(observation.by_rate_plain, *frame)
                    slow, again = fastest_ms([plain, compiled], 3)
                    results = [InlierRate.unknown().log_mean(path()) for path in (compiled, plain)]
                    row |= {"oracle": slow / again, "off": float(np.abs(results[0] - results[1]).max())}
                if count == 100_000 and some == 100 and kind == "line":
                    few = frame_of(5000, some, many)  # it costs the same for each particle
                    (table,) = fastest_ms([partial(direct, observation, *few)], 2)
                    row["direct"] = table * (count / 5000) / fast
                rows.append(row)
    return rows


def exponent(rows: Sequence[dict], name: str) -> float:
    """Return by which power of `name` the time grows: a least-squares fit over all rows, one level for each group."""
    groups: dict[tuple, list[tuple[float, float]]] = {}
    for row in rows:
        rest = tuple(row[key] for key in ("observation", "particles", "landmarks", "edges") if key != name)
        groups.setdefault(rest, []).append((np.log(row[name]), np.log(row["fast_ms"])))
    centred = np.concatenate([np.array(group) - np.mean(group, axis=0) for group in groups.values()])
    return float(centred[:, 0] @ centred[:, 1] / (centred[:, 0] @ centred[:, 0]))


def table_of(rows: Sequence[dict]) -> Table:
    """Return the figures as a table."""
    table = Table(title="Weighing particles: one thread")
    heads = "observation particles landmarks edges ms particles/s pairs/s oracle direct off limit two_threads"
    for head in heads.split():
        table.add_column(head.replace("_", " "), justify="left" if head == "observation" else "right")
    for row in rows:
        per_second = 1e3 * row["particles"] / row["fast_ms"]
        table.add_row(
            row["observation"],
            *(str(row[name]) for name in ("particles", "landmarks", "edges")),
            f"{row['fast_ms']:.2f}",
            f"{per_second:.3g}",
            f"{per_second * row['landmarks'] * row['edges']:.2g}",
            "" if row["oracle"] is None else f"{row['oracle']:.1f}×",
            "" if row["direct"] is None else f"{row['direct']:.0f}×",
            "" if row["off"] is None else f"{row['off']:.0e}",
            f"{100 * row['limit']:.1f} %",
            f"{row['threads']:.2f}×",
        )
    return table


def images_of_a_drive(landmarks: int, edges: int, count: int) -> Iterator[Callable[[], object]]:
    """Yield for each of `count` images what the filter as it ships does with it: 5000 particles, 0.1 m and 1° apart."""
    landmark_map, _ = world(landmarks, edges, np.random.default_rng(0))
    t_ns = np.arange(count) * 100_000_000
    poses = [np.zeros(3)]
    for _ in t_ns[1:]:
        poses.append(compose(poses[-1], np.array([0.0, -0.1, np.radians(1)])))
    rng = np.random.default_rng(1)
    noise = EdgeNoise(clutter_per_frame=0.3 * edges)
    frames = simulated_edges(landmark_map, CAMERA, Trajectory(t_ns, np.array(poses)), rng, noise=noise)

    config = Config(mcl=MclParameters(particles=5000))
    localiser = Localiser(landmark_map, CAMERA, config, seed=1)
    localiser.warm_up(images=False)
    localiser.start(poses[0], np.diag([0.05, 0.05, np.radians(2)]) ** 2, 0)
    for t, pose, seen in zip(t_ns.tolist(), poses, frames, strict=True):
        localiser.odometry(t, pose)
        yield partial(localiser.edges, t, seen.take(rng.permutation(len(seen))[:edges]))


def step_and_lsd(images: int) -> dict[str, float]:
    """Return the ms of a step of 5000 particles among 100 landmarks, bare and as it ships, and of LSD on an image.

    Medians over a drive on which the three take turns. The image is one of the simulated office, 640 × 480.
    """
    worlds = Path(__file__).resolve().parents[1] / "configs" / "worlds"
    office = world_of(yaml.safe_load((worlds / "office.yaml").read_text(encoding="utf-8")))
    image = render(scene_of(office, CAMERA), truth_of(office.drive).poses[0], np.random.default_rng(0))
    image = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
    cv2.setNumThreads(1)
    detector = cv2.createLineSegmentDetector()
    observation, rng = EdgeObservation(CAMERA, ObservationParameters()), np.random.default_rng(0)
    bare = partial(bare_step, observation, rng, *frame_of(5000, 100, 10))
    taken = []
    for shipped in images_of_a_drive(100, 10, images):
        taken.append([fastest_ms([work], 1)[0] for work in (bare, shipped, lambda: detector.detect(image))])
    bare_ms, step_ms, lsd_ms = np.median(taken[1:], axis=0)  # the first image meets a wide cloud
    return {"bare_ms": float(bare_ms), "step_ms": float(step_ms), "lsd_ms": float(lsd_ms)}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--observation", nargs="+", default=["line"], choices=["line", "slope"])
    parser.add_argument("--particles", nargs="+", type=int, default=[1000, 10_000, 100_000, 1_000_000])
    parser.add_argument("--landmarks", nargs="+", type=int, default=[20, 100, 500])
    parser.add_argument("--edges", nargs="+", type=int, default=[10, 30])
    parser.add_argument("--times", type=int, default=15, help="rounds at most")
    parser.add_argument("--images", type=int, default=60, help="of the drive that whole steps are timed on")
    parser.add_argument("--json", type=Path, help="where to write all figures")
    arguments = parser.parse_args()
    console = Console()
    rows: list[dict] = []
    for kind in arguments.observation:
        with console.status(f"Tempering by {kind}"):
            rows += rows_of(kind, arguments.particles, arguments.landmarks, arguments.edges, arguments.times)
    with console.status("Following a drive"):
        steps = step_and_lsd(arguments.images)
    Console(width=None if console.is_terminal else 150).print(table_of(rows))
    growth = {
        name: exponent(rows, name)
        for name in ("particles", "landmarks", "edges")
        if len({row[name] for row in rows}) > 1
    }
    console.print("grows as " + ", ".join(f"{name}^{power:.2f}" for name, power in growth.items()))
    lsd_ms = steps["lsd_ms"]
    for name, what in (("bare_ms", "moved, weighed, resampled"), ("step_ms", "as the filter ships")):
        console.print(
            f"a step, 5000 particles, 100 landmarks, 10 edges, {what}: {steps[name]:.2f} ms, "
            f"1/{lsd_ms / steps[name]:.1f} of LSD's {lsd_ms:.1f} ms"
        )
    if arguments.json:
        figures = {"rows": rows, "growth": growth} | steps
        arguments.json.write_text(json.dumps(figures, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
