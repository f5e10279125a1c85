"""Buildings for simulated hours of tracking: what hides, what shows as a vertical edge, what of it is on the map.

Seven kinds, each drawn at random: shelves full of books, a room of chairs with thin legs, bare corridors, rooms in a
row that look alike, a hall in which people and carts move, long corridors around a block, and floors of one building.
All clutter stands in the world, so that it is seen again from the next place with the right parallax. Door frames show
as two or three edges, of which the map may have one.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from localiser.geometry import Array

HIDES_M = 1.0  # what is taller hides what is behind it
CEILING_M = 2.6
WALL_M = 0.12
FORGOTTEN = 0.1  # share of what could be on the map and is not


@dataclass(frozen=True, slots=True, eq=False)
class Mover:
    """A person or cart that goes back and forth between two points. radius_m: of a person; 0 for a cart."""

    start: Array
    end: Array
    speed_m_s: float
    radius_m: float

    def at(self, seconds: float) -> tuple[Array, Array]:
        """Return where it is, and its direction, a unit vector; (2,) each."""
        way = self.end - self.start
        length = float(np.hypot(*way))
        there = (seconds * self.speed_m_s / length) % 2.0
        return self.start + way * (there if there < 1.0 else 2.0 - there), way / length


@dataclass(slots=True, eq=False)
class Building:
    """What stands in a building; filled piece by piece.

    walls: segments (2, 2) that hide. feet: circles (x, z, radius) that a robot drives round. edges: rows of x, z,
    bottom_m, top_m, whether mapped. worn: rows as edges, of things that the map still has where they no longer are.
    sees_m: how far away edges are found.
    """

    size: tuple[float, float]
    rng: np.random.Generator
    walls: list[Array] = field(default_factory=list)
    feet: list[tuple[float, float, float]] = field(default_factory=list)
    edges: list[tuple[float, float, float, float, bool]] = field(default_factory=list)
    worn: list[tuple[float, float, float, float, bool]] = field(default_factory=list)
    movers: list[Mover] = field(default_factory=list)
    inside: tuple[float, float] = (0.7, 0.8)
    sees_m: float = 8.0

    def edge(self, point: Array, bottom_m: float, top_m: float, mapped: bool) -> None:
        """Add a vertical edge."""
        known = mapped and self.rng.random() > FORGOTTEN
        self.edges.append((float(point[0]), float(point[1]), bottom_m, top_m, known))

    def wall(self, start: tuple[float, float], end: tuple[float, float], doors: list[tuple[float, bool]] = ()) -> None:
        """Add a wall with doors of 0.9 m at these distances from its start, open or closed."""
        begin, finish = np.array(start, dtype=float), np.array(end, dtype=float)
        length = float(np.hypot(*(finish - begin)))
        along = (finish - begin) / length
        across = np.array([-along[1], along[0]])
        at = 0.0
        for middle, is_open in sorted(doors):
            if is_open:
                self.walls.append(np.array([begin + at * along, begin + (middle - 0.45) * along]))
                at = middle + 0.45
            for side in (-1.0, 1.0):
                self._frame(begin, along, across * side, middle)
        self.walls.append(np.array([begin + at * along, finish]))
        for corner in (begin, finish):
            self.edge(corner, 0.0, CEILING_M, True)

    def box(
        self,
        middle: tuple[float, float],
        size: tuple[float, float],
        top_m: float,
        *,
        turned: float = 0.0,
        mapped: bool = True,
        bottom_m: float = 0.0,
    ) -> None:
        """Add a piece of furniture."""
        half = np.array(size) / 2
        turn = np.array([[np.cos(turned), -np.sin(turned)], [np.sin(turned), np.cos(turned)]])
        corners = np.array(middle) + (np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * half) @ turn.T
        for corner in corners:
            self.edge(corner, bottom_m, top_m, mapped)
        sides = [np.array([corners[k], corners[k - 1]]) for k in range(4)]
        self.walls += sides if top_m > HIDES_M else []
        if top_m <= HIDES_M:
            self.feet.append((*middle, float(np.hypot(*half))))

    def _frame(self, begin: Array, along: Array, across: Array, middle: float) -> None:
        """Add the frame of a door as it is seen from one side: two edges each side, at times a third."""
        face = begin + across * WALL_M / 2
        for jamb, outward in ((middle - 0.45, -1.0), (middle + 0.45, 1.0)):
            self.edge(face + jamb * along, 0.0, 2.05, True)
            self.edge(face + (jamb + outward * 0.07) * along, 0.0, 2.12, self.rng.random() < 0.5)
            if self.rng.random() < 0.4:
                self.edge(face + (jamb + outward * self.rng.uniform(0.015, 0.05)) * along, 0.0, 2.05, False)


def _room(building: Building, doors: int = 2) -> None:
    """Add four walls with closed doors and windows."""
    width, depth = building.size
    corners = [(0.0, 0.0), (width, 0.0), (width, depth), (0.0, depth)]
    for k, corner in enumerate(corners):
        end = corners[(k + 1) % 4]
        length = abs(end[0] - corner[0]) + abs(end[1] - corner[1])
        slots = building.rng.permutation(np.arange(1.2, length - 1.2, 1.8))
        building.wall(corner, end, [(float(at), False) for at in slots[: min(doors, len(slots))]])
        for at in slots[doors : doors + 2]:
            _window(building, np.array(corner), np.array(end), float(at))


def _window(building: Building, start: Array, end: Array, at: float) -> None:
    along = (end - start) / np.hypot(*(end - start))
    inward = np.array([-along[1], along[0]]) * 0.03
    for offset in (-0.5, -0.45, 0.0, 0.05, 0.5):
        building.edge(start + inward + (at + offset) * along, 0.7, 1.9, abs(offset) == 0.5)


def shelves(rng: np.random.Generator) -> Building:
    """A shop: rows of shelves with books. Their uprights are mapped, the books are not."""
    building = Building((rng.uniform(10.5, 13.0), 9.0), rng)
    _room(building, 1)
    depth, aisle, low, high = 0.5, rng.uniform(1.4, 1.8), 1.7, 7.3
    for x in np.arange(aisle, building.size[0] - aisle, depth + aisle):
        for side in (-1.0, 1.0):
            face = x + depth / 2 + side * depth / 2
            building.walls.append(np.array([[face, low], [face, high]]))
            for upright in np.linspace(low, high, 7):
                building.edge(np.array([face + 0.01 * side, upright]), 0.0, 1.9, True)
                building.edge(np.array([face + 0.01 * side, upright + 0.025]), 0.0, 1.9, False)
            for bay in np.linspace(low, high, 7)[:-1]:
                _books(building, face + 0.02 * side, float(bay))
        for end in (low, high):
            building.walls.append(np.array([[x, end], [x + depth, end]]))
    return building


def _books(building: Building, x: float, low: float) -> None:
    """Add the spines of three boards of a bay: evenly thick on each, and only some stand out from their neighbours."""
    rng = building.rng
    for board in (0.25, 0.65, 1.05):
        at = np.arange(0.03, rng.uniform(0.2, 0.9), rng.uniform(0.025, 0.06))
        for spine in at[rng.random(len(at)) < 0.6]:
            building.edge(np.array([x, low + spine]), board, board + rng.uniform(0.18, 0.28), False)


def chairs(rng: np.random.Generator) -> Building:
    """A room of tables and chairs with thin legs; of the chairs some stand elsewhere now, and some are new."""
    building = Building((9.0, 8.0), rng)
    _room(building)
    for x in (2.2, 4.5, 6.8):
        for z in (2.1, 5.7):
            middle = np.array([x, z]) + rng.uniform(-0.25, 0.25, 2)
            building.box((float(middle[0]), float(middle[1])), (0.06, 0.06), 0.72)
            for angle in np.arange(4) * np.pi / 2 + rng.uniform(0, np.pi):
                _chair(building, middle + rng.uniform(0.55, 0.75) * np.array([np.cos(angle), np.sin(angle)]))
    return building


def _chair(building: Building, at: Array) -> None:
    rng = building.rng
    state = rng.choice(["mapped", "moved", "new"], p=[0.4, 0.3, 0.3])
    for leg in _legs(at, rng.uniform(0, 2 * np.pi)):
        building.edges.append((*leg, state == "mapped"))
    if state == "moved":
        way = rng.uniform(0.1, 0.6) * np.array([np.cos(a := rng.uniform(0, 2 * np.pi)), np.sin(a)])
        building.worn += [(*leg, True) for leg in _legs(at + way, rng.uniform(0, 2 * np.pi))]
    building.feet.append((*map(float, at), 0.25))


def _legs(at: Array, turned: float) -> list[tuple[float, float, float, float]]:
    """Return both edges of each leg; those of the back are taller."""
    turn = np.array([[np.cos(turned), -np.sin(turned)], [np.sin(turned), np.cos(turned)]])
    places = np.array([[x + dx, z] for x in (-0.2, 0.2) for z in (-0.2, 0.2) for dx in (-0.017, 0.017)])
    tops = [0.85 if z > 0 else 0.45 for _, z in places]
    return [(float(x), float(z), 0.0, top) for (x, z), top in zip(at + places @ turn.T, tops, strict=True)]


def corridors(rng: np.random.Generator) -> Building:
    """A long corridor with two side corridors: doors, a poster here and there, nothing else."""
    building = Building((24.0, 10.0), rng, inside=(12.0, 1.0))
    width, branches = 2.0, sorted(rng.choice([4.0, 8.0, 14.0, 19.0], 2, replace=False))
    building.wall((0.0, 0.0), (24.0, 0.0), _doors(rng, 24.0))
    at = 0.0
    for branch in branches:
        building.wall((at, width), (branch, width), _doors(rng, branch - at))
        building.wall((branch, width), (branch, 10.0), _doors(rng, 8.0))
        building.wall((branch, 10.0), (branch + 1.8, 10.0))
        building.wall((branch + 1.8, 10.0), (branch + 1.8, width), _doors(rng, 8.0))
        at = branch + 1.8
    building.wall((at, width), (24.0, width), _doors(rng, 24.0 - at))
    for x in (0.0, 24.0):
        building.wall((x, 0.0), (x, width))
    for at in rng.uniform(0.5, 23.5, 5):
        for edge in (0.0, rng.uniform(0.4, 0.8)):
            building.edge(np.array([at + edge, 0.02]), 0.6, 1.3, False)
    return building


def _doors(rng: np.random.Generator, length: float) -> list[tuple[float, bool]]:
    at = np.arange(rng.uniform(1.0, 2.5), length - 0.8, rng.uniform(3.0, 4.5))
    return [(float(np.clip(one + rng.uniform(-0.3, 0.3), 0.6, length - 0.6)), False) for one in at if length > 1.6]


def alike(rng: np.random.Generator) -> Building:
    """Five rooms in a row off a corridor, all alike but for one thing each; what lies about is on no map."""
    rooms, width, depth, hall = 5, 3.6, 4.0, 1.8
    building = Building((rooms * width, hall + depth), rng)
    building.wall((0.0, 0.0), (rooms * width, 0.0), [(k * width + 1.0, False) for k in range(rooms)])
    building.wall((0.0, hall), (rooms * width, hall), [(k * width + 1.0, True) for k in range(rooms)])
    building.wall((0.0, hall + depth), (rooms * width, hall + depth))
    for k in range(rooms + 1):
        building.wall((k * width, hall), (k * width, hall + depth))
    for x in (0.0, rooms * width):
        building.wall((x, 0.0), (x, hall))
    for k in range(rooms):
        left, own = k * width, rng.uniform([0.5, 0.8], [3.0, 3.2])
        building.box((left + 2.9, hall + 0.6), (0.9, 0.4), 1.9)
        building.box((left + 2.9, hall + 3.3), (1.0, 0.7), 0.74)
        building.box((left + 0.3, hall + 3.2), (0.35, 0.8), 1.2)
        _window(building, np.array([left + width, hall + depth]), np.array([left, hall + depth]), 1.6)
        building.box(
            (left + float(own[0]), hall + float(own[1])), (0.3, 0.3), 0.5, turned=rng.uniform(0, 3), mapped=k % 2 == 0
        )
        for point in rng.uniform([0.3, 0.3], [3.3, 3.7], (6, 2)):
            building.edge(np.array([left, hall]) + point, 0.0, rng.uniform(0.2, 0.6), False)
    return building


def crowd(rng: np.random.Generator) -> Building:
    """A hall with cabinets, columns and desks, in which six people and two carts move."""
    building = Building((11.0, 9.0), rng)
    _room(building)
    for x, z in ((3.0, 3.0), (8.0, 3.0), (3.0, 6.0), (8.0, 6.0)):
        building.box((x, z), (0.4, 0.4), CEILING_M)
    for x in (1.5, 5.5, 9.0):
        building.box((x + rng.uniform(-0.3, 0.3), 0.35), (0.9, 0.45), 1.8)
        building.box((x + rng.uniform(-0.3, 0.3), 8.5), (1.4, 0.7), 0.75)
    for number in range(8):
        ends = rng.uniform([0.8, 1.2], [10.2, 7.8], (2, 2))
        while np.hypot(*(ends[1] - ends[0])) < 2.0:
            ends = rng.uniform([0.8, 1.2], [10.2, 7.8], (2, 2))
        radius = 0.0 if number >= 6 else rng.uniform(0.18, 0.28)
        building.movers.append(Mover(ends[0], ends[1], rng.uniform(0.2, 1.0), radius))
    return building


def ring(rng: np.random.Generator) -> Building:
    """Long corridors around a block, with a door or two; one sees from end to end, and hardly anything between."""
    length, depth, width = rng.uniform(16.0, 22.0), rng.uniform(9.0, 12.0), rng.uniform(1.5, 2.0)
    building = Building((length, depth), rng, sees_m=25.0)
    outer = [(0.0, 0.0), (length, 0.0), (length, depth), (0.0, depth)]
    inner = [(width, width), (length - width, width), (length - width, depth - width), (width, depth - width)]
    doors = rng.choice(8, 2, replace=False)
    for k, (start, end) in enumerate(
        (corners[k], corners[(k + 1) % 4]) for corners in (outer, inner) for k in range(4)
    ):
        side = abs(end[0] - start[0]) + abs(end[1] - start[1])
        building.wall(start, end, [(float(rng.uniform(1.0, side - 1.0)), False)] if k in doors else [])
    for at in rng.uniform(2.0, length - 2.0, 2):
        for edge in (0.0, rng.uniform(0.4, 0.8)):
            building.edge(np.array([at + edge, 0.02]), 0.6, 1.3, False)
    return building


def floor(rng: np.random.Generator) -> Building:
    """One floor of a building: a straight corridor, 2 m wide on every floor, with doors and posters at other places."""
    length, width = rng.uniform(24.0, 32.0), 2.0
    building = Building((length, width), rng, inside=(rng.uniform(8.0, 16.0), width / 2))
    for z in (0.0, width):
        at = np.cumsum(rng.uniform(1.3, 4.0, 24)) - 0.5
        building.wall((0.0, z), (length, z), [(float(one), False) for one in at[at < length - 0.8]])
    for x in (0.0, length):
        building.wall((x, 0.0), (x, width))
    for at, z in zip(rng.uniform(1.0, length - 1.0, 6), rng.choice([0.02, width - 0.02], 6), strict=True):
        mapped = bool(rng.random() < 0.5)
        for edge in (0.0, rng.uniform(0.4, 0.8)):
            building.edge(np.array([at + edge, z]), 0.6, 1.3, mapped)
    return building


KINDS: dict[str, Callable[[np.random.Generator], Building]] = {
    "shelves": shelves,
    "chairs": chairs,
    "corridors": corridors,
    "alike": alike,
    "crowd": crowd,
    "ring": ring,
    "floor": floor,
}
