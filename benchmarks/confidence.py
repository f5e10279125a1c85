"""Is p_correct right? A reliability diagram of the filter's own confidence, on simulated runs.

Runs in the worlds that ship, their edges simulated with clutter as images have it: from a stated start, from no start
(`global`), and carried away in the middle without the wheels' knowing (`carried`: 2 to 6 m, and turned). Every image
gives p_correct, and whether the estimate was within 0.5 m and 10°. The table says for each range of p_correct how many
images it had, what it claimed on the average, and how often the estimate was right, with a 95 % interval over runs,
since images of one run are not independent.

python benchmarks/confidence.py --seeds 10
python benchmarks/confidence.py --seeds 5 --first-seed 100 --out docs/images/reliability.png
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
import yaml

from localiser import geometry
from localiser.camera import Camera
from localiser.filter import FilterState, Mcl, Odometry, Sighting, Start, step
from localiser.filter.confidence import is_near
from localiser.geometry import Array, Trajectory
from localiser.landmarks import LandmarkMap
from localiser.observation import EdgeObservation, ObservationParameters
from localiser.relocalisation.global_localisation import GlobalLocalisation
from localiser.simulate import EdgeNoise, simulated_edges, structure_of, truth_of, visible_mask, world_of

WORLDS = Path(__file__).resolve().parents[1] / "configs" / "worlds"
SCENARIOS = ("stated", "global", "carried")
FRAMES = 100
CARRIED_AT = 40
NOISE = EdgeNoise(detection_probability=0.7, clutter_per_frame=15.0)
SCALE, TURN_VAR, DISTANCE_VAR = 1.015, 7e-4, 9e-4  # of the wheels: a constant factor; per metre
START_SIGMA = np.array([0.1, 0.1, np.radians(3.0)])
EDGES = np.array([0.0, 0.1, 0.3, 0.5, 0.7, 0.9, 0.97, 0.99, 1.0])


@dataclass(frozen=True, slots=True, eq=False)
class Setting:
    """A world: the map of what its drive sees, and which landmarks (T, L) each pose (T, 3) of the drive sees."""

    landmark_map: LandmarkMap
    camera: Camera
    drive: Array
    visible: Array


@dataclass(frozen=True, slots=True, eq=False)
class Run:
    """What a run claimed, p_correct (T,), and whether it was right (T,)."""

    p_correct: Array
    right: Array


def setting_of(name: str) -> Setting:
    """Return a world that ships."""
    world = world_of(yaml.safe_load((WORLDS / f"{name}.yaml").read_text(encoding="utf-8")))
    structure, camera, truth = structure_of(world), world.camera.camera(), truth_of(world.drive)
    drive = truth.sampled(np.arange(truth.t_ns[0], truth.t_ns[-1], round(1e9 / world.drive.image_hz))).poses
    visible, everything = visible_mask(structure, camera, drive), structure.landmark_map
    seen = visible[::2].any(axis=0)
    landmark_map = LandmarkMap.from_points(
        everything.points[seen], bottom_m=everything.bottom_m[seen], top_m=everything.top_m[seen], name=name
    )
    return Setting(landmark_map, camera, drive, visible[:, seen])


def frames_of(setting: Setting, scenario: str, rng: np.random.Generator) -> Array:
    """Return which poses of the drive a run takes, one after the other."""
    drive = setting.drive
    if scenario != "carried":
        return rng.integers(0, len(drive) - FRAMES) + np.arange(FRAMES)
    first = rng.integers(0, len(drive) - CARRIED_AT) + np.arange(CARRIED_AT)
    distance = np.hypot(*(drive[:, :2] - drive[first[-1], :2]).T)
    landing = np.flatnonzero((distance > 2) & (distance < 6) & (np.arange(len(drive)) < len(drive) - FRAMES))
    return np.concatenate([first, rng.choice(landing) + np.arange(FRAMES)])


def wheels_of(drive: Array, frames: Array, rng: np.random.Generator) -> Array:
    """Return odometry (T, 3) along frames (T,) of the drive; it knows nothing of being carried."""
    poses = [np.zeros(3)]
    for one, other in pairwise(frames):
        move = geometry.between(drive[one], drive[other]) if other == one + 1 else np.zeros(3)
        path_m = np.hypot(*move[:2])
        move[:2] *= SCALE + rng.normal(0.0, np.sqrt(DISTANCE_VAR / max(path_m, 1e-3)))
        move[2] += rng.normal(0.0, np.sqrt(TURN_VAR * path_m))
        poses.append(geometry.compose(poses[-1], move))
    return np.array(poses)


def run(setting: Setting, scenario: str, seed: int) -> Run:
    """Return one run of the default filter."""
    rng = np.random.default_rng([seed, SCENARIOS.index(scenario)])
    frames = frames_of(setting, scenario, rng)
    truth, wheels = setting.drive[frames], wheels_of(setting.drive, frames, rng)
    t_ns = np.arange(len(frames)) * 200_000_000
    edges = simulated_edges(
        setting.landmark_map, setting.camera, Trajectory(t_ns, truth), rng, noise=NOISE, visible=setting.visible[frames]
    )
    parameters = ObservationParameters()
    observation = EdgeObservation(setting.camera, parameters)
    mcl = Mcl(
        setting.landmark_map,
        observation,
        correlation=parameters,
        search=GlobalLocalisation.of(observation, setting.landmark_map),
    )
    start = Start(0, truth[0] + START_SIGMA * rng.standard_normal(3), np.diag(START_SIGMA**2))
    events = [] if scenario == "global" else [start]
    for t, pose, seen in zip(t_ns, wheels, edges, strict=True):
        events += [Odometry(int(t), pose), Sighting(int(t), seen)]
    state = FilterState()
    located = [found for event in events for found in step(mcl, state, event, rng)]
    right = [is_near(found.estimate.pose[None], pose)[0] for found, pose in zip(located, truth, strict=True)]
    return Run(np.array([found.p_correct for found in located]), np.array(right))


def reliability(runs: list[Run]) -> list[tuple[float, float, int, float, float, float]]:
    """Return for each range of p_correct its ends, images, mean claim, share that was right, half a 95 % interval."""
    rows = []
    for low, high in pairwise(EDGES):
        inside = [(one.p_correct >= low) & ((one.p_correct < high) | (high == 1.0)) for one in runs]
        counts = np.array([chosen.sum() for chosen in inside])
        if counts.sum() == 0:
            continue
        claimed = sum(one.p_correct[chosen].sum() for one, chosen in zip(runs, inside, strict=True)) / counts.sum()
        hits = np.array([one.right[chosen].sum() for one, chosen in zip(runs, inside, strict=True)])
        share = hits.sum() / counts.sum()
        half = 1.96 * np.sqrt(np.square(hits - share * counts).sum()) / counts.sum()
        rows.append((float(low), float(high), int(counts.sum()), float(claimed), float(share), float(half)))
    return rows


def draw(by_scenario: dict[str, list[Run]], path: Path) -> None:
    """Draw the diagram: what was claimed against what was right, all runs and each scenario."""
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(figsize=(5.6, 5.6), dpi=130, layout="constrained")
    axes.plot([0, 1], [0, 1], color="0.7", linewidth=1, label="claimed = true")
    rows = np.array(reliability(by_scenario["all"]))
    reach = np.minimum([rows[:, 5], rows[:, 5]], [rows[:, 4], 1.0 - rows[:, 4]])
    axes.errorbar(rows[:, 3], rows[:, 4], reach, fmt="o-", color="#d97706", capsize=3, label="all runs", zorder=3)
    for scenario, colour in zip(SCENARIOS, ("#2563eb", "#16a34a", "#9333ea"), strict=True):
        rows = np.array(reliability(by_scenario[scenario]))
        axes.plot(rows[:, 3], rows[:, 4], ".--", color=colour, linewidth=0.8, label=scenario)
    axes.set(xlabel="p_correct, mean of a range", ylabel="share within 0.5 m and 10°", xlim=(0, 1), ylim=(0, 1.02))
    figure.legend(loc="outside lower center", ncols=5, frameon=False, fontsize="small")
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path)


def report(scenario: str, runs: list[Run]) -> None:
    """Print the table of a scenario."""
    claimed, right = (np.concatenate([getattr(one, name) for one in runs]) for name in ("p_correct", "right"))
    print(f"\n{scenario}: {len(runs)} runs, {np.mean([one.right[-1] for one in runs]):.0%} right in the end")
    print(f"Brier score {np.mean((claimed - right) ** 2):.3f}, sure and wrong {np.mean((claimed > 0.9) & ~right):.1%}")
    print("  p_correct    images  claimed  right")
    for low, high, count, mean, share, half in reliability(runs):
        print(f"  {low:.2f}-{high:.2f} {count:9}  {mean:7.3f}  {share:.3f} ± {half:.3f}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--world", nargs="+", default=["office", "corridor"])
    parser.add_argument("--seeds", type=int, default=10, help="of each world and scenario")
    parser.add_argument("--first-seed", type=int, default=1000)
    parser.add_argument("--out", type=Path, help="picture to draw")
    arguments = parser.parse_args()
    settings = [setting_of(name) for name in arguments.world]
    seeds = range(arguments.first_seed, arguments.first_seed + arguments.seeds)
    by_scenario = {
        scenario: [run(setting, scenario, seed) for setting in settings for seed in seeds] for scenario in SCENARIOS
    }
    by_scenario["all"] = [one for runs in by_scenario.values() for one in runs]
    for scenario, runs in by_scenario.items():
        report(scenario, runs)
    if arguments.out:
        draw(by_scenario, arguments.out)


if __name__ == "__main__":
    main()
