"""How close the filter comes to the limit of accuracy, and whether it knows how good it is, on simulated edges.

Everything is as the filter assumes it: the first pose is drawn from the start's covariance, the robot strays from its
odometry by draws of the motion model, edges err independently by the sigmas that they state. The bound knows which
landmark each edge belongs to. With association `known` the filter is told that too, and what is left between RMSE and
bound is the particles' doing; with `unknown` it is the mixture's as well.

python benchmarks/efficiency.py --jobs 2
python benchmarks/efficiency.py --observation line --association known --particles 500 2000 8000
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from typing import Literal

import numpy as np
import yaml
from joblib import Parallel, delayed
from numpy.typing import NDArray
from scipy.stats import chi2
from simulated_edges import simulated_edges, visible_mask

from localiser import evaluate, geometry, motion
from localiser.camera import Camera
from localiser.edges import Edges
from localiser.filter import Event, FilterState, Mcl, MclParameters, Odometry, Sighting, Start, step
from localiser.geometry import Array, Increment, Trajectory
from localiser.landmarks import LandmarkMap
from localiser.motion import EXACT, MotionParameters
from localiser.observation import EdgeObservation, ObservationParameters
from localiser.particles import POSE, Particles
from localiser.simulate import structure_of, truth_of, world_of

WORLDS = Path(__file__).resolve().parents[1] / "configs" / "worlds"
START_COV = np.diag([0.1, 0.1, np.deg2rad(3.0)]) ** 2
APART_M = 2.0  # landmarks of the map are at least this far from each other: which is which is hardly ever in doubt
MOTION = MotionParameters(bias=EXACT)
WORLD_DRAWS, FILTER_DRAWS = range(2)  # independent streams of random numbers


# -- the bound --------------------------------------------------------------------------------------------------------
#
# Posterior Cramér-Rao bound of bearing-only localisation: no filter's mean squared error can stay below it, whatever
# its number of particles. It needs the truth: poses, associations and sigmas. [Tichavský, Muravchik, Nehorai 1998],
# design equation 12: I' = (Q + F I⁻¹ Fᵀ)⁻¹ + Σ HᵀH/σ².


def information(jacobian: Array, sigma: Array) -> Array:
    """Return Hᵀ R⁻¹ H (D, D) of measurements with Jacobian H (E, D) and independent sigma (E,)."""
    scaled = jacobian / sigma[:, None]
    return np.asarray(scaled.T @ scaled)


def bearing_jacobian(pose: Array, camera_pose: Array, points: Array) -> Array:
    """Return ∂bearing/∂(x, z, heading) (L, 3) by the robot's pose (3,) of points (L, 2) that its camera (3,) sees."""
    (dx, dz), (arm_x, arm_z) = (points - camera_pose[:2]).T, camera_pose[:2] - pose[:2]
    by_x, by_z = np.array([dz, -dx]) / (dx**2 + dz**2)
    # A robot that turns about its own centre moves the camera sideways too.
    return np.stack([by_x, by_z, 1 + (by_x * arm_z - by_z * arm_x)], axis=-1)


def bearing_information(pose: Array, camera: Camera, points: Array, edges: Edges, observation: str) -> Array:
    """Return the information (3, 3) that the edges of one image hold on the true pose (3,); clutter holds none.

    points: (L, 2) of the map. observation: "slope" (sigma of the lean times J, design equation 7) or "line".
    """
    edges = edges.take(edges.landmark_id >= 0)
    seen, camera_pose = points[edges.landmark_id], camera.pose_in_map(pose)
    sigma = edges.bearing_sigma
    if observation == "slope":
        at = geometry.robot_from_map(camera_pose, seen)
        bearing = np.arctan2(at[..., 0], -at[..., 1])
        sigma = edges.lean_sigma * geometry.bearing_per_lean(bearing, camera.mount.tilt_rad)
    return information(bearing_jacobian(pose, camera_pose, seen), sigma)


def posterior_bound(prior_cov: Array, transition: Array, noise: Array, informations: Array) -> Array:
    """Return the bound (T, D, D) on the covariance of the estimate at T images, each with its own image used.

    prior_cov: (D, D) before the first image. transition: (T-1, D, D) F and noise: (T-1, D, D) Q from each image to the
    next (`motion.linearised` at the true poses). informations: (T, D, D) of each image. All of them may be singular.
    """
    bound = np.empty_like(np.asarray(informations, dtype=np.float64))
    cov = np.asarray(prior_cov, dtype=np.float64)
    for t, gained in enumerate(informations):
        if t > 0:
            cov = transition[t - 1] @ bound[t - 1] @ transition[t - 1].T + noise[t - 1]
        # (P⁻¹ + J)⁻¹ = S (1 + Sᵀ J S)⁻¹ Sᵀ with P = S Sᵀ: never inverts P, which is singular where the motion has no
        # noise in some direction, and stays symmetric and positive.
        variance, axes = np.linalg.eigh((cov + cov.T) / 2)
        root = axes * np.sqrt(np.maximum(variance, 0.0))
        result = root @ np.linalg.solve(np.eye(len(cov)) + root.T @ gained @ root, root.T)
        bound[t] = (result + result.T) / 2
    return bound


@dataclass(frozen=True, slots=True, eq=False)
class Setting:
    """What all seeds share.

    odometry: poses (T) at the images' times. visible: (T, L), landmarks that nothing hides from these poses; a robot
    that strayed is shown the same ones.
    """

    landmark_map: LandmarkMap
    camera: Camera
    odometry: Trajectory
    visible: NDArray[np.bool_]


@dataclass(frozen=True, slots=True, eq=False)
class Run:
    """One seed: error (T, 3) of the estimate, its covariance (T, 3, 3), the bound (T, 3, 3), ess (T,), edges (T,)."""

    error: Array
    cov: Array
    bound: Array
    ess: Array
    edges: Array

    @property
    def position_error_m(self) -> Array:
        """Distance (T,) between estimate and truth."""
        return np.hypot(self.error[:, 0], self.error[:, 1])


def setting_of(name: str = "corridor", frames: int | None = None) -> Setting:
    """Return a world that ships, its map thinned to landmarks that stand apart, the first `frames` of its drive."""
    world = world_of(yaml.safe_load((WORLDS / f"{name}.yaml").read_text(encoding="utf-8")))
    structure, camera, truth = structure_of(world), world.camera.camera(), truth_of(world.drive)
    t_ns = np.arange(truth.t_ns[0], truth.t_ns[-1], round(1e9 / world.drive.image_hz))[:frames]
    odometry = truth.sampled(t_ns)
    everything = structure.landmark_map
    visible = visible_mask(structure, camera, odometry.poses)
    # What is seen most often comes first, and stays.
    kept = standing_apart(everything.points, np.argsort(-visible.sum(axis=0), kind="stable"))
    landmark_map = LandmarkMap.from_points(
        everything.points[kept], bottom_m=everything.bottom_m[kept], top_m=everything.top_m[kept]
    )
    return Setting(landmark_map, camera, odometry, visible[:, kept])


def standing_apart(points: Array, order: NDArray[np.int64]) -> list[int]:
    """Return indices of points (L, 2), taken in this order, without those that stand near one taken before."""
    kept: list[int] = []
    for index in order:
        if all(np.hypot(*(points[index] - points[other])) >= APART_M for other in kept):
            kept.append(int(index))
    return kept


def run(
    setting: Setting, observation: str, particles: int, seed: int, association: Literal["known", "unknown"] = "unknown"
) -> Run:
    """Return one run of the filter on a truth, a start and edges drawn with this seed."""
    rng = np.random.default_rng([seed, WORLD_DRAWS])
    increments = [
        Increment.from_mean(move) for move in geometry.between(setting.odometry.poses[:-1], setting.odometry.poses[1:])
    ]
    truth = strayed(setting.odometry, increments, rng)
    edges = [
        # The bound is that of bearings alone: where an edge ends would tell the range besides.
        replace(frame, ends_px=np.full_like(frame.ends_px, np.nan))
        for frame in simulated_edges(setting.landmark_map, setting.camera, truth, rng, visible=setting.visible)
    ]
    start = truth.poses[0] + np.sqrt(np.diag(START_COV)) * rng.standard_normal(3)

    parameters = ObservationParameters(
        kind="line" if observation == "line" else "slope",
        landmark_sigma_m=0.0,
        decorrelation_m=0.0,
        association=association,
    )
    mcl = Mcl(
        setting.landmark_map,
        EdgeObservation(setting.camera, parameters),
        MclParameters(particles=particles, start_particles=particles),
        MOTION,
        parameters,
    )
    state, generator = FilterState(), np.random.default_rng([seed, FILTER_DRAWS])
    located = [
        result
        for event in events(Start(int(truth.t_ns[0]), start, START_COV), setting.odometry, edges)
        for result in step(mcl, state, event, generator)
    ]
    error = np.array([result.estimate.pose for result in located]) - truth.poses
    error[:, 2] = geometry.wrap_angle(error[:, 2])
    return Run(
        error=error,
        cov=np.array([result.estimate.pose_cov for result in located]),
        bound=bound_of(setting, truth, increments, edges, observation),
        ess=np.array([result.ess for result in located]),
        edges=np.array([len(frame) for frame in edges]),
    )


def strayed(odometry: Trajectory, increments: list[Increment], rng: np.random.Generator) -> Trajectory:
    """Return where the robot truly was: the motion model's own draw, one particle along the increments."""
    particle = Particles(POSE, odometry.poses[0][:, None].copy(), np.zeros(1))
    poses = [odometry.poses[0]]
    for increment in increments:
        particle = MOTION.predict(particle, increment, rng)
        poses.append(particle.poses[0])
    return Trajectory(odometry.t_ns, np.array(poses))


def events(start: Start, odometry: Trajectory, edges: list[Edges]) -> Iterator[Event]:
    """Yield what the filter is given, in the order of time."""
    yield start
    for t_ns, pose, frame in zip(odometry.t_ns, odometry.poses, edges, strict=True):
        yield Odometry(int(t_ns), pose)
        yield Sighting(int(t_ns), frame)


def bound_of(
    setting: Setting, truth: Trajectory, increments: list[Increment], edges: list[Edges], observation: str
) -> Array:
    """Return the posterior Cramér-Rao bound (T, 3, 3), linearised at the truth."""
    steps = [motion.linearised(pose, u, MOTION) for pose, u in zip(truth.poses[:-1], increments, strict=True)]
    transition, noise = (np.array(part) for part in zip(*steps, strict=True))
    points = setting.landmark_map.points
    informations = [
        bearing_information(pose, setting.camera, points, frame, observation)
        for pose, frame in zip(truth.poses, edges, strict=True)
    ]
    return posterior_bound(START_COV, transition, noise, np.array(informations))


@dataclass(frozen=True, slots=True)
class Efficiency:
    """RMSE over bound: 1 is the limit, more is worse. low, high: bootstrap confidence interval over the seeds."""

    value: float
    low: float
    high: float


def efficiency(
    error_m: Array, bound_m: Array, rng: np.random.Generator, *, probability: float = 0.95, resamples: int = 4000
) -> Efficiency:
    """Return √(mean of squared error) / √(mean of squared bound) over S seeds and T frames.

    error_m: (S, T). bound_m: (T,), or (S, T) when it differs between seeds. Errors of one run are correlated in time,
    so whole seeds are drawn with replacement, never single frames (percentile bootstrap). Raises ValueError when a
    figure is not finite, which a mean would hide.
    """
    error_m = np.atleast_2d(error_m)
    if not (np.isfinite(error_m).all() and np.isfinite(bound_m).all()):
        raise ValueError("errors and bounds must be finite")
    squared = np.square(error_m).mean(axis=1)
    limit = np.square(np.broadcast_to(bound_m, error_m.shape)).mean(axis=1)
    drawn = rng.integers(len(squared), size=(resamples, len(squared)))
    ratios = np.sqrt(squared[drawn].sum(axis=1) / limit[drawn].sum(axis=1))
    low, high = np.quantile(ratios, [(1 - probability) / 2, (1 + probability) / 2])
    return Efficiency(float(np.sqrt(squared.sum() / limit.sum())), float(low), float(high))


@dataclass(frozen=True, slots=True)
class Verdict:
    """Efficiency with its bootstrap interval, share of frames with consistent NEES, and the figures behind them."""

    efficiency: Efficiency
    consistent: float
    nees_mean: float
    rmse_m: float
    bound_m: float
    ess_median: float


def verdict_of(runs: list[Run]) -> Verdict:
    """Return the verdict on runs of many seeds."""
    error_m = np.array([one.position_error_m for one in runs])
    bound_m = np.array([np.sqrt(np.trace(one.bound[:, :2, :2], axis1=1, axis2=2)) for one in runs])
    nees = np.array([evaluate.nees(one.error, one.cov) for one in runs]).mean(axis=0)
    low, high = chi2(3 * len(runs)).ppf([0.025, 0.975]) / len(runs)
    return Verdict(
        efficiency=efficiency(error_m, bound_m, np.random.default_rng(0)),
        consistent=float(((nees >= low) & (nees <= high)).mean()),
        nees_mean=float(nees.mean()),
        rmse_m=float(np.sqrt(np.square(error_m).mean())),
        bound_m=float(np.sqrt(np.square(bound_m).mean())),
        ess_median=float(np.median([one.ess for one in runs])),
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--world", default="corridor", choices=sorted(path.stem for path in WORLDS.glob("*.yaml")))
    parser.add_argument("--observation", nargs="+", default=["slope", "line"], choices=["slope", "line"])
    parser.add_argument("--association", nargs="+", default=["known", "unknown"], choices=["known", "unknown"])
    parser.add_argument("--particles", nargs="+", type=int, default=[300, 2000])
    parser.add_argument("--seeds", type=int, default=100)
    parser.add_argument("--frames", type=int, default=None)
    parser.add_argument("--jobs", type=int, default=1, help="processes")
    arguments = parser.parse_args()
    setting = setting_of(arguments.world, arguments.frames)
    print(
        f"{arguments.world}: {len(setting.landmark_map)} landmarks, {len(setting.odometry)} frames, "
        f"{arguments.seeds} seeds"
    )
    print("observation association particles efficiency  95 % interval  NEES in band  mean NEES   RMSE  bound   ESS")
    for kind, association, count in product(arguments.observation, arguments.association, arguments.particles):
        jobs = (delayed(run)(setting, kind, count, seed, association) for seed in range(arguments.seeds))
        verdict = verdict_of(list(Parallel(arguments.jobs)(jobs)))
        ratio = verdict.efficiency
        print(
            f"{kind:11} {association:11} {count:9} {ratio.value:10.3f}  {ratio.low:.3f} … {ratio.high:.3f}  "
            f"{verdict.consistent:11.0%}  {verdict.nees_mean:9.2f}  {verdict.rmse_m:.4f} {verdict.bound_m:.4f} "
            f"{verdict.ess_median:5.0f}",
            flush=True,
        )


if __name__ == "__main__":
    main()
