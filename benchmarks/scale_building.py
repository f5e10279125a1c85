"""A building of any size, for `scale.py`: wings of rooms along corridors, with courtyards between the wings.

Every room has a door, a window and one or two cupboards. Rooms are alike and vary a little: where the door is, how wide
the window is, which wall the cupboards stand at. The rooms of a small building are the first rooms of every larger one,
so a drive through them can be repeated in all.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from board.run import Drive
from board.worlds import hidden_behind
from simulated_edges import EdgeNoise, simulated_edges

from localiser import Camera, LandmarkMap, Mount, Trajectory
from localiser.geometry import Array, between, compose, wrap_angle
from localiser.landmarks import in_camera

ROOM_M, DEPTH_M, CORRIDOR_M, COURTYARD_M = 4.0, 5.0, 2.2, 14.0
ROOMS_A_WING = 32  # 16 on either side of the corridor
DOOR_M, CEILING_M = 0.9, 2.6
HZ = 5.0
CAMERA = Camera(640, 480, 554.0, 554.0, 319.5, 239.5, Mount(np.radians(20), 0.9))
NOISE = EdgeNoise(
    endpoint_sigma_px=0.25,
    along_sigma_px=2.0,
    cut_probability=0.15,
    detection_probability=0.85,
    clutter_per_frame=3.0,
    range_max_m=12.0,
    length_min_px=30.0,
)
CHUNK = 25  # images whose edges are simulated together


@dataclass(frozen=True, slots=True, eq=False)
class Floor:
    """landmark_map: of L landmarks. walls: (W, 2, 2) m, segments that hide what is behind them. rooms: how many."""

    landmark_map: LandmarkMap
    walls: Array
    rooms: int


@dataclass(frozen=True, slots=True, eq=False)
class _Room:
    """Rows of x, z, bottom_m, top_m, and walls (W, 2, 2)."""

    edges: list[list[float]]
    walls: list[list[list[float]]]


def floor_of(landmarks: int, seed: int = 0) -> Floor:
    """Return a building with this many landmarks; same seed, same building."""
    edges: list[list[float]] = []
    walls: list[list[list[float]]] = []
    rooms = 0
    while len(edges) < landmarks:
        room = _room(rooms, seed)
        edges += room.edges
        walls += room.walls
        rooms += 1
    rows = np.array(edges[:landmarks])
    rows[:, :2] += 0.01 * np.random.default_rng([seed, landmarks]).standard_normal((landmarks, 2))
    made = LandmarkMap.from_points(rows[:, :2], name=f"scale{landmarks}", bottom_m=rows[:, 2], top_m=rows[:, 3])
    return Floor(made, np.array(walls), rooms)


def corner_of(room: int) -> tuple[Array, float]:
    """Return where on the corridor a room begins (2,), and on which side of it the room is, -1 or 1."""
    wing, place = divmod(room, ROOMS_A_WING)
    wings_across = 12
    x = (wing // wings_across) * (ROOMS_A_WING / 2 * ROOM_M + COURTYARD_M) + place // 2 * ROOM_M
    z = (wing % wings_across) * (2 * DEPTH_M + CORRIDOR_M + COURTYARD_M)
    side = 1.0 if place % 2 else -1.0
    return np.array([x, z + side * CORRIDOR_M / 2]), side


def _room(number: int, seed: int) -> _Room:
    rng = np.random.default_rng([seed, 7, number])
    (x, z), side = corner_of(number)
    door = rng.uniform(0.4, ROOM_M - DOOR_M - 0.4)
    window, wide = rng.uniform(0.4, 1.2), rng.uniform(1.0, 2.0)
    back = z + side * DEPTH_M
    edges = [
        [x + door, z, 0.0, 2.05],
        [x + door + DOOR_M, z, 0.0, 2.05],
        [x, back, 0.0, CEILING_M],
        [x + window, back, 0.8, 2.1],
        [x + window + wide, back, 0.8, 2.1],
    ]
    walls = [
        [[x, z], [x + door, z]],
        [[x + door + DOOR_M, z], [x + ROOM_M, z]],
        [[x, z], [x, back]],
        [[x, back], [x + ROOM_M, back]],
    ]
    for _ in range(rng.integers(1, 3)):  # cupboards beside the corridor's wall or along a side wall
        at, long, top = rng.uniform(1.0, DEPTH_M - 1.5), rng.uniform(0.5, 1.2), rng.choice([0.9, 1.4, 1.9])
        left = rng.random() < 0.5
        front = x + 0.45 if left else x + ROOM_M - 0.45
        for along in (at, at + long):
            edges.append([front, z + side * along, 0.0, float(top)])
        if top > 1.2:
            walls.append([[front, z + side * at], [front, z + side * (at + long)]])
    if rng.random() < 0.5:  # a pillar or pipe in the corridor
        edges.append([x + rng.uniform(0.2, ROOM_M - 0.2), z - side * 0.12, 0.0, CEILING_M])
    return _Room(edges, walls)


def way_through(first_room: int, images: int, *, visits: int = 3) -> Array:
    """Return poses (T, 3) of a drive from a room along its corridor, with a look into some rooms on the way."""
    corner, side = corner_of(first_room)
    pose = np.array([corner[0] + 1.0, corner[1] - side * CORRIDOR_M / 2, -np.pi / 2])  # along +x
    forward = [np.array([0.0, -0.1, 0.0])] * 40
    look = [np.array([0.0, 0.0, np.radians(8.0)])] * 11
    back = [-one for one in look]
    about = [np.array([0.0, 0.0, np.radians(9.0)])] * 20
    steps: list[Array] = []
    while len(steps) < images:
        for visit in range(visits):
            steps += forward + (look + back if visit % 2 else [-one for one in look] + look)
        steps += about
    poses = [pose]
    for step in steps[: images - 1]:
        poses.append(compose(poses[-1], step))
    result = np.array(poses)
    result[:, 2] = wrap_angle(result[:, 2])
    return result


def drive_of(floor: Floor, first_room: int, images: int, seed: int = 0) -> Drive:
    """Return what a robot measures on a drive that begins in front of a room; same seed, same bytes."""
    rng = np.random.default_rng([seed, 3])
    poses = way_through(first_room, images)
    t_ns = (np.arange(images) * 1e9 / HZ).astype(np.int64)
    truth = Trajectory(t_ns, poses)
    edges = []
    for begin in range(0, images, CHUNK):
        part = Trajectory(t_ns[begin : begin + CHUNK], poses[begin : begin + CHUNK])
        edges += _seen(floor, part, rng)
    drifted = _odometry(poses, rng)
    return Drive(
        floor.landmark_map.name, floor.landmark_map, CAMERA, Trajectory(t_ns, drifted), t_ns, edges, truth.poses
    )


def _odometry(poses: Array, rng: np.random.Generator) -> Array:
    """Return poses by wheels that slip a little."""
    result = [np.zeros(3)]
    for before, after in pairwise(poses):
        step = between(before, after)
        length = float(np.hypot(step[0], step[1]))
        step = step * 1.01 + rng.normal(0.0, [0.003, 0.01 * length + 1e-4, 0.002 + 0.01 * abs(step[2])])
        result.append(compose(result[-1], step))
    return np.array(result)


def _seen(floor: Floor, truth: Trajectory, rng: np.random.Generator) -> list:
    middle = truth.poses[:, :2].mean(axis=0)
    reach = NOISE.range_max_m + float(np.abs(truth.poses[:, :2] - middle).max()) + 1.0
    near = np.flatnonzero(np.abs(floor.landmark_map.points - middle).max(axis=1) < reach)
    walls = floor.walls[(np.abs(floor.walls - middle).max(axis=(1, 2)) < reach + ROOM_M)]
    local = floor.landmark_map.take(near)
    visible = np.zeros((len(truth), len(near)), dtype=bool)
    eyes = CAMERA.pose_in_map(truth.poses)
    right, ahead = in_camera(eyes, local.points)
    for frame, eye in enumerate(eyes):
        facing = np.flatnonzero((ahead[frame] > 0.1) & (np.abs(right[frame]) < ahead[frame]))
        if len(facing):
            hidden = hidden_behind(eye[:2], local.points[facing], walls, np.zeros((0, 3)))
            visible[frame, facing] = ~hidden
    return simulated_edges(local, CAMERA, truth, rng, noise=NOISE, visible=visible)
