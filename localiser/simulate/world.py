"""The world file (`localiser-world/1`): a building, and a robot that drives through it."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise
from typing import Annotated, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator
from pydantic_core import InitErrorDetails, PydanticCustomError

from localiser import geometry
from localiser.camera import DISTORTION_COUNTS, Camera, Mount, RollingShutter
from localiser.documents import is_name
from localiser.geometry import Array

# -- the robot: camera, drive, and errors of odometry and images ------------------------------------------------------

# YAML knows lists, not tuples; the numbers inside stay strict.
Metres = Annotated[float, Field(ge=-1e5, le=1e5)]
Degrees = Annotated[float, Field(ge=-3600, le=3600)]
Point = Annotated[tuple[Metres, Metres], Field(strict=False)]
Positive = Annotated[float, Field(gt=0, le=1e5)]
NotNegative = Annotated[float, Field(ge=0, le=1e5)]


class Model(BaseModel):
    """A part of a world file: strict types, no unknown keys, no nan."""

    model_config = ConfigDict(strict=True, extra="forbid", frozen=True, allow_inf_nan=False)


class MountSpec(Model):
    """Where the camera sits on the robot, as in a log's camera file."""

    tilt_deg: Annotated[float, Field(ge=-45, le=60)]
    height_m: Positive
    roll_deg: Annotated[float, Field(ge=-45, le=45)] = 0.0
    yaw_deg: Degrees = 0.0
    right_m: Metres = 0.0
    back_m: Metres = 0.0


class Sway(Model):
    """A sine about the usual value, in its unit."""

    amplitude: float
    hz: Annotated[float, Field(gt=0, le=20)]
    phase_deg: float = 0.0


class MountMotionSpec(Model):
    """How the camera moves on the robot. stated_sigma_deg: error of tilt and roll as the log states them per image."""

    tilt_deg: Sway | None = None
    roll_deg: Sway | None = None
    yaw_deg: Sway | None = None
    height_m: Sway | None = None
    stated_sigma_deg: Annotated[float, Field(ge=0, le=10)] = 0.0


class ShutterSpec(Model):
    """A rolling shutter, as in a log's camera file."""

    row_time_us: Annotated[float, Field(ge=-1000, le=1000)]
    stamp_row: Annotated[float, Field(ge=0, le=4096)] = 0.0


class CameraSpec(Model):
    """Pinhole and lens; the principal point is the image centre. motion: of the mount, none if fixed."""

    width: Annotated[int, Field(ge=16, le=4096)] = 640
    height: Annotated[int, Field(ge=16, le=4096)] = 480
    focal_px: Positive
    distortion_model: Literal["none", "plumb_bob", "rational_polynomial", "equidistant"] = "none"
    distortion: tuple[Annotated[float, Field(ge=-1e6, le=1e6)], ...] = Field(default=(), strict=False)
    mount: MountSpec
    motion: MountMotionSpec | None = None
    rolling_shutter: ShutterSpec | None = None

    @model_validator(mode="after")
    def _fits_together(self) -> CameraSpec:
        if self.rolling_shutter is not None and self.rolling_shutter.stamp_row > self.height - 1:
            found = self.rolling_shutter.stamp_row
            raise ValueError(f"expected stamp_row to be a row of the image, 0 to {self.height - 1}, found {found:g}")
        counts = DISTORTION_COUNTS[self.distortion_model]
        if len(self.distortion) not in counts:
            expected = " or ".join(map(str, counts))
            raise ValueError(
                f"{self.distortion_model}: expected {expected} distortion coefficients, found {len(self.distortion)}"
            )
        return self

    def camera(self, name: str = "") -> Camera:
        """Return the camera in SI units and radians."""
        mount, shutter = self.mount, self.rolling_shutter
        return Camera(
            width=self.width,
            height=self.height,
            fx=self.focal_px,
            fy=self.focal_px,
            cx=(self.width - 1) / 2,
            cy=(self.height - 1) / 2,
            mount=Mount(
                tilt_rad=float(np.deg2rad(mount.tilt_deg)),
                height_m=mount.height_m,
                roll_rad=float(np.deg2rad(mount.roll_deg)),
                yaw_rad=float(np.deg2rad(mount.yaw_deg)),
                right_m=mount.right_m,
                back_m=mount.back_m,
            ),
            distortion_model=self.distortion_model,
            distortion=self.distortion,
            name=name,
            shutter=RollingShutter(shutter.row_time_us / 1e6, shutter.stamp_row) if shutter else None,
        )


class WayPoint(Model):
    """A point of the path. corner_radius_m: of the arc that rounds this corner; 0 turns on the spot.

    speed_m_s: on the way to this point, the drive's when not given. pause_s: standing still there.
    """

    to: Point
    speed_m_s: Positive | None = None
    corner_radius_m: NotNegative = 0.0
    pause_s: NotNegative = 0.0


class DriveSpec(Model):
    """The path from its first point, heading for the second, with constant speed and turn rate on each piece.

    end_turn_deg: turn on the spot at the end. image_offset_s: time of the first image.
    """

    path: Annotated[tuple[WayPoint, ...], Field(strict=False, min_length=2, max_length=10_000)]
    speed_m_s: Positive = 0.5
    turn_deg_s: Positive = 40.0
    end_turn_deg: Degrees = 0.0
    image_hz: Annotated[float, Field(gt=0, le=1000)] = 5.0
    image_offset_s: NotNegative = 0.0
    odometry_hz: Annotated[float, Field(gt=0, le=1000)] = 20.0

    @property
    def headings(self) -> Array:
        """Heading (P - 1,) of each straight between two points of the path (P)."""
        step = np.diff(np.array([point.to for point in self.path]), axis=0)
        return np.arctan2(-step[:, 0], -step[:, 1])

    @property
    def cuts_m(self) -> Array:
        """Distance (P,) from each point at which the arc that rounds it begins and ends."""
        half = np.abs(geometry.wrap_angle(np.diff(self.headings))) / 2
        radius = np.array([point.corner_radius_m for point in self.path[1:-1]])
        # A turn by half a circle has no arc that touches both straights.
        tangent = np.where(half > np.pi / 2 - 1e-6, np.inf, np.tan(np.minimum(half, np.pi / 2 - 1e-6)))
        cut = np.multiply(radius, tangent, out=np.zeros_like(radius), where=radius > 0)
        return np.concatenate([[0.0], cut, [0.0]])

    @model_validator(mode="after")
    def _corners_fit(self) -> DriveSpec:
        points = np.array([point.to for point in self.path])
        length = np.linalg.norm(np.diff(points, axis=0), axis=1)
        if length.min() < 1e-6:
            raise ValueError(f"expected way points apart, found {self.path[int(length.argmin())].to} twice in a row")
        needed = self.cuts_m[:-1] + self.cuts_m[1:]
        if (needed > length + 1e-9).any():
            k = int((needed - length).argmax())
            raise ValueError(
                f"expected room for the corners between way points {k + 1} and {k + 2}: "
                f"they need {needed[k]:.2f} m, found {length[k]:.2f} m; use a smaller corner_radius_m"
            )
        return self


class OdometrySpec(Model):
    """Errors of the odometry, systematic first. The slow scales are Ornstein–Uhlenbeck processes in time."""

    distance_scale: Annotated[float, Field(gt=-1, le=100)] = 0.0
    rotation_scale: Annotated[float, Field(gt=-1, le=100)] = 0.0
    veer_deg_per_m: Degrees = 0.0
    distance_noise_m_per_sqrt_m: NotNegative = 0.0
    heading_walk_deg_per_sqrt_m: NotNegative = 0.0
    turn_noise_deg_per_sqrt_deg: NotNegative = 0.0
    slow_scale_sigma: NotNegative = 0.0
    slow_scale_time_s: Positive = 10.0


class ImageSpec(Model):
    """What lens, sensor and storage do to an image. exposure_s blurs it by the robot's own motion."""

    colour: bool = True
    noise_sigma: NotNegative = 1.0
    blur_px: NotNegative = 0.0
    exposure_s: NotNegative = 0.0
    vignette: Annotated[float, Field(ge=0, lt=1)] = 0.0
    jpeg_quality: Annotated[int, Field(ge=1, le=100)] = 90


class StartSpec(Model):
    """How well the start is known: the log states the true start plus an error with these sigmas."""

    sigma_m: Annotated[float, Field(ge=0, le=1000)] = 0.1
    sigma_deg: Annotated[float, Field(ge=0, le=360)] = 3.0


# -- the building -----------------------------------------------------------------------------------------------------

MOST_SOLIDS = 10_000  # an image asks each of them for each of its columns

Colour = Annotated[
    tuple[
        Annotated[int, Field(ge=0, le=255)], Annotated[int, Field(ge=0, le=255)], Annotated[int, Field(ge=0, le=255)]
    ],
    Field(strict=False),
]


class Material(Model):
    """What a surface looks like. size_m: of one board, tile, brick, stripe or picture; each texture has its own.

    number: of the AprilTag (tag36h11) that a `marker` is: size_m with its white rim, a tenth of that on each side.
    """

    texture: Literal["plain", "plaster", "wallpaper", "brick", "wood", "planks", "tiles", "carpet", "picture", "marker"]
    colour: Colour
    size_m: Positive | None = None
    contrast: Annotated[float, Field(ge=0, le=1)] = 0.5
    number: Annotated[int, Field(ge=0, lt=587)] = 0


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


class Upright(Model):
    """What reaches from one height to another, that of the ceiling where it is not given."""

    bottom_m: NotNegative = 0.0
    top_m: Positive | None = None

    @model_validator(mode="after")
    def _stands_upright(self) -> Upright:
        if self.top_m is not None and self.top_m <= self.bottom_m:
            raise ValueError(f"expected top_m above bottom_m, found {self.top_m} and {self.bottom_m}")
        return self


class Poster(Upright):
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


class Post(Upright):
    """A pillar: a regular polygon of 3 to 8 sides with this circumscribed diameter (4 sides: width_m is the side)."""

    x: Metres
    z: Metres
    width_m: Positive
    sides: Annotated[int, Field(ge=3, le=8)] = 4
    rotation_deg: Degrees = 0.0
    material: str


class Box(Upright):
    """A piece of furniture, or a part of one: an upright block, turned anticlockwise about its middle."""

    x: Metres
    z: Metres
    width_m: Positive
    depth_m: Positive
    rotation_deg: Degrees = 0.0
    top_m: Positive
    material: str


class Surface(Model):
    """The floor or the ceiling; boards run along map z."""

    material: str


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
    def _fits_together(self) -> World:
        below_ceiling = ("height_m", 1e-3, self.ceiling_m - 1e-3)
        for name, low, high in (("tilt_deg", -45, 60), ("roll_deg", -45, 45), ("yaw_deg", -180, 180), below_ceiling):
            usual, sway = getattr(self.camera.mount, name), getattr(self.camera.motion, name, None)
            by = abs(sway.amplitude) if sway else 0.0
            if not low <= usual - by <= usual + by <= high:
                raise ValueError(f"expected camera.mount.{name} from {low:g} to {high:g}, found {usual:g} ± {by:g}")
        openings = sum(1 + len(wall.doors) + len(wall.posters) for wall in self.walls)
        if (found := openings + len(self.posts) + len(self.furniture)) > MOST_SOLIDS:
            raise ValueError(f"expected at most {MOST_SOLIDS} walls, openings, posts and boxes, found {found}")
        return self


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


def _materials_used(part: Model, at: tuple[int | str, ...] = ()) -> Iterator[tuple[tuple[int | str, ...], str]]:
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
