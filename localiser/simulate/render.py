"""Images of a world: exact level columns, textured and lit, then tilted, blurred and noisy as a camera's are."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray

from localiser import geometry
from localiser.camera import Camera
from localiser.geometry import Array, Trajectory
from localiser.simulate.drive import mount_at
from localiser.simulate.level_view import (
    FLOOR,
    Columns,
    LevelView,
    Spans,
    cast,
    columns_of,
    level_view_of,
    require_view_ahead,
    spans_of,
    strip_view_of,
)
from localiser.simulate.structure import Structure, structure_of
from localiser.simulate.surfaces import Atlas, Image, Lighting, atlas_of, lighting_of
from localiser.simulate.world import ImageSpec, World

_BLUR_STEP_PX = 1.5  # motion blur averages sharp images no further apart than this
_BLUR_STEPS_MOST = 16
_STRIP_M = 0.001  # of driving: it moves an edge that is 1 m away by a seventh of a pixel at most, either way
_STRIP_PX = 0.25  # of a camera that tilts on the robot


@dataclass(frozen=True, eq=False)
class Scene:
    """A world and the camera that sees it. What only rendering needs is made when it is first used.

    part: the level view of some rows of the image alone; None: of all.
    """

    world: World
    camera: Camera
    structure: Structure
    part: LevelView | None = None

    @cached_property
    def atlas(self) -> Atlas:
        """The textures of all materials."""
        return atlas_of(self.world.materials)

    @cached_property
    def lighting(self) -> Lighting:
        """The light on every face."""
        path = np.array([point.to for point in self.world.drive.path])
        return lighting_of(self.world.light, self.structure.solids, path)

    def camera_at(self, t_ns: int) -> Camera:
        """The camera as it is mounted at a time."""
        return self.camera.at(mount_at(self.camera.mount, self.world.camera.motion, t_ns))

    def seen_by(self, camera: Camera, part: LevelView | None = None) -> Scene:
        """Return the scene seen by another camera, with all that has been made of the world."""
        other = replace(self, camera=camera, part=part)
        other.__dict__.update(atlas=self.atlas, lighting=self.lighting)
        return other

    @property
    def view(self) -> LevelView:
        """The level view of the camera."""
        return self.part or level_view_of(self.camera)


def scene_of(world: World, camera: Camera | None = None) -> Scene:
    """Return the world made ready for the camera (the world's own when not given).

    Raises ValueError when the camera looks straight down.
    """
    camera = camera or world.camera.camera(world.name)
    require_view_ahead(camera)
    return Scene(world, camera, structure_of(world))


def render(scene: Scene, robot_pose: Array, rng: np.random.Generator) -> NDArray[np.uint8]:
    """Return the image, (H, W) grey or (H, W, 3) BGR as the world says, taken from a robot that stands at (3,)."""
    return _developed(radiance(scene, robot_pose), scene.world.image, rng)


def expose(scene: Scene, truth: Trajectory, t_ns: int, rng: np.random.Generator) -> NDArray[np.uint8]:
    """Return the image with the middle of its exposure at `t_ns`, blurred by the robot's motion.

    Where the shutter rolls, that is the exposure of the row that is taken at the time stamp.
    """
    half_ns = round(scene.world.image.exposure_s * 5e8)
    begin_ns, end_ns = t_ns - half_ns, t_ns + half_ns
    # Turning moves the image most, driving at most half as much.
    motion = geometry.between(truth.at(begin_ns), truth.at(end_ns))
    mount, then = (scene.camera_at(at_ns).mount for at_ns in (begin_ns, end_ns))
    turned = abs(motion[2] + (then.yaw_rad - mount.yaw_rad)) + np.hypot(
        then.tilt_rad - mount.tilt_rad, then.roll_rad - mount.roll_rad
    )
    moved_px = scene.camera.focal_px * (turned + np.hypot(motion[0], motion[1]) / 2)
    steps = int(np.clip(np.ceil(moved_px / _BLUR_STEP_PX), 1, _BLUR_STEPS_MOST))
    times = [t_ns + round((2 * share - 1) * half_ns) for share in (np.arange(steps) + 0.5) / steps]
    sharp = [sharp_image(scene, truth, at_ns) for at_ns in times]
    light = sum(sharp[1:], start=sharp[0]) / np.float32(steps)
    return _developed(light, scene.world.image, rng)


def sharp_image(scene: Scene, truth: Trajectory, t_ns: int) -> Image:
    """Return the image (H, W, 3) float32 RGB of a perfect lens and sensor whose stamped row is taken at a time.

    The rows of a rolling shutter are taken in strips, each from one place. In a strip, every row is taken with the
    heading that the camera has then.
    """
    shutter = scene.camera.shutter
    if shutter is None:
        return radiance(scene, truth.at(t_ns), scene.camera_at(t_ns))
    rows = np.arange(scene.camera.height)
    row_ns = t_ns + np.round(shutter.since_stamp_s(rows) * 1e9).astype(np.int64)
    cameras = [scene.camera_at(int(at_ns)) for at_ns in row_ns]
    poses = np.array([camera.pose_in_map(truth.at(int(at_ns))) for camera, at_ns in zip(cameras, row_ns, strict=True)])
    moved_m = float(np.hypot(*np.diff(poses[:, :2], axis=0).T).sum())
    mounts = np.array([[one.mount.tilt_rad, one.mount.roll_rad, one.mount.height_m] for one in cameras])
    swayed = float(np.abs(np.diff(mounts, axis=0)).sum())
    count = np.clip(np.ceil(moved_m / _STRIP_M + swayed * scene.camera.focal_px / _STRIP_PX), 1, len(rows))
    strips = []
    for strip in np.array_split(rows, int(count)):
        middle = strip[len(strip) // 2]
        camera, pose = cameras[middle], poses[middle]
        turned_rad = geometry.wrap_angle(poses[strip, 2] - pose[2])
        view = strip_view_of(camera, slice(int(strip[0]), int(strip[-1]) + 1), turned_rad)
        strips.append(_seen_from(scene.seen_by(camera, view), pose))
    return np.concatenate(strips)


def radiance(scene: Scene, robot_pose: Array, camera: Camera | None = None) -> Image:
    """Return the image (H, W, 3) float32 RGB of a perfect lens and sensor; camera: the scene's, as it is mounted."""
    scene = scene if camera is None or camera is scene.camera else scene.seen_by(camera)
    return _seen_from(scene, scene.camera.pose_in_map(robot_pose))


def _seen_from(scene: Scene, pose: Array) -> Image:
    """Return the image that the camera has at a floor pose (3,) of its own."""
    columns = columns_of(scene.view, pose, scene.structure.edges.points)
    eye = scene.camera.mount.height_m
    hits = cast(scene.structure.solids, pose, columns.tangent)
    spans = spans_of(scene.structure.solids, hits, scene.view, columns, (eye, scene.world.ceiling_m))
    return scene.view.image(_level_image(scene, pose, columns, spans))


def _developed(image: Image, spec: ImageSpec, rng: np.random.Generator) -> NDArray[np.uint8]:
    """Return the 8-bit image as OpenCV has it, BGR or grey: lens blur, vignette, noise, rounding."""
    if spec.blur_px > 0:
        image = np.asarray(cv2.GaussianBlur(image, (0, 0), spec.blur_px), dtype=np.float32)
    height, width = image.shape[:2]
    if spec.vignette > 0:
        u, v = np.meshgrid(np.linspace(-1, 1, width), np.linspace(-1, 1, height))
        image = image * (1 - spec.vignette * (u**2 + v**2) / 2).astype(np.float32)[..., None]
    code = cv2.COLOR_RGB2BGR if spec.colour else cv2.COLOR_RGB2GRAY
    image = np.asarray(cv2.cvtColor(image, code), dtype=np.float32)
    noise = rng.standard_normal(image.shape, dtype=np.float32) * np.float32(spec.noise_sigma)
    return np.clip(np.rint(image + noise), 0, 255).astype(np.uint8)


# -- colouring the level view ------------------------------------------------------------------------------------------


Samples = tuple[
    NDArray[np.intp],
    NDArray[np.float32],
    NDArray[np.intp],
    NDArray[np.float32],
    NDArray[np.float32],
    NDArray[np.float32],
]
"""Samples of the level view, S of them: index (S,) in the flat view, brightness (S,), and what `Atlas.sample` takes:
material (S,), where across and up on its texture (S,) m, and the size that a sample stands for (S,) m."""


def _level_image(scene: Scene, pose: Array, columns: Columns, spans: Spans) -> Image:
    """Return the level view (columns, rows, 3): each column the mean of its rays, weighted by their shares."""
    rows = scene.view.rows
    rays = np.zeros((len(columns.tangent), rows, 3), dtype=np.float32)
    flat = rays.reshape(-1, 3)
    for colour in (_upright, _level):
        place, brightness, material, across, up, footprint = colour(scene, pose, columns, spans)
        flat[place] = scene.atlas.sample(material, across, up, footprint) * brightness[:, None]
    first = np.searchsorted(columns.owner, np.arange(scene.view.columns))
    image = rays[first]
    stop = np.append(first[1:], len(columns.owner))
    for column in np.flatnonzero(stop - first > 1):
        part = slice(first[column], stop[column])
        image[column] = np.tensordot(columns.share[part].astype(np.float32), rays[part], axes=1)
    return image


def _rows_of(view: LevelView, spans: Spans, chosen: NDArray[np.bool_]) -> tuple[NDArray[np.intp], ...]:
    """Return for every sample of the chosen spans: index among them, row, and place in the flat view."""
    count = spans.count[chosen]
    span = np.repeat(np.arange(len(count)), count)
    before = np.cumsum(count) - count
    row = np.arange(len(span)) + np.repeat(spans.first_row[chosen] - before, count)
    return span, row, row + np.repeat(spans.column[chosen] * view.rows, count)


def _upright(scene: Scene, pose: Array, columns: Columns, spans: Spans) -> Samples:
    """Return samples of faces: along the face from where the ray meets it, upwards with the elevation."""
    chosen = spans.is_upright
    solid, distance = spans.solid[chosen], spans.distance_m[chosen]
    tangent = columns.tangent[spans.column[chosen]]
    ray = geometry.forward(pose[2]) + tangent[:, None] * geometry.right(pose[2])
    points = pose[:2] + distance[:, None] * ray
    normals, offsets = scene.structure.solids.half_planes()
    side = np.abs((normals[solid] * points[:, None]).sum(axis=-1) - offsets[solid]).argmin(axis=1)
    normal, corner = normals[solid, side], scene.structure.solids.corners[solid, side]
    along = np.stack([normal[:, 1], -normal[:, 0]], axis=-1)
    across = ((points - corner) * along).sum(axis=1) + scene.structure.solids.along_m[solid]
    facing = np.abs((normal * ray).sum(axis=1)) / np.hypot(1.0, tangent)
    footprint = distance / scene.view.per_unit / np.sqrt(np.maximum(facing, 0.05))
    bright = scene.lighting.of_faces(points, normal)
    above = scene.camera.mount.height_m - scene.structure.solids.above_m[solid]
    span, row, place = _rows_of(scene.view, spans, chosen)
    up = _at(span, above) + _at(span, distance) * scene.view.elevation_of_rows(row)
    material = _materials(scene)[solid][span]
    return place, _at(span, bright), material, _at(span, across), up, _at(span, footprint)


def _level(scene: Scene, pose: Array, columns: Columns, spans: Spans) -> Samples:
    """Return samples of floor, ceiling, tops and undersides: where the ray meets their height."""
    chosen = ~spans.is_upright
    solid, above = spans.solid[chosen], spans.above_m[chosen]
    tangent = columns.tangent[spans.column[chosen]]
    ray = geometry.forward(pose[2]) + tangent[:, None] * geometry.right(pose[2])
    span, row, place = _rows_of(scene.view, spans, chosen)
    above_s = _at(span, above)
    distance = above_s / scene.view.elevation_of_rows(row)
    x = np.float32(pose[0]) + distance * _at(span, ray[:, 0])
    z = np.float32(pose[1]) + distance * _at(span, ray[:, 1])
    # One sample is distance / per_unit wide and distance² / (height · per_unit) long; the mean of both decides.
    footprint = distance * np.sqrt(distance / np.abs(above_s)) / np.float32(scene.view.per_unit)
    world = scene.world
    floor, ceiling = (scene.atlas.index[surface.material] for surface in (world.floor, world.ceiling))
    materials = np.append(_materials(scene), [ceiling, floor])  # CEILING is -2, FLOOR is -1
    is_floor = (solid == FLOOR)[span]
    middle_row = np.minimum(spans.first_row[chosen] + spans.count[chosen] // 2, scene.view.rows - 1)
    middle = (above / scene.view.elevation_of_rows(middle_row))[:, None] * ray + pose[:2]
    bright = _at(span, scene.lighting.of_tops(middle, above > 0))
    bright[is_floor] = scene.lighting.of_floor(x[is_floor], z[is_floor])
    return place, bright, materials[solid][span], x, -z, footprint


def _at(index: NDArray[np.intp], values: Array) -> NDArray[np.float32]:
    return values.astype(np.float32)[index]


def _materials(scene: Scene) -> NDArray[np.intp]:
    return np.array([scene.atlas.index[name] for name in scene.structure.solids.material], dtype=np.intp)
