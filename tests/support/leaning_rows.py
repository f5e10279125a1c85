"""Drives along rows of things that lean, and the lines that a camera would measure of them."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from localiser.calibration import Lines, lines_of
from localiser.camera import Camera, Mount
from localiser.edges import Edges
from localiser.geometry import Array, robot_from_map, wrap_angle

FARTHEST_M, SHORTEST_PX, END_SIGMA_PX, BORDER_PX = 5.0, 30.0, 0.25, 3.0
LEVELS_M = np.array([0.1, 0.5, 0.9, 1.3])  # of the boards that things stand on
_STEPS = np.linspace(0.0, 1.0, 25)


@dataclass(frozen=True, slots=True, eq=False)
class LeaningDrive:
    """Lines of the images of a drive; camera: as it is mounted truly. odometry: (F, 3), with drift."""

    lines: Lines
    camera: Camera
    odometry: Array

    @property
    def mount(self) -> Array:
        """The true tilt and roll (2,) rad."""
        return np.array([self.camera.mount.tilt_rad, self.camera.mount.roll_rad])


@dataclass(frozen=True, slots=True, eq=False)
class _Things:
    """Edges (P) of things: foot: (P, 2) m, bottom_m, top_m: (P,), lean: (P, 2) rad, facing: (P, 2) out of the row."""

    foot: Array
    bottom_m: Array
    top_m: Array
    lean: Array
    facing: Array


def leaning_drive(seed: int, *, row_deg: float, own_deg: float, along: str = "any") -> LeaningDrive:
    """Return a drive round a room with a row of things along each wall and round an island, and with clutter.

    row_deg: how far all things of a row lean alike, one sigma, and own_deg: each by itself beyond that. along: the row
    leans `along` itself, `back` into the wall, or in `any` direction. Tilt is 12° to 35°, roll up to 4° either way.
    """
    rng = np.random.default_rng(seed)
    tilt, roll = np.deg2rad([rng.uniform(12, 35), rng.uniform(-4, 4)])
    camera = Camera(640, 480, 520.0, 520.0, 319.5, 239.5, Mount(float(tilt), rng.uniform(0.5, 1.2), float(roll)))
    corners = np.array([[0.0, 0.0], [0.0, 1.0], [1.0, 1.0], [1.0, 0.0], [0.0, 0.0]]) * rng.uniform(2.5, 7.0, 2)
    rows = _walls(corners, rng)
    things = _joined([_row(start, end, rng, row_deg, own_deg, along) for start, end in rows])
    poses = _path(corners[:: rng.choice([-1, 1])])
    parts = [_seen(things, camera, pose, frame, rng) for frame, pose in enumerate(poses)]
    drift = np.column_stack([np.zeros((len(poses), 2)), np.cumsum(rng.normal(0, 0.004, len(poses)))])
    return LeaningDrive(Lines.together(parts), camera, poses + drift)


def _walls(corners: Array, rng: np.random.Generator) -> list[tuple[Array, Array]]:
    """Return start and end of the walls round a path, and of an island within it; their right side is seen."""
    low, high = corners.min(axis=0), corners.max(axis=0)
    outer = low - rng.uniform(1, 2, 2), high + rng.uniform(1, 2, 2)
    inner = (high[0] - 0.7, low[1] + 0.7), (low[0] + 0.7, high[1] - 0.7)
    walls = []
    for (left, near), (right, far) in (outer, inner):
        box = np.array([[left, near], [left, far], [right, far], [right, near]])
        walls += list(zip(box, np.roll(box, -1, axis=0), strict=True))
    return walls


def _row(start: Array, end: Array, rng: np.random.Generator, row_deg: float, own_deg: float, along: str) -> _Things:
    """Return what stands along a wall: plumb posts of shelves, and things on their boards."""
    length = np.linalg.norm(end - start)
    way = (end - start) / length
    facing = np.array([way[1], -way[0]])
    lean = {"along": rng.normal() * way, "back": rng.normal() * facing, "any": rng.normal(0, 1, 2)}[along] * row_deg
    posts = np.arange(rng.uniform(0, 0.5), length, rng.uniform(0.8, 3.0))
    books = np.cumsum(rng.uniform(0.05, 0.25, 400))
    books = books[books < length]
    level = rng.choice(LEVELS_M, len(books))
    at = np.concatenate([posts, books])
    count = len(at)
    own = np.where(np.arange(count)[:, None] < len(posts), rng.normal(0, 0.05, (count, 2)), lean)
    own[len(posts) :] += rng.normal(0, own_deg, (len(books), 2))
    bottom = np.concatenate([np.zeros(len(posts)), level])
    top = np.concatenate([np.full(len(posts), 1.6), level + rng.uniform(0.2, 0.3, len(books))])
    return _Things(start + at[:, None] * way, bottom, top, np.deg2rad(own), np.tile(facing, (count, 1)))


def _joined(rows: list[_Things]) -> _Things:
    columns = ("foot", "bottom_m", "top_m", "lean", "facing")
    return _Things(*(np.concatenate([getattr(row, name) for row in rows]) for name in columns))


def _path(corners: Array) -> Array:
    """Return poses (F, 3) along the corners, 0.2 m apart, with turns on the spot."""
    poses: list[Array] = []
    for start, end in pairwise(corners):
        heading = np.arctan2(*(start - end))
        before = poses[-1][2] if poses else heading
        turn = float(wrap_angle(heading - before))
        poses += [np.array([*start, before + part * turn]) for part in np.linspace(0, 1, 8)[1:] if turn]
        way = end - start
        poses += [np.array([*(start + part * way), heading]) for part in np.arange(0, 1, 0.2 / np.linalg.norm(way))]
    return np.array(poses)


def _seen(things: _Things, camera: Camera, pose: Array, frame: int, rng: np.random.Generator) -> Lines:
    """Return the lines of an image: four of five things that face the camera, and some that are of nothing."""
    eye = camera.pose_in_map(pose)
    offset = eye[:2] - things.foot
    near = np.flatnonzero(((offset * things.facing).sum(axis=1) > 0) & (np.hypot(*offset.T) < FARTHEST_M))
    near = near[rng.random(len(near)) < 0.8]
    height = things.bottom_m[near, None] + (things.top_m - things.bottom_m)[near, None] * _STEPS
    above = height - (things.bottom_m + things.top_m)[near, None] / 2
    floor = robot_from_map(eye, (things.foot[near, None] + above[..., None] * things.lean[near, None]).reshape(-1, 2))
    level = np.stack([floor[:, 0], height.reshape(-1) - camera.mount.height_m, floor[:, 1]], axis=-1)
    px = camera.project_level(level).reshape(len(near), len(_STEPS), 2)
    size = np.array([camera.width, camera.height])
    inside = (np.isfinite(px) & (px > BORDER_PX) & (px < size - 1 - BORDER_PX)).all(axis=-1)
    lowest, highest = inside.argmax(axis=1), len(_STEPS) - 1 - inside[:, ::-1].argmax(axis=1)
    each = np.arange(len(near))
    ends = np.stack([px[each, lowest], px[each, highest]], axis=1)[inside.any(axis=1)]
    ends = ends[np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1) > SHORTEST_PX]
    start, angle = rng.uniform([20, 150], [620, 460], (2, 2)), rng.uniform(-0.25, 0.25, 2)
    clutter = np.stack([start, start - 80 * np.stack([np.sin(angle), np.cos(angle)], axis=-1)], axis=1)
    return lines_of(_edges(np.concatenate([ends, clutter]), rng), camera, frame)


def _edges(ends: Array, rng: np.random.Generator) -> Edges:
    """Return edges with ends (E, 2, 2) that were measured with noise across them."""
    way = ends[:, 1] - ends[:, 0]
    length = np.linalg.norm(way, axis=1)
    across = np.stack([-way[:, 1], way[:, 0]], axis=-1) / length[:, None]
    ends = ends + across[:, None] * rng.normal(0, END_SIGMA_PX, (len(ends), 2, 1))
    unknown = np.zeros(len(ends))
    return Edges.from_columns(unknown, unknown + 1e-3, unknown, np.sqrt(2) * END_SIGMA_PX / length, ends_px=ends)
