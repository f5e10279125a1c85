"""The world file (`localiser-world/1`): a building, and a robot that drives through it."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise
from typing import Annotated, Literal

import numpy as np
from pydantic import Field, ValidationError, model_validator
from pydantic_core import InitErrorDetails, PydanticCustomError

from localiser.documents import is_name
from localiser.simulate.robot import (
    CameraSpec,
    Degrees,
    DriveSpec,
    ImageSpec,
    Metres,
    Model,
    NotNegative,
    OdometrySpec,
    Point,
    Positive,
    StartSpec,
)

MOST_SOLIDS = 10_000  # an image asks each of them for each of its columns

Colour = Annotated[
    tuple[
        Annotated[int, Field(ge=0, le=255)], Annotated[int, Field(ge=0, le=255)], Annotated[int, Field(ge=0, le=255)]
    ],
    Field(strict=False),
]


class Material(Model):
    """What a surface looks like. size_m: of one board, tile, brick, stripe or picture; each texture has its own."""

    texture: Literal["plain", "plaster", "wallpaper", "brick", "wood", "planks", "tiles", "carpet", "picture"]
    colour: Colour
    size_m: Positive | None = None
    contrast: Annotated[float, Field(ge=0, le=1)] = 0.5


class Leaf(Model):
    """The leaf of a door: closed at angle 0, else swung to one side of the wall (seen from `from` towards `to`)."""

    angle_deg: Annotated[float, Field(ge=0, le=175)] = 0.0
    hinge: Literal["from", "to"] = "from"
    side: Literal["left", "right"] = "left"
    thickness_m: Positive = 0.04
    material: str = "door"


class Door(Model):
    """An opening in a wall, its middle `at_m` from the wall's start; with a frame that stands out from the wall."""

    at_m: Positive
    width_m: Positive = 0.9
    height_m: Positive = 2.05
    frame_m: NotNegative = 0.07
    frame_out_m: Positive = 0.012
    frame_material: str = "frame"
    leaf: Leaf | None = None


class Poster(Model):
    """A flat picture on a wall: it has vertical edges in the image, yet no depth, so it is no landmark."""

    at_m: Positive
    width_m: Positive
    bottom_m: NotNegative
    top_m: Positive
    side: Literal["left", "right"]
    material: str


class Wall(Model):
    """A wall between two floor points; it reaches half its thickness beyond both, so that corners close.

    height_m: that of the ceiling when not given. Left and right are seen from `from` towards `to`.
    """

    start: Point = Field(alias="from")
    end: Point = Field(alias="to")
    thickness_m: Positive = 0.12
    height_m: Positive | None = None
    material: str = "wall"
    doors: tuple[Door, ...] = Field(default=(), strict=False, max_length=1000)
    posters: tuple[Poster, ...] = Field(default=(), strict=False, max_length=1000)

    @property
    def length_m(self) -> float:
        """Distance between the two points."""
        return float(np.hypot(self.end[0] - self.start[0], self.end[1] - self.start[1]))

    @model_validator(mode="after")
    def _openings_fit(self) -> Wall:
        if self.length_m < 1e-6:
            raise ValueError("expected two different points, found the same one twice")
        reach = sorted((door.at_m - door.width_m / 2, door.at_m + door.width_m / 2) for door in self.doors)
        if reach and (reach[0][0] < 0 or reach[-1][1] > self.length_m):
            raise ValueError(f"expected doors within the wall's {self.length_m:.2f} m, found one that sticks out")
        if any(end > start for (_, end), (start, _) in pairwise(reach)):
            raise ValueError("expected doors beside each other, found two that overlap")
        return self


class Post(Model):
    """A pillar: a regular polygon of 3 to 8 sides with this circumscribed diameter (4 sides: width_m is the side)."""

    x: Metres
    z: Metres
    width_m: Positive
    sides: Annotated[int, Field(ge=3, le=8)] = 4
    rotation_deg: Degrees = 0.0
    bottom_m: NotNegative = 0.0
    top_m: Positive | None = None
    material: str


class Box(Model):
    """A piece of furniture, or a part of one: an upright block, turned anticlockwise about its middle."""

    x: Metres
    z: Metres
    width_m: Positive
    depth_m: Positive
    rotation_deg: Degrees = 0.0
    bottom_m: NotNegative = 0.0
    top_m: Positive
    material: str

    @model_validator(mode="after")
    def _stands_upright(self) -> Box:
        if self.top_m <= self.bottom_m:
            raise ValueError(f"expected top_m above bottom_m, found {self.top_m} and {self.bottom_m}")
        return self


class Surface(Model):
    """The floor or the ceiling; boards run at `direction_deg`, anticlockwise from map −z."""

    material: str
    direction_deg: Degrees = 0.0


class Lamp(Model):
    """A lamp: adds `strength` to the light right below it, at `height_m` above the floor."""

    x: Metres
    z: Metres
    height_m: Positive = 2.4
    strength: Positive = 0.3


class Light(Model):
    """The light: even everywhere, more on faces turned towards `from_deg` (heading), lamps, dark corners."""

    ambient: Annotated[float, Field(gt=0, le=2)] = 0.8
    directional: Annotated[float, Field(ge=0, le=1)] = 0.25
    from_deg: Degrees = 30.0
    lamps: tuple[Lamp, ...] = Field(default=(), strict=False, max_length=1000)


class World(Model):
    """A building and a drive through it."""

    format: Literal["localiser-world/1"]
    name: Annotated[str, Field(min_length=1), is_name]
    ceiling_m: Positive = 2.6
    materials: dict[str, Material]
    floor: Surface
    ceiling: Surface
    light: Light = Light()
    walls: tuple[Wall, ...] = Field(default=(), strict=False)
    posts: tuple[Post, ...] = Field(default=(), strict=False)
    furniture: tuple[Box, ...] = Field(default=(), strict=False)
    camera: CameraSpec
    drive: DriveSpec
    odometry: OdometrySpec = OdometrySpec()
    image: ImageSpec = ImageSpec()
    start: StartSpec = StartSpec()

    @model_validator(mode="after")
    def _is_not_too_much(self) -> World:
        openings = sum(1 + len(wall.doors) + len(wall.posters) for wall in self.walls)
        if (found := openings + len(self.posts) + len(self.furniture)) > MOST_SOLIDS:
            raise ValueError(f"expected at most {MOST_SOLIDS} walls, openings, posts and boxes, found {found}")
        return self


Location = tuple[int | str, ...]


def world_of(data: object) -> World:
    """Return the world that a parsed YAML file describes.

    Raises pydantic.ValidationError; each of its errors has a `loc` that leads to the place in the file.
    """
    world = World.model_validate(data)
    known = ", ".join(sorted(world.materials))
    problems = [
        InitErrorDetails(type=PydanticCustomError("unknown_material", "{text}", {"text": text}), loc=loc, input=name)
        for loc, name in _materials_used(world)
        if name not in world.materials
        for text in [f"expected one of the world's materials ({known}), found '{name}'"]
    ]
    if problems:
        raise ValidationError.from_exception_data("World", problems)
    return world


def _materials_used(part: Model, at: Location = ()) -> Iterator[tuple[Location, str]]:
    """Yield where a part of the world names a material, and which."""
    for name, value in part:
        loc = (*at, name)
        if name in ("material", "frame_material"):
            yield loc, value
        elif isinstance(value, Model):
            yield from _materials_used(value, loc)
        elif isinstance(value, tuple):
            for index, each in enumerate(value):
                if isinstance(each, Model):
                    yield from _materials_used(each, (*loc, index))
