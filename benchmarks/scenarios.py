"""What a robot meets in `robustness.py`: each scenario turns a seed into a drive, its odometry and its edges.

The drives are those of the worlds that ship, forwards and backwards. Odometry errs as the world (or `HOUSE`) states,
edges as measured from rendered images of these worlds (`IMAGES`). What belongs to nothing on the map is fixed in the
world, as book spines, brickwork and pictures are: it is seen again from the next place, with the right parallax.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np
import yaml
from numpy.typing import NDArray
from simulated_edges import EdgeNoise, simulated_edges, visible_mask

from localiser import geometry
from localiser.camera import Camera
from localiser.edges import Edges
from localiser.filter import Start
from localiser.geometry import Trajectory
from localiser.landmarks import LandmarkMap
from localiser.simulate import odometry_of, structure_of, truth_of, world_of
from localiser.simulate.robot import OdometrySpec
from localiser.simulate.structure import Structure, VerticalEdges
from localiser.simulate.world import World

WORLDS = Path(__file__).resolve().parents[1] / "configs" / "worlds"
IMAGES = EdgeNoise(endpoint_sigma_px=0.2, along_sigma_px=2.0, cut_probability=0.15, detection_probability=0.85)
IMAGE_SHELVES = {"office": 12, "corridor": 4}  # so that as many edges are clutter as in rendered images
CLUTTER_SHELVES = 120
LEAD_IN_M, EMPTY_M = 3.0, 10.0
HOUSE = OdometrySpec(
    distance_scale=0.015,
    rotation_scale=-0.012,
    veer_deg_per_m=0.35,
    distance_noise_m_per_sqrt_m=0.005,
    heading_walk_deg_per_sqrt_m=0.9,
    turn_noise_deg_per_sqrt_deg=0.05,
    slow_scale_sigma=0.03,
)
START_COV = np.diag([0.1, 0.1, np.deg2rad(3.0)]) ** 2
SHELF_M, SPINE_M = 0.9, (0.02, 0.06)  # a shelf, and how far apart the spines on it are: even within each
_DRIVE, _EDGES, _START, _SHELVES = range(4)  # independent streams of random numbers


@dataclass(frozen=True, slots=True, eq=False)
class Trial:
    """One run of a scenario.

    truth: poses (T) at the images' times. odometry: poses at the same times, in a frame of its own. frames: T edges.
    start: None where nothing is said of it. judged: from which frame on. carried: frame from which on the robot is
    elsewhere without odometry knowing, None where it never is.
    """

    landmark_map: LandmarkMap
    camera: Camera
    truth: Trajectory
    odometry: Trajectory
    frames: list[Edges]
    start: Start | None
    judged: int = 0
    carried: int | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Place:
    """A world with everything in it that can be seen, and its drive, forwards and then backwards.

    truth: poses (T) at the images' rate. everything: landmarks (L) of the map first, then what is on no map.
    visible: (T, L') what the world hides from no pose. mapped: L. shelf: (L' - L,) the shelf of the others.
    """

    world: World
    camera: Camera
    truth: Trajectory
    everything: LandmarkMap
    visible: NDArray[np.bool_]
    mapped: int
    shelf: NDArray[np.int64]

    @property
    def landmark_map(self) -> LandmarkMap:
        """The map that the filter is given: what the drive sees."""
        return self.everything.take(np.arange(self.mapped))


@cache
def place_of(name: str, shelves: int, both_ways: bool = True) -> Place:
    """Return a world, with rows of spines along its walls; of its drive perhaps only the way there."""
    world = world_of(yaml.safe_load((WORLDS / f"{name}.yaml").read_text(encoding="utf-8")))
    structure, camera = structure_of(world), world.camera.camera()
    drive = truth_of(world.drive)
    step_ns = round(1e9 / world.drive.image_hz)
    there = drive.sampled(np.arange(drive.t_ns[0], drive.t_ns[-1], step_ns)).poses
    on_the_spot = there[-1] + np.arange(1, 18)[:, None] * [0.0, 0.0, np.deg2rad(10)]
    back = there[::-1] + np.array([0.0, 0.0, np.pi])
    poses = np.concatenate([there, on_the_spot, back] if both_ways else [there])
    poses[:, 2] = geometry.wrap_angle(poses[:, 2])
    truth = Trajectory(np.arange(len(poses), dtype=np.int64) * step_ns, poses)
    spines, shelf = spines_of(world, shelves, np.random.default_rng([_SHELVES, shelves]))
    filled = with_spines(structure, spines)
    visible = visible_mask(filled, camera, poses)
    count = len(structure.landmark_map)
    seen = visible.sum(axis=0) >= 5
    kept = np.flatnonzero(seen)
    return Place(
        world,
        camera,
        truth,
        filled.landmark_map.take(kept),
        visible[:, kept],
        int(seen[:count].sum()),
        shelf[kept[kept >= count] - count],
    )


def spines_of(world: World, shelves: int, rng: np.random.Generator) -> tuple[VerticalEdges, NDArray[np.int64]]:
    """Return the edges of books on shelves along the walls, M of them, and the shelf (M,) that each stands on."""
    points, bottom, top, shelf = [], [], [], []
    walls = [wall for wall in world.walls if wall.length_m > SHELF_M]
    length = np.array([wall.length_m for wall in walls])
    for number in range(shelves):
        wall = walls[rng.choice(len(walls), p=length / length.sum())]
        start, end = np.array(wall.start), np.array(wall.end)
        along = (end - start) / wall.length_m
        side = rng.choice([-1.0, 1.0])
        across = side * np.array([-along[1], along[0]]) * (wall.thickness_m / 2 + 0.02)
        at = np.arange(0.0, SHELF_M, rng.uniform(*SPINE_M)) + rng.uniform(0.0, wall.length_m - SHELF_M)
        low = rng.choice([0.1, 0.4, 0.7])
        points.append(start + at[:, None] * along + across)
        bottom.append(np.full(len(at), low))
        top.append(low + rng.uniform(0.2, 0.3, len(at)))
        shelf.append(np.full(len(at), number))
    if not shelves:
        return VerticalEdges(np.zeros((0, 2)), np.zeros(0), np.zeros(0), np.zeros(0, dtype=bool)), np.zeros(0, np.int64)
    columns = [np.concatenate(parts) for parts in (points, bottom, top, shelf)]
    return VerticalEdges(columns[0], columns[1], columns[2], np.zeros(len(columns[0]), dtype=bool)), columns[3]


def with_spines(structure: Structure, spines: VerticalEdges) -> Structure:
    """Return the structure with further edges, each a thing of its own to look at; they hide nothing."""
    before, edges, count = structure.landmark_map, structure.edges, len(structure.landmark_map)
    joined = VerticalEdges(
        np.concatenate([edges.points, spines.points]),
        np.concatenate([edges.bottom_m, spines.bottom_m]),
        np.concatenate([edges.top_m, spines.top_m]),
        np.concatenate([edges.is_flat, spines.is_flat]),
    )
    everything = LandmarkMap.from_points(
        np.concatenate([before.points, spines.points]),
        name=before.name,
        bottom_m=np.concatenate([before.bottom_m, spines.bottom_m]),
        top_m=np.concatenate([before.top_m, spines.top_m]),
    )
    landmark = np.concatenate([structure.landmark, count + np.arange(len(spines))])
    return replace(structure, edges=joined, landmark=landmark, landmark_map=everything)


# -- scenarios --------------------------------------------------------------------------------------------------------


def normal(seed: int) -> Trial:
    """A long run in the office: the whole drive, a turn on the spot, and the way back."""
    place = place_of("office", IMAGE_SHELVES["office"])
    return trial_of(place, np.arange(len(place.truth)), seed, IMAGES)


def whereabouts(world: str, seed: int, frames: int = 120) -> Trial:
    """No start: a stretch of the drive, or of the way back, from anywhere on it."""
    place = place_of(world, IMAGE_SHELVES[world])
    first = np.random.default_rng([seed, _DRIVE]).integers(0, len(place.truth) - frames)
    trial = trial_of(place, np.arange(first, first + frames), seed, IMAGES)
    return replace(trial, start=None)


def kidnapped(seed: int, before: int = 60, after: int = 110) -> Trial:
    """The robot is lifted and set down 2 to 6 m away and turned, and its wheels do not notice."""
    place = place_of("office", IMAGE_SHELVES["office"])
    rng = np.random.default_rng([seed, _DRIVE])
    poses = place.truth.poses
    while True:
        first, second = rng.integers(0, len(poses) - before), rng.integers(0, len(poses) - after)
        moved = geometry.between(poses[first + before - 1], poses[second])
        if 2.0 <= np.hypot(moved[0], moved[1]) <= 6.0 and abs(moved[2]) > np.deg2rad(20):
            break
    index = np.concatenate([np.arange(first, first + before), np.arange(second, second + after)])
    return replace(trial_of(place, index, seed, IMAGES, jump=before), carried=before)


def clutter(seed: int) -> Trial:
    """The office with shelves full of books on all walls: 80 edges a frame, 85 % of them of nothing on the map."""
    place = place_of("office", CLUTTER_SHELVES, both_ways=False)
    return trial_of(place, np.arange(len(place.truth)), seed, IMAGES, dense=80, false_share=0.85)


def empty(seed: int) -> Trial:
    """Three metres of corridor to find one's place, then 10 m in which a frame shows at most two landmarks."""
    place = place_of("corridor", 0, both_ways=False)
    poses = place.truth.poses
    way_m = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(poses[:, :2], axis=0).T))])
    index = np.flatnonzero(way_m <= LEAD_IN_M + EMPTY_M)
    rng = np.random.default_rng([seed, _SHELVES])
    shown = place.visible[index].copy()
    bare = way_m[index] > LEAD_IN_M
    # Few stand out from the wall, always the same ones; of those that are in view, two are long enough.
    order = rng.permutation(place.mapped)
    stands_out = order[: round(0.2 * place.mapped)]
    for row in np.flatnonzero(bare):
        seen = [landmark for landmark in stands_out if shown[row, landmark]][:2]
        shown[row] = False
        shown[row, seen] = True
    noise = replace(IMAGES, clutter_per_frame=1.0)
    trial = trial_of(replace(place, visible=_rows(place.visible, index, shown)), index, seed, noise, wheels=HOUSE)
    return replace(trial, judged=int(bare.argmax()))


def _rows(whole: NDArray[np.bool_], index: NDArray[np.int64], rows: NDArray[np.bool_]) -> NDArray[np.bool_]:
    changed = whole.copy()
    changed[index] = rows
    return changed


def trial_of(
    place: Place,
    index: NDArray[np.int64],
    seed: int,
    noise: EdgeNoise,
    *,
    wheels: OdometrySpec | None = None,
    jump: int | None = None,
    dense: float | None = None,
    false_share: float = 0.0,
) -> Trial:
    """Return the trial of driving along the place's poses at `index` (T,); the wheels miss what happens at `jump`."""
    rng = np.random.default_rng([seed, _EDGES])
    step_ns = int(place.truth.t_ns[1])
    truth = Trajectory(np.arange(len(index), dtype=np.int64) * step_ns, place.truth.poses[index])
    visible = place.visible[index]
    if dense is not None:
        visible = visible & _thinned(place, visible, noise, dense, false_share, seed)
    frames = simulated_edges(place.everything, place.camera, truth, rng, noise=noise, visible=visible)
    frames = [replace(f, landmark_id=np.where(f.landmark_id < place.mapped, f.landmark_id, -1)) for f in frames]
    start_rng = np.random.default_rng([seed, _START])
    mean = truth.poses[0] + np.sqrt(np.diag(START_COV)) * start_rng.standard_normal(3)
    odometry = odometry_of_trial(truth, wheels or place.world.odometry, jump, np.random.default_rng([seed, _DRIVE, 1]))
    return Trial(place.landmark_map, place.camera, truth, odometry, frames, Start(0, mean, START_COV))


def _thinned(
    place: Place, visible: NDArray[np.bool_], noise: EdgeNoise, edges: float, false_share: float, seed: int
) -> NDArray[np.bool_]:
    """Return which of everything (L',) can be seen at all, so that a frame has on average the edges asked for.

    Landmarks are left out one by one, others by whole shelves, so that rows stay rows.
    """
    rng = np.random.default_rng([seed, _SHELVES])
    often = visible.mean(axis=0) * noise.detection_probability
    chosen = np.zeros(len(often), dtype=bool)
    landmarks = rng.permutation(place.mapped)
    chosen[landmarks[np.cumsum(often[landmarks]) <= edges * (1 - false_share)]] = True
    total = 0.0
    for shelf in rng.permutation(np.unique(place.shelf)):
        spines = place.mapped + np.flatnonzero(place.shelf == shelf)
        if total >= edges * false_share:
            break
        chosen[spines] = True
        total += often[spines].sum()
    return chosen


def odometry_of_trial(
    truth: Trajectory, wheels: OdometrySpec, jump: int | None, rng: np.random.Generator
) -> Trajectory:
    """Return what the wheels say; they stand still where the robot is carried."""
    if jump is None:
        return odometry_of(truth, wheels, rng)
    before = odometry_of(Trajectory(truth.t_ns[:jump], truth.poses[:jump]), wheels, rng)
    after = odometry_of(Trajectory(truth.t_ns[jump:], truth.poses[jump:]), wheels, rng)
    return Trajectory(truth.t_ns, np.concatenate([before.poses, geometry.compose(before.poses[-1], after.poses)]))
