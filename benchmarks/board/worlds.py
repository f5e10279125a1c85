"""Simulated hours: a robot drives about a building of `buildings.py`, from one random goal to the next.

Edges are simulated, at 5 Hz: found with a probability, with errors of their ends, split in two or three, short of their
end; hidden by walls, tall furniture and people; and in every image a few belong to nothing in the world.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components, shortest_path
from simulated_edges import EdgeNoise, simulated_edges

from board.buildings import KINDS, WALL_M, Building
from board.run import Drive
from localiser import Camera, Edges, LandmarkMap, Mount, Trajectory
from localiser.geometry import Array
from localiser.landmarks import in_camera
from localiser.simulate import odometry_of, truth_of
from localiser.simulate.world import DriveSpec, OdometrySpec, WayPoint

HZ = 5.0
NOISE = EdgeNoise(
    endpoint_sigma_px=0.25,
    along_sigma_px=2.0,
    cut_probability=0.15,
    detection_probability=0.85,
    clutter_per_frame=3.0,
    length_min_px=30.0,
)
SPLIT = (0.75, 0.17, 0.08)  # chances that an edge shows as one, two or three; of each part the ends err
MAP_SIGMA_M = 0.012
GRID_M, CLEAR_M = 0.4, 0.33
CHUNK = 25  # images whose edges are simulated together


@dataclass(frozen=True, slots=True, eq=False)
class Things:
    """Vertical edges in the world, M of them. landmark: (M,) index in the map, -1 for none."""

    points: Array
    bottom_m: Array
    top_m: Array
    landmark: NDArray[np.int64]


def hours_of(kind: str, seed: int, minutes: float) -> Drive:
    """Return a drive of some minutes in a building of that kind; same seed, same drive."""
    rng = np.random.default_rng([seed, 21, list(KINDS).index(kind)])
    building = KINDS[kind](rng)
    things, landmark_map = _things(building, kind)
    camera = _camera(rng)
    truth = _driven(building, rng, minutes)
    edges = [one for part in _seen(building, things, camera, truth, rng) for one in part]
    wheels = odometry_of(truth, _wheels(rng), rng)
    return Drive(kind, landmark_map, camera, wheels, truth.t_ns, edges, truth.poses)


def _things(building: Building, name: str) -> tuple[Things, LandmarkMap]:
    """Return what can be seen, and the map: what is mapped of it, and what stood there once."""
    rows = np.array([edge[:4] for edge in building.edges])
    mapped = np.array([edge[4] for edge in building.edges])
    worn = np.array([edge[:4] for edge in building.worn]).reshape(-1, 4)
    landmark = np.where(mapped, np.cumsum(mapped) - 1, -1)
    known = np.concatenate([rows[mapped], worn])
    points = known[:, :2] + MAP_SIGMA_M * building.rng.standard_normal((len(known), 2))
    landmark_map = LandmarkMap.from_points(points, name=name, bottom_m=known[:, 2], top_m=known[:, 3])
    return Things(rows[:, :2], rows[:, 2], rows[:, 3], landmark), landmark_map


def _camera(rng: np.random.Generator) -> Camera:
    focal = rng.uniform(430.0, 620.0)
    mount = Mount(
        np.deg2rad(rng.uniform(15.0, 30.0)),
        rng.uniform(0.6, 1.1),
        roll_rad=np.deg2rad(rng.uniform(-1.0, 1.0)),
        yaw_rad=np.deg2rad(rng.uniform(-2.0, 2.0)),
        back_m=-rng.uniform(0.0, 0.15),
    )
    return Camera(640, 480, focal, focal, 319.5, 239.5, mount)


def _wheels(rng: np.random.Generator) -> OdometrySpec:
    return OdometrySpec(
        distance_scale=rng.normal(0.0, 0.015),
        rotation_scale=rng.normal(0.0, 0.012),
        veer_deg_per_m=rng.normal(0.0, 0.35),
        distance_noise_m_per_sqrt_m=0.005,
        heading_walk_deg_per_sqrt_m=0.7,
        turn_noise_deg_per_sqrt_deg=0.05,
        slow_scale_sigma=0.02,
    )


# -- the drive ---------------------------------------------------------------------------------------------------------


def clearance_m(building: Building, points: Array) -> Array:
    """Return the distance (P,) of points (P, 2) from the nearest wall or thing."""
    walls = np.array(building.walls)
    start, side = walls[:, 0], walls[:, 1] - walls[:, 0]
    offset = points[:, None] - start
    share = np.clip((offset * side).sum(axis=-1) / np.maximum((side**2).sum(axis=-1), 1e-12), 0.0, 1.0)
    clear = np.linalg.norm(offset - share[..., None] * side, axis=-1).min(axis=1) - WALL_M / 2
    if building.feet:
        feet = np.array(building.feet)
        clear = np.minimum(clear, (np.linalg.norm(points[:, None] - feet[:, :2], axis=-1) - feet[:, 2]).min(axis=1))
    return clear


def is_clear(building: Building, start: Array, end: Array) -> bool:
    """Whether a robot can drive straight from one point to another."""
    steps = max(int(np.hypot(*(end - start)) / 0.1), 1)
    way = start + np.linspace(0.0, 1.0, steps + 1)[:, None] * (end - start)
    return bool((clearance_m(building, way) >= CLEAR_M - 0.05).all())


def _driven(building: Building, rng: np.random.Generator, minutes: float) -> Trajectory:
    """Return the true poses at the images' times of a drive through random goals."""
    nodes, links = _roadmap(building)
    seconds, speed, here = 0.0, rng.uniform(0.35, 0.7), int(rng.integers(len(nodes)))
    path = [nodes[here]]
    _, before = shortest_path(links, return_predecessors=True)
    while seconds < 60.0 * minutes + 5.0:
        goal = int(rng.integers(len(nodes)))
        way = [goal]
        while way[-1] != here:
            way.append(int(before[here, way[-1]]))
        for point in _straightened(building, [nodes[node] for node in reversed(way)]):
            seconds += float(np.hypot(*(point - path[-1]))) / speed
            path.append(point)
        here = goal
    points = tuple(WayPoint(to=(float(x), float(z)), pause_s=float(rng.choice([0.0, 0.0, 0.0, 1.0]))) for x, z in path)
    spec = DriveSpec(path=points, speed_m_s=speed, turn_deg_s=rng.uniform(25.0, 50.0), image_hz=HZ, odometry_hz=HZ)
    whole = truth_of(spec)
    count = min(round(60.0 * minutes * HZ), len(whole))
    return Trajectory(whole.t_ns[:count], whole.poses[:count])


def _roadmap(building: Building) -> tuple[Array, coo_array]:
    """Return the points (K, 2) that a robot reaches, and which of them are neighbours, with their distances."""
    axes = [np.arange(GRID_M / 2, size, GRID_M / 2) for size in building.size]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 2)
    points = points[clearance_m(building, points) >= CLEAR_M]
    distance = np.linalg.norm(points[:, None] - points[None], axis=-1)
    near = (distance > 0) & (distance < 0.75 * GRID_M)
    links = coo_array(np.where(near, distance, 0.0))
    _, part = connected_components(links)
    reached = part == part[np.linalg.norm(points - building.inside, axis=1).argmin()]
    return points[reached], coo_array(np.where(near, distance, 0.0)[np.ix_(reached, reached)])


def _straightened(building: Building, way: list[Array]) -> Iterator[Array]:
    """Yield the points after the first at which a robot must turn that takes every short cut."""
    here = 0
    while here < len(way) - 1:
        there = len(way) - 1
        while there > here + 1 and not is_clear(building, way[here], way[there]):
            there = here + max((there - here) // 2, 1)
        yield way[there]
        here = there


# -- what is seen ------------------------------------------------------------------------------------------------------


def _seen(
    building: Building, things: Things, camera: Camera, truth: Trajectory, rng: np.random.Generator
) -> Iterator[list[Edges]]:
    """Yield the edges of all images, some images at a time."""
    walls = np.array(building.walls)
    for first in range(0, len(truth), CHUNK):
        part = slice(first, first + CHUNK)
        poses, t_ns = truth.poses[part], truth.t_ns[part]
        rows, shown = [], []
        for frame, (pose, now) in enumerate(zip(poses, t_ns, strict=True)):
            seen, moving = in_view(building, things, camera, walls, pose, now / 1e9)
            rows += [np.column_stack([things.points, things.bottom_m, things.top_m, things.landmark])[seen], moving]
            shown += [np.full(len(seen) + len(moving), frame)]
        noise = replace(NOISE, range_max_m=building.sees_m)
        yield _measured(np.concatenate(rows), np.concatenate(shown), camera, Trajectory(t_ns, poses), noise, rng)


def in_view(
    building: Building, things: Things, camera: Camera, walls: Array, pose: Array, seconds: float
) -> tuple[NDArray[np.int64], Array]:
    """Return which things an image may show, and rows of x, z, bottom, top, -1 for each edge of what moves."""
    eye = camera.pose_in_map(pose[None])
    moving, bodies = moving_edges(building, eye[0, :2], seconds)
    points = np.concatenate([things.points, moving[:, :2]])
    right, ahead = (axis[0] for axis in in_camera(eye, points))
    wide = 1.3 * camera.width / 2 / camera.fx
    near = np.flatnonzero((ahead > 0.1) & (np.abs(right) < wide * ahead) & (np.hypot(right, ahead) < building.sees_m))
    seen = near[~hidden_behind(eye[0, :2], points[near], walls, bodies)]
    return seen[seen < len(things.points)], moving[seen[seen >= len(things.points)] - len(things.points)]


def moving_edges(building: Building, eye: Array, seconds: float) -> tuple[Array, Array]:
    """Return rows of x, z, bottom, top, -1 for every edge of people and carts, and people as x, z, radius.

    Of a person the outline shows, which is another edge of the body from every place; of a cart its corners.
    """
    rows, bodies = [], []
    for mover in building.movers:
        middle, ahead = mover.at(seconds)
        across = np.array([-ahead[1], ahead[0]])
        if mover.radius_m:
            sight = (middle - eye) / max(float(np.hypot(*(middle - eye))), 1e-6)
            outline = mover.radius_m * np.array([-sight[1], sight[0]])
            for part, top in ((1.0, 1.6), (0.45, 0.8)):
                rows += [[*(middle + side * part * outline), 0.0, top, -1.0] for side in (-1.0, 1.0)]
            bodies.append([*middle, mover.radius_m])
        else:
            corners = [middle + 0.4 * one * ahead + 0.25 * other * across for one in (-1, 1) for other in (-1, 1)]
            rows += [[*corner, 0.1, 0.95, -1.0] for corner in corners]
    return np.array(rows).reshape(-1, 5), np.array(bodies).reshape(-1, 3)


def hidden_behind(eye: Array, points: Array, walls: Array, bodies: Array) -> NDArray[np.bool_]:
    """Return which points (P, 2) a wall (W, 2, 2) or a person (B, 3) hides from the eye (2,)."""
    way, side = points - eye, walls[:, 1] - walls[:, 0]
    length = np.hypot(*way.T)
    to_wall = walls[:, 0] - eye
    turn = way[:, :1] * side[:, 1] - way[:, 1:] * side[:, 0]
    turn = np.where(np.abs(turn) < 1e-9, 1e-9, turn)
    at = (to_wall[:, 0] * side[:, 1] - to_wall[:, 1] * side[:, 0]) / turn
    along = (to_wall[:, 0] * way[:, 1:] - to_wall[:, 1] * way[:, :1]) / turn
    hidden = ((at > 0) & (at < 1 - 0.09 / length[:, None]) & (along >= 0) & (along <= 1)).any(axis=1)
    if len(bodies):
        to_body = bodies[:, :2] - eye
        unit = way / length[:, None]
        before = unit @ to_body.T
        aside = np.abs(unit[:, :1] * to_body[:, 1] - unit[:, 1:] * to_body[:, 0])
        nearer = (before > 0) & (before < length[:, None] - bodies[:, 2] - 0.1)
        hidden |= (nearer & (aside < bodies[:, 2])).any(axis=1)
    return hidden


def _measured(
    rows: Array, frame: NDArray[np.int64], camera: Camera, truth: Trajectory, noise: EdgeNoise, rng: np.random.Generator
) -> list[Edges]:
    """Return the edges of some images. rows: (S, 5) x, z, bottom, top, landmark of what each shows, frame: (S,)."""
    parts, landmark, shown = [], [], []
    count = rng.choice([1, 2, 3], len(rows), p=SPLIT)
    for number in (1, 2, 3):
        own = rows[count == number]
        for part in range(number):
            low = own[:, 2] + (own[:, 3] - own[:, 2]) * part / number
            high = own[:, 2] + (own[:, 3] - own[:, 2]) * (part + 1) / number
            parts.append(np.column_stack([own[:, :2], low, high]))
            landmark.append(own[:, 4])
            shown.append(frame[count == number])
    pieces, of, at = np.concatenate(parts), np.concatenate(landmark).astype(np.int64), np.concatenate(shown)
    everything = LandmarkMap.from_points(pieces[:, :2], bottom_m=pieces[:, 2], top_m=pieces[:, 3])
    visible = at == np.arange(len(truth))[:, None]
    found = simulated_edges(everything, camera, truth, rng, noise=noise, visible=visible)
    of = np.append(of, -1)  # an index of -1 is no landmark
    return [replace(one, landmark_id=of[one.landmark_id]) for one in found]
