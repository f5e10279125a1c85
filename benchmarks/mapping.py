"""Accuracy of maps: simulated drives with known poses, and logs with nothing but odometry.

python benchmarks/mapping.py known              # edges simulated on the drives through configs/worlds
python benchmarks/mapping.py laps               # two laps with wheels 4 % wrong, nothing else known
python benchmarks/mapping.py long               # time and memory, two to ten minutes through the office
python benchmarks/mapping.py long --times 24 48 # half an hour, an hour
python benchmarks/mapping.py nees LOG…          # covariances against exact edges, poses known
python benchmarks/mapping.py slam LOG…          # logs with true poses, which are used to judge only
python benchmarks/mapping.py bearings LOG…      # logs of coarse bearings with true poses, and a map to judge by
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from time import process_time

import mrclam
import numpy as np
from coarse_bearings import matched

from localiser import documents, mapping, simulate
from localiser.camera import Camera
from localiser.config import read_config
from localiser.edges import Edges
from localiser.errors import InputError
from localiser.geometry import Array, map_from_robot, private_folder, robot_from_map, wrap_angle
from localiser.landmarks import LandmarkMap
from localiser.mapping import (
    Built,
    MappingParameters,
    Prior,
    Sightings,
    build_map,
    direction_of,
    edges_of_log,
    wheels_of,
)
from localiser.mapping.landmarks import fit_landmarks
from localiser.motion import MotionParameters
from localiser.storage import Log, open_log

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "tests" / "support"))

PRIOR = Prior.of(MotionParameters())
WORLDS = Path(__file__).resolve().parent.parent / "configs" / "worlds"
_NEAR_M, _SEARCHED_M, _POINTED_PX = 0.05, 0.5, 2.0


def known(seeds: range, clutter: float) -> None:
    """Print how good maps of simulated edges are when poses are known."""
    from mapping_worlds import world

    print("| world | seed | landmarks | median m | 95 % m | found | spurious | honesty |")
    for name in ("corridor", "office"):
        drive = world(name)
        for seed in seeds:
            edges = drive.edges(seed, clutter)
            made = from_known_poses(drive, edges)
            apart = np.linalg.norm(made.points[:, None] - drive.landmark_map.points[None], axis=-1)
            error, offset = apart.min(axis=1), made.points - drive.landmark_map.points[apart.argmin(axis=1)]
            nees = np.einsum("li,lij,lj->l", offset, np.linalg.inv(made.cov), offset)
            found = (apart[:, drive.seen_from_apart(edges, 6.0)].min(axis=0) < 0.06).mean()
            honesty = np.sqrt(np.median(nees) / (2 * np.log(2)))
            print(
                f"| {name} | {seed} | {len(made)} | {np.median(error):.4f} | {np.quantile(error, 0.95):.4f} | "
                f"{found:.3f} | {(error > 0.2).mean():.3f} | {honesty:.2f} |"
            )


def from_known_poses(drive: object, edges: list) -> LandmarkMap:
    """Return the map that edges give at the drive's true poses."""
    parameters = MappingParameters()
    cameras = drive.camera.pose_in_map(drive.truth.poses)
    sightings = Sightings.from_edges(edges, drive.camera)
    track = mapping.follow(sightings, cameras, np.full(len(cameras), 1e-3), parameters.tracks)
    sigma = mapping.measured_sigma(sightings, drive.camera.focal_px, parameters)
    built = mapping.build_from_poses(sightings, track, cameras, sigma, parameters)
    return mapping.landmark_map_of(sightings, built, cameras, sigma, drive.camera, parameters, "", "")


def two_laps(seeds: range, clutter: float) -> None:
    """Print how good maps of simulated edges are when nothing is known but odometry; seconds of one processor."""
    from mapping_worlds import laps, with_looks

    print(
        "| world | seed | images | wheels, RMSE m | alone, RMSE m | landmarks | median m | 95 % m | ghosts | seconds |"
    )
    for name in ("corridor", "office"):
        for seed in seeds:
            drive = laps(name, seed)
            edges = with_looks(drive.edges(seed, clutter), len(drive.landmark_map), seed)
            sightings, parameters = Sightings.from_edges(edges, drive.camera), MappingParameters()
            wheels = wheels_of(drive.odometry, drive.truth.t_ns, MotionParameters())
            begin = process_time()
            found = mapping.build_from_log(sightings, wheels, PRIOR, np.zeros(3), drive.camera, parameters)
            seconds = process_time() - begin
            cameras = found.cameras
            made = mapping.landmark_map_of(
                sightings, found.built, cameras, found.sigma, drive.camera, parameters, "", ""
            )
            truth = drive.truth.poses
            lay = rigid(found.poses, truth)
            apart = np.linalg.norm(lay(made.points)[:, None] - drive.landmark_map.points[None], axis=-1).min(axis=1)
            error = np.linalg.norm(lay(found.poses[:, :2]) - truth[:, :2], axis=1)
            odometry = aligned(drive.odometry.sampled(drive.truth.t_ns).poses, truth)
            print(
                f"| {name} | {seed} | {len(edges)} | {np.sqrt((odometry**2).mean()):.2f} | "
                f"{np.sqrt((error**2).mean()):.3f} | {len(made)} | {np.median(apart):.4f} | "
                f"{np.quantile(apart, 0.95):.4f} | {ghosts(made, found.built, edges):.3f} | {seconds:.0f} |",
                flush=True,
            )


def long(times_driven: Sequence[int]) -> None:
    """Print what longer and longer logs cost: seconds of one processor, and memory beyond that of the log itself."""
    from mapping_worlds import laps, with_looks

    print("| images | edges | poses known, seconds | alone, seconds | RMSE m | memory, MB |")
    for times in times_driven:
        drive = laps("office", 0, times=times)
        edges = with_looks(drive.edges(0), len(drive.landmark_map), 0)
        begin = process_time()
        from_known_poses(drive, edges)
        known_s = process_time() - begin
        sightings, wheels = (
            Sightings.from_edges(edges, drive.camera),
            wheels_of(drive.odometry, drive.truth.t_ns, MotionParameters()),
        )
        with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as fresh:
            poses, alone_s, memory_mb = fresh.submit(alone, sightings, wheels, drive.camera).result()
        error = aligned(poses, drive.truth.poses)
        print(
            f"| {len(edges)} | {len(sightings)} | {known_s:.0f} | {alone_s:.0f} | "
            f"{np.sqrt((error**2).mean()):.4f} | {memory_mb:.0f} |",
            flush=True,
        )


def alone(sightings: Sightings, wheels: mapping.Steps, camera: Camera) -> tuple[Array, float, float]:
    """Return the poses (T, 3) that edges and wheels give, seconds of one processor, and MB that this process grew."""
    begin, before = process_time(), most_memory_mb()
    poses = mapping.build_from_log(sightings, wheels, PRIOR, np.zeros(3), camera, MappingParameters()).poses
    return poses, process_time() - begin, most_memory_mb() - before


def most_memory_mb() -> float:
    """Return the most memory that this process ever took, as Linux counts it; what `getrusage` has begins before it."""
    lines = Path("/proc/self/status").read_text(encoding="ascii").splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith("VmHWM")) / 1024


def ghosts(made: LandmarkMap, built: Built, edges: list) -> float:
    """Return the share of landmarks that stand within 0.1 m of another whose sightings are mostly of the same one."""
    owner = np.concatenate([frame.landmark_id for frame in edges])[built.used]
    votes = np.zeros((len(built), int(owner.max()) + 2), dtype=int)
    np.add.at(votes, (built.of[built.used], owner), 1)
    kept = np.linalg.norm(made.points[:, None] - built.fit.points[None], axis=-1).argmin(axis=1)
    own = votes.argmax(axis=1)[kept]
    near = np.linalg.norm(made.points[:, None] - made.points[None], axis=-1) < 0.1
    same = near & (own[:, None] == own[None]) & (own < votes.shape[1] - 1)[:, None]
    return float(np.triu(same, k=1).sum() / max(len(made), 1))


def nees(logs: list[Path]) -> None:
    """Print how far landmarks of logs with exact edges are off in units of their covariances, poses known.

    Exact are the edges_exact.csv of a log, else those of the world in configs/worlds that has its name. Which edge a
    landmark is of is told in two ways: the nearest within 0.05 m, or the likeliest of those that most of its sightings
    point at to two pixels.
    """
    print("| log | landmarks | edge by | of an edge | error, median m | 95 % | NEES, mean | median | over 13.8 |")
    for path in logs:
        log = open_log(path)
        config = read_config(None, [], log.settings)
        built = build_map(log, "truth", config, edges_of=kept_edges)
        exact = exact_edges(path, log.name)
        for name, edge in (
            ("place", nearest_edge(built, exact)),
            ("sightings", edge_of_sightings(built, exact, log.camera)),
        ):
            known = edge >= 0
            off = (built.landmark_map.points - exact[edge])[known]
            error = np.linalg.norm(off, axis=1)
            scaled = np.einsum("li,lij,lj->l", off, np.linalg.inv(built.landmark_map.cov[known]), off)
            print(
                f"| {log.name} | {len(edge)} | {name} | {known.sum()} | {np.median(error):.4f} | "
                f"{np.quantile(error, 0.95):.4f} | {scaled.mean():.2f} | {np.median(scaled):.2f} | "
                f"{(scaled > 13.8).mean():.3f} |",
                flush=True,
            )


def kept_edges(log: Log) -> list[Edges]:
    """Return the edges of a log, which are found once."""
    config = read_config(None, [], log.settings)
    return edges_of_log(log, config.edges, cache=private_folder("edges"))


def exact_edges(log: Path, name: str) -> Array:
    """Return the exact vertical edges (M, 2) of a log's world."""
    if (log / "edges_exact.csv").exists():
        columns = np.genfromtxt(log / "edges_exact.csv", delimiter=",", names=True)
        return np.stack([columns["x"], columns["z"]], axis=-1)
    world = documents.validate(documents.load(WORLDS / f"{name}.yaml"), simulate.World, simulate.world_of)
    return simulate.structure_of(world).edges.points


def nearest_edge(built: mapping.MapBuilt, exact: Array) -> Array:
    """Return for each landmark (L,) the nearest of exact edges (M, 2), -1 where none is within 0.05 m."""
    apart = np.linalg.norm(built.landmark_map.points[:, None] - exact[None], axis=-1)
    return np.where(apart.min(axis=1) < _NEAR_M, apart.argmin(axis=1), -1)


def edge_of_sightings(built: mapping.MapBuilt, exact: Array, camera: Camera) -> Array:
    """Return for each landmark (L,) which of exact edges (M, 2) most of its sightings point at, -1 for none.

    Of several that is the likeliest by the landmark's covariance.
    """
    landmarks, whole, sightings = built.landmark_map, built.built, built.sightings
    cameras = sightings.camera_poses(camera, built.trajectory.poses)
    heading, good = cameras[sightings.frame, 2] - sightings.bearing, whole.fit.weight > 0.5
    result = np.full(len(landmarks), -1)
    for landmark, own in enumerate(built.kept):
        seen = whole.used[(whole.of[whole.used] == own) & good]
        near = np.flatnonzero(np.linalg.norm(exact - landmarks.points[landmark], axis=1) < _SEARCHED_M)
        off = landmarks.points[landmark] - exact[near]
        likeliest = np.einsum("mi,ij,mj->m", off, np.linalg.inv(landmarks.cov[landmark]), off).argsort()
        for edge in near[likeliest]:
            expected, _ = direction_of(np.tile(exact[edge], (len(seen), 1)), cameras[sightings.frame[seen]])
            within = 3 * sightings.sigma[seen] + _POINTED_PX / camera.focal_px
            if (np.abs(wrap_angle(heading[seen] - expected)) < within).mean() > 0.5:
                result[landmark] = edge
                break
    return result


def slam(logs: list[Path]) -> None:
    """Print how far the trajectory of logs alone is from the truth, after the best rotation and translation.

    Landmarks are judged as they stand to the first pose, where the map begins: their NEES, by covariances of theirs.
    """
    print("| log | wheels, RMSE m | alone, RMSE m | largest m | landmarks | of an edge | NEES | seconds after edges |")
    for path in logs:
        log = open_log(path)
        config = read_config(None, [], log.settings)
        kept_edges(log)  # so that they are in the cache
        begin = process_time()
        built = build_map(log, "slam", config, edges_of=kept_edges)
        seconds = process_time() - begin
        t_ns = built.trajectory.t_ns
        truth = log.groundtruth.sampled(t_ns).poses
        wheels, alone = aligned(log.odometry.sampled(t_ns).poses, truth), aligned(built.trajectory.poses, truth)
        print(
            f"| {log.name} | {np.sqrt((wheels**2).mean()):.3f} | {np.sqrt((alone**2).mean()):.3f} | "
            f"{alone.max():.3f} | {len(built.landmark_map)} | {nees_from_start(built, log, path)} | {seconds:.1f} |",
            flush=True,
        )


def nees_from_start(built: mapping.MapBuilt, log: Log, path: Path) -> str:
    """Return two cells: how many landmarks are known to be of an edge, and their mean NEES, seen from the first pose.

    A landmark is of the exact edge that is where its sightings meet at the true poses, within 0.05 m.
    """
    try:
        exact = exact_edges(path, log.name)
    except InputError:
        return "– | –"
    truth = log.groundtruth.sampled(built.trajectory.t_ns).poses
    true_cameras = built.sightings.camera_poses(log.camera, truth)
    met = fit_landmarks(built.sightings, built.built.of, true_cameras, built.sightings.sigma).fit.points
    apart = np.linalg.norm(met[built.kept][:, None] - exact[None], axis=-1)
    known = apart.min(axis=1) < _NEAR_M
    of_start = robot_from_map(truth[0], exact[apart.argmin(axis=1)])
    off = built.landmark_map.points - map_from_robot(built.trajectory.poses[0], of_start)
    scaled = np.einsum("li,lij,lj->l", off, np.linalg.inv(built.landmark_map.cov), off)[known]
    return f"{known.sum()} | {scaled.mean():.2f}"


def bearings(logs: list[Path]) -> None:
    """Print how many landmarks are found by bearings from known poses; each is matched with one of its own."""
    print("| log | landmarks | built | within 0.25 m | within 0.1 m | median m | seconds |")
    for path in logs:
        log = open_log(path)
        begin = process_time()
        made = build_map(log, "truth", read_config(None, [], log.settings), edges_of=kept_edges).landmark_map
        seconds = process_time() - begin
        error = matched(log.landmark_map.points, made.points)
        print(
            f"| {log.name} | {len(error)} | {len(made)} | {(error < 0.25).sum()} | {(error < 0.1).sum()} | "
            f"{np.median(error):.3f} | {seconds:.1f} |"
        )


def aligned(found: Array, truth: Array) -> Array:
    """Return the distances (T,) of poses (T, 3) after the best rotation and translation."""
    return np.linalg.norm(rigid(found, truth)(found[:, :2]) - truth[:, :2], axis=1)


def rigid(found: Array, truth: Array) -> Callable[[Array], Array]:
    """Return the motion of points (K, 2) that brings poses (T, 3) nearest to the truth."""
    middle, other = found[:, :2].mean(axis=0), truth[:, :2].mean(axis=0)
    left, _, right = np.linalg.svd((found[:, :2] - middle).T @ (truth[:, :2] - other))
    sign = np.array([1.0, np.linalg.det(left @ right)])
    turn = left @ np.diag(sign) @ right
    return lambda points: (points - middle) @ turn + other


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    mrclam.register()  # and the builder for coarse bearings
    parser.add_argument("what", choices=("known", "laps", "long", "nees", "slam", "bearings"))
    parser.add_argument("logs", nargs="*", type=Path)
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--clutter", type=float, default=3.0)
    parser.add_argument("--times", type=int, nargs="+", default=(2, 4, 8), help="drives along the path, for `long`")
    arguments = parser.parse_args()
    if arguments.what == "known":
        known(range(arguments.seeds), arguments.clutter)
    elif arguments.what == "laps":
        two_laps(range(arguments.seeds), arguments.clutter)
    elif arguments.what == "long":
        long(arguments.times)
    elif arguments.what == "nees":
        nees(arguments.logs)
    elif arguments.what == "slam":
        slam(arguments.logs)
    else:
        bearings(arguments.logs)
