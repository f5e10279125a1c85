"""How often one frame alone tells where the robot is, on simulated edges with clutter as images have it.

For frames along a world's drive, the robot turned and moved aside at random: a hit is a proposed pose within 0.25 m and
5° of the true one. `first` is a hit by the heaviest proposal. `elsewhere` is the share of frames that a pose elsewhere
explains better (by 3 in log-likelihood) than the true pose does: there, no method can tell from that frame. `places`
are the clusters of at least 1 % that weighted draws from the proposals leave, `effective` the share of draws that
count, and `within` the hits by any of the first 1, 2, 3, 5 frames of a stretch of the drive.

python benchmarks/proposals.py
python benchmarks/proposals.py --world office --observation line --clutter 30
"""

from __future__ import annotations

import argparse
import time
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import yaml
from simulated_edges import EdgeNoise, simulated_edges, visible_mask

from localiser import geometry
from localiser.camera import Camera
from localiser.edges import Edges
from localiser.geometry import Array, Trajectory
from localiser.landmarks import LandmarkMap
from localiser.observation import EdgeObservation, ObservationParameters, Sighting
from localiser.particles import POSE, Particles, effective_sample_size, normalised
from localiser.particles.clusters import find_clusters
from localiser.relocalisation import Places, propose, view_of, warm_up
from localiser.simulate import structure_of, truth_of, world_of

WORLDS = Path(__file__).resolve().parents[1] / "configs" / "worlds"
STRETCH = 5
FEWEST = 4  # landmark edges of a frame that counts


@dataclass(frozen=True, slots=True, eq=False)
class Setting:
    """A world seen from F frames, in stretches of successive ones."""

    landmark_map: LandmarkMap
    camera: Camera
    poses: Array
    frames: list[Edges]


@dataclass(frozen=True, slots=True)
class Found:
    """What one frame gave; see the head of this file."""

    landmarks: int
    edges: int
    hit: bool
    first: bool
    elsewhere: bool
    places: int
    effective: float
    duration_ms: float


def setting_of(name: str, stretches: int, clutter: float, turned: float | None, seed: int) -> Setting:
    """Return `stretches` of successive frames, each from an own random place beside the drive.

    The map holds what the drive itself sees, as that of a recorded log does. turned: share of edges whose polarity is
    not that of their landmark, which is drawn; None where polarity is unknown.
    """
    world = world_of(yaml.safe_load((WORLDS / f"{name}.yaml").read_text()))
    structure, camera, truth = structure_of(world), world.camera.camera(), truth_of(world.drive)
    t_ns = np.arange(truth.t_ns[0], truth.t_ns[-1], round(1e9 / world.drive.image_hz))
    drive = truth.sampled(t_ns).poses
    rng = np.random.default_rng(seed)
    start = rng.integers(0, len(drive) - STRETCH, stretches)
    aside = rng.uniform([-0.2, -0.2, -np.pi / 4], [0.2, 0.2, np.pi / 4], (stretches, 1, 3))
    poses = geometry.compose(drive[start[:, None] + np.arange(STRETCH)], aside).reshape(-1, 3)
    everything, seen = structure.landmark_map, visible_mask(structure, camera, drive[::2]).any(axis=0)
    landmark_map = LandmarkMap.from_points(
        everything.points[seen], bottom_m=everything.bottom_m[seen], top_m=everything.top_m[seen], name=name
    )
    if turned is not None:
        polarity = np.random.default_rng([seed, 1]).choice(np.array([-1, 1], dtype=np.int8), len(landmark_map))
        landmark_map = replace(landmark_map, polarity=polarity)
    frames = simulated_edges(
        landmark_map,
        camera,
        Trajectory(np.arange(len(poses)), poses),
        rng,
        noise=EdgeNoise(detection_probability=0.7, clutter_per_frame=clutter, turned_probability=turned or 0.0),
        visible=visible_mask(structure, camera, poses)[:, seen],
    )
    return Setting(landmark_map, camera, poses, frames)


def found(setting: Setting, places: Places, index: int, kind: str) -> Found:
    """Return what proposals from one frame are worth."""
    edges, truth, rng = setting.frames[index], setting.poses[index], np.random.default_rng(index)
    observation = EdgeObservation(setting.camera, ObservationParameters(kind=kind))

    def log_likelihood(poses: Array) -> Array:
        particles = Particles(POSE, poses.T, np.zeros(len(poses)))
        return observation.log_likelihood(particles, Sighting(0, edges), setting.landmark_map)

    start = time.process_time()
    proposals = propose(view_of(setting.camera, edges, kind), places, log_likelihood, rng)
    duration_ms = 1e3 * (time.process_time() - start)
    near = beside(proposals.mean, truth)
    others = proposals.mean[~beside(proposals.mean, truth, metres=0.5, degrees=10.0)]
    better = log_likelihood(others).max(initial=-np.inf) > log_likelihood(truth[None])[0] + 3
    poses, log_weight = proposals.drawn(2000, rng)
    weight = normalised(log_weight + log_likelihood(poses))
    return Found(
        landmarks=int((edges.landmark_id >= 0).sum()),
        edges=len(edges),
        hit=bool(near.any()),
        first=bool(near[:1].any()),
        elsewhere=bool(better),
        places=int((find_clusters(poses, weight).weight >= 0.01).sum()),
        effective=effective_sample_size(weight) / len(weight),
        duration_ms=duration_ms,
    )


def beside(poses: Array, truth: Array, metres: float = 0.25, degrees: float = 5.0) -> Array:
    """Return which of the poses (N, 3) are that near the true one."""
    turned = np.abs(geometry.wrap_angle(poses[:, 2] - truth[2]))
    return (np.hypot(poses[:, 0] - truth[0], poses[:, 1] - truth[1]) < metres) & (turned < np.radians(degrees))


def row_of(results: list[Found]) -> str:
    """Return a row of the table; all but `within` is of frames with enough landmark edges."""
    good = [one for one in results if one.landmarks >= FEWEST]
    hits = np.array([one.hit for one in results]).reshape(-1, STRETCH)
    within = " ".join(f"{hits[:, :count].any(axis=1).mean():4.0%}" for count in (1, 2, 3, 5))
    clutter = 1 - sum(one.landmarks for one in results) / max(sum(one.edges for one in results), 1)
    shares = [np.mean([getattr(one, name) for one in good]) for name in ("hit", "first", "elsewhere")]
    # Half the width of a 95 % interval of the share of hits.
    doubt = 1.96 * np.sqrt(shares[0] * (1 - shares[0]) / len(good))
    middle = [np.median([getattr(one, name) for one in good]) for name in ("edges", "places", "effective")]
    duration_ms = np.array([one.duration_ms for one in results])
    return (
        f"{len(good):6} {middle[0]:5.0f} {clutter:7.0%}  {shares[0]:4.0%} ± {doubt:3.0%} {shares[1]:6.0%} "
        f"{shares[2]:10.0%} {middle[1]:7.0f} {middle[2]:10.1%}  {within}  "
        f"{np.median(duration_ms):4.0f} {np.percentile(duration_ms, 95):4.0f}"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--world", nargs="+", default=["office", "corridor"])
    parser.add_argument("--observation", nargs="+", default=["line", "slope"], choices=["line", "slope"])
    parser.add_argument("--clutter", nargs="+", type=float, default=[15.0], help="mean number of false edges a frame")
    parser.add_argument(
        "--turned", type=float, help="share of edges with another polarity than the map has; by default none is known"
    )
    parser.add_argument("--stretches", type=int, default=40, help="each of five frames")
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    print("world    seen by  frames edges clutter  hit        first  elsewhere  places  effective  within 1, 2, 3, 5")
    print(f"{'':85}frames               ms  95 %")
    for world in arguments.world:
        for clutter in arguments.clutter:
            setting = setting_of(world, arguments.stretches, clutter, arguments.turned, arguments.seed)
            places = Places.of(setting.landmark_map, setting.camera)
            warm_up(view_of(setting.camera, setting.frames[0]), places)
            for kind in arguments.observation:
                results = [found(setting, places, index, kind) for index in range(len(setting.frames))]
                print(f"{world:8} {kind:7} {row_of(results)}", flush=True)


if __name__ == "__main__":
    main()
