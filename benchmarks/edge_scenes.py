"""Images with known vertical edges, for judging edge detectors: simulated in three classes, and two data sets."""

from __future__ import annotations

import csv
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
import yaml

from localiser.camera import Camera, Mount
from localiser.geometry import Array, edge_a_at, robot_from_map
from localiser.simulate import simulate_log, world_of

COUNTED_LENGTH_PX = 60.0
COUNTED_STEP = 8.0
COUNTED_SIMULATED_STEP = 16.0
LEAST_STEP = 2.0
NEIGHBOUR_PX = 6.0
_LEAST_RUN_PX = 8.0


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """An image and its true vertical edges. truth_px: (T, 2, 2) bottom and top in the image as it was taken.

    counted: (T,) edges that a detector should find. alone: (T,) edges without a true neighbour within 6 px.
    """

    image: Array
    camera: Camera
    truth_px: Array
    counted: Array
    alone: Array


# -- simulated --------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Difficulty:
    """What is done to a simulated image."""

    noise_sigma: float
    blur_px: float
    motion_px: int
    k1: float
    steps: tuple[float, ...]


DIFFICULTIES = {
    "clean": Difficulty(0.0, 0.0, 1, 0.0, (20.0, 40.0, 70.0)),
    "moderate": Difficulty(4.0, 0.7, 1, -0.25, (20.0, 40.0, 70.0)),
    "hard": Difficulty(10.0, 0.0, 5, 0.0, (20.0,)),
}


def simulated(kind: str, count: int, seed: int = 0) -> Iterator[Scene]:
    """Yield scenes of boxes that stand before one another, with shading, floor boards and slanted clutter."""
    difficulty = DIFFICULTIES[kind]
    distortion = (difficulty.k1, 0.0, 0.0, 0.0) if difficulty.k1 else ()
    model = "plumb_bob" if distortion else "none"
    mount = Mount(np.deg2rad(20.0), 0.8, np.deg2rad(1.0))
    camera = Camera(640, 480, 554.0, 554.0, 319.5, 239.5, mount, model, distortion)
    view = _Rays(camera)
    for index in range(count):
        yield _simulate(camera, view, difficulty, np.random.default_rng([seed, index]))


class _Rays:
    """Directions of a camera's pixels: right and up over ahead, (H, W) each, and right per pixel."""

    def __init__(self, camera: Camera) -> None:
        rays = camera.level_rays(np.stack(np.meshgrid(np.arange(camera.width), np.arange(camera.height)), axis=-1))
        self.right, self.up = rays[..., 0] / -rays[..., 2], rays[..., 1] / -rays[..., 2]
        self.right_per_u = np.gradient(self.right, axis=1)
        self.right_per_v = np.gradient(self.right, axis=0)
        self.up_per_v = np.abs(np.gradient(self.up, axis=0))

    def beyond(self, right: float) -> Array:
        """Return the share (H, W) of each pixel that lies to the right of a vertical edge."""
        # A square pixel crossed by a leaning edge: two box filters, of the widths of the pixel along u and along v.
        position = self.right - right
        wide, narrow = np.abs(self.right_per_u), np.abs(self.right_per_v)
        return (_ramp(position + narrow / 2, wide, narrow) - _ramp(position - narrow / 2, wide, narrow)).clip(0, 1)

    def above(self, up: Array | float) -> Array:
        """Return the share (H, W) of each pixel above a height."""
        return ((self.up - up) / self.up_per_v + 0.5).clip(0, 1)


def _ramp(position: Array, wide: Array, narrow: Array) -> Array:
    """Return the integral of a unit ramp of width `wide`, over `narrow`; differences of it are a box of a ramp."""
    from_start = (position + wide / 2).clip(0, None)
    past_end = (position - wide / 2).clip(0, None)
    return (from_start**2 - past_end**2) / (2 * wide * np.maximum(narrow, 1e-12))


def _simulate(camera: Camera, view: _Rays, difficulty: Difficulty, rng: np.random.Generator) -> Scene:
    step = float(rng.choice(difficulty.steps))
    image = _background(view, camera, step, rng)
    grey_at = np.full(image.shape, -1)
    boxes = _boxes(difficulty, rng)
    for index, (left, right, bottom, top, grey, shade) in enumerate(boxes):
        inside = (view.beyond(left) - view.beyond(right)) * (view.above(bottom) - view.above(top))
        image += inside * (grey + shade * view.up - image)
        grey_at[inside > 0.5] = index
    truth, counted = [], []
    for index, (left, right, bottom, top, *_) in enumerate(boxes):
        for side in (left, right):
            for run in _visible_runs(camera, image, grey_at, index, (side, bottom, top)):
                truth.append(run[0])
                counted.append(run[1])
    ends = np.array(truth).reshape(-1, 2, 2)
    sides = np.tan(camera.bearing_of_segments(ends))[:, None] - np.ravel([box[:2] for box in boxes])
    alone = (np.abs(sides) * camera.focal_px < NEIGHBOUR_PX).sum(axis=1) == 1
    return Scene(_taken(image, difficulty, rng), camera, ends, np.array(counted, dtype=bool), alone)


def _background(view: _Rays, camera: Camera, step: float, rng: np.random.Generator) -> Array:
    """Return a wall with soft shading above a floor of boards that do not run along the line of sight."""
    rough = cv2.GaussianBlur(rng.normal(0, 1, view.up.shape), (0, 0), 25)
    fine = cv2.GaussianBlur(rng.normal(0, 1, view.up.shape), (0, 0), 1.5)
    image = 120 + 8 * rough / rough.std() + 2 * fine / fine.std()
    on_floor = 1 - view.above(-camera.mount.height_m / 5.0)
    ahead = camera.mount.height_m / np.maximum(-view.up, 1e-3)
    boards = np.sign(np.sin(2 * np.pi * (ahead + 0.6 * ahead * view.right) / 0.5))
    return image + on_floor * (20 + step / 4 * boards)


def _boxes(difficulty: Difficulty, rng: np.random.Generator) -> list[tuple[float, ...]]:
    """Return boxes (left, right, bottom, top, grey, shade), far to near; greys differ by whole steps."""
    boxes: list[tuple[float, ...]] = []
    for depth in np.linspace(5.0, 1.2, 14):
        left = rng.uniform(-0.75, 0.65)
        width = rng.choice([rng.uniform(0.02, 0.06), rng.uniform(0.06, 0.3)])
        bottom, top = -0.8 / depth, rng.uniform(-0.5, 1.6) / depth
        if rng.random() < 0.3:
            bottom, top = rng.uniform(-0.1, 0.4) / depth, rng.uniform(0.8, 1.6) / depth
        sign = rng.choice([-1.0, 1.0])
        grey = 120 + sign * float(rng.choice(difficulty.steps)) * rng.integers(
            1, 2 if len(difficulty.steps) == 1 else 3
        )
        if top - bottom > 0.05:
            boxes.append((left, left + width, bottom, top, float(np.clip(grey, 10, 245)), rng.uniform(-6, 6)))
    return boxes


def _visible_runs(
    camera: Camera, image: Array, drawn: Array, index: int, side: tuple[float, float, float]
) -> Iterator[tuple[Array, bool]]:
    """Yield ((2, 2) ends, counted) of the parts of a box's side that nothing hides and that show a step."""
    right, bottom, top = side
    ups = np.linspace(bottom, top, 400)
    pixels = camera.project_level(np.stack([np.full_like(ups, right), ups, np.full_like(ups, -1.0)], axis=-1))
    pixels = np.nan_to_num(pixels, nan=-1.0)
    inside = ((pixels >= 1) & (pixels <= [camera.width - 2, camera.height - 2])).all(axis=1)
    column, row = np.rint(pixels).astype(int).clip(0, [camera.width - 1, camera.height - 1]).T
    near = [drawn[row, (column + by).clip(0, camera.width - 1)] for by in (-2, 2)]
    owned = (np.maximum(*near) == index) & (near[0] != near[1])
    step = image[row, (column + 3).clip(0, camera.width - 1)] - image[row, (column - 3).clip(0, camera.width - 1)]
    visible = inside & owned & (np.abs(step) >= LEAST_STEP)
    changes = np.flatnonzero(np.diff(np.concatenate([[0], visible.astype(int), [0]])))
    for start, stop in changes.reshape(-1, 2):
        ends = pixels[[start, stop - 1]]
        length = float(np.linalg.norm(ends[1] - ends[0]))
        if length >= _LEAST_RUN_PX:
            strong = abs(float(np.median(step[start:stop]))) >= COUNTED_SIMULATED_STEP
            yield ends, length >= COUNTED_LENGTH_PX and strong


def _taken(image: Array, difficulty: Difficulty, rng: np.random.Generator) -> Array:
    if difficulty.blur_px:
        image = cv2.GaussianBlur(image, (0, 0), difficulty.blur_px)
    if difficulty.motion_px > 1:
        image = cv2.blur(image, (difficulty.motion_px, 1))
    noisy = image + rng.normal(0, max(difficulty.noise_sigma, 1e-9), image.shape)
    return np.clip(np.rint(noisy), 0, 255).astype(np.uint8)


def rendered(world_file: Path, every: int = 1) -> Iterator[Scene]:
    """Yield scenes of a drive through a world that ships with the project."""
    log = simulate_log(world_of(yaml.safe_load(world_file.read_text())), seed=0)
    for index in range(0, len(log), every):
        image, visible = log.image(index), log.visible[index]
        grey = image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
        ends = visible.ends_px
        counted = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1) >= COUNTED_LENGTH_PX
        yield Scene(grey, log.camera, ends, counted & (_median_step(grey, ends) >= COUNTED_STEP), is_alone(ends))


# -- data sets --------------------------------------------------------------------------------------------------------


def house(folder: Path, every: int = 1) -> Iterator[Scene]:
    """Yield scenes of a rendered log with the exact visibility of its landmarks.

    A landmark may stand for several edges up to 2 cm apart; bearings are judged where it stands for one.
    """
    camera = _camera_of(folder / "camera.yaml")
    exact, visible = defaultdict(list), defaultdict(list)
    for row in _rows(folder / "edges_exact.csv"):
        exact[row["landmark_id"]].append([float(row["x"]), float(row["z"])])
    for row in _rows(folder / "visible.csv"):
        visible[int(row["image"])].append(row)
    poses = {
        int(row["t_ns"]): [float(row[key]) for key in ("x", "z", "heading")]
        for row in _rows(folder / "groundtruth.csv")
    }
    for index, row in enumerate(_rows(folder / "images.csv")):
        if index % every:
            continue
        image = cv2.imread(str(folder / row["file"]), cv2.IMREAD_GRAYSCALE)
        known = visible[index]
        ends = np.array(
            [[[float(edge[f"{axis}_{end}"]) for axis in "uv"] for end in ("bottom", "top")] for edge in known]
        )
        ends = ends.reshape(-1, 2, 2)
        share = np.array([float(edge["visible_fraction"]) for edge in known])
        visible_px = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1) * share
        counted = (visible_px >= COUNTED_LENGTH_PX) & (_median_step(image, ends) >= COUNTED_STEP)
        single = np.array([len(exact[edge["landmark_id"]]) == 1 for edge in known], dtype=bool)
        alone = is_alone(ends) & single
        points = np.array(
            [exact[edge["landmark_id"]][0] if one else [np.nan] * 2 for edge, one in zip(known, single, strict=True)]
        )
        moved = _at_points(ends, points.reshape(-1, 2), camera, np.array(poses[int(row["t_ns"])]))
        yield Scene(image, camera, np.where(single[:, None, None], moved, ends), counted, alone)


def _at_points(ends_px: Array, points: Array, camera: Camera, pose: Array) -> Array:
    """Return segments (T, 2, 2) moved to the vertical edges at map points (T, 2), at the same image heights."""
    right, backward = robot_from_map(camera.pose_in_map(pose), points).T
    height = camera.upright_from_pixels(ends_px)[..., 1]
    across = edge_a_at(height, np.arctan2(right, -backward)[:, None], camera.mount.tilt_rad)
    return camera.pixels_from_upright(np.stack([across, height], axis=-1))


def york_urban(folder: Path) -> Iterator[Scene]:
    """Yield photographs with hand-labelled lines, each with its own tilt and roll."""
    labels = defaultdict(list)
    for row in _rows(folder / "labelled_lines.csv"):
        if row["is_vertical"] == "1":
            labels[row["image"]].append([float(row[key]) for key in ("x1", "y1", "x2", "y2")])
    for row in _rows(folder / "images.csv"):
        mount = Mount(np.deg2rad(float(row["pitch_down_deg"])), 1.5, np.deg2rad(float(row["roll_deg"])))
        intrinsics = (float(row[key]) for key in ("fx", "fy", "cx", "cy"))
        camera = Camera(int(row["width"]), int(row["height"]), *intrinsics, mount)
        image = cv2.imread(str(next((folder / "images").glob(f"{row['image']}.*"))), cv2.IMREAD_GRAYSCALE)
        ends = np.array(labels[row["image"]]).reshape(-1, 2, 2)
        upside_down = ends[:, 0, 1] < ends[:, 1, 1]
        ends = np.where(upside_down[:, None, None], ends[:, ::-1], ends)
        counted = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1) >= COUNTED_LENGTH_PX
        yield Scene(image, camera, ends, counted, is_alone(ends))


def is_alone(ends_px: Array) -> Array:
    """Return (T,) whether edges (T, 2, 2) have no other within 6 px of their middle."""
    middle = ends_px.mean(axis=1)
    apart = distance_px(middle[:, None, :], ends_px)[:, 0]
    np.fill_diagonal(apart, np.inf)
    return np.all(apart > NEIGHBOUR_PX, axis=1) if len(ends_px) else np.zeros(0, dtype=bool)


def distance_px(points: Array, ends_px: Array) -> Array:
    """Return the distance (P, K, F) of points (P, K, 2) from segments (F, 2, 2)."""
    start, along = ends_px[:, 0], ends_px[:, 1] - ends_px[:, 0]
    relative = points[:, :, None] - start
    share = ((relative * along).sum(axis=-1) / np.maximum((along**2).sum(axis=-1), 1e-9)).clip(0, 1)
    return np.linalg.norm(relative - share[..., None] * along, axis=-1)


def _median_step(image: Array, ends: Array) -> Array:
    """Return (T,) the size of the median grey difference across ±2.5 px of edges (T, 2, 2)."""
    along = np.linspace(0.02, 0.98, 60)[None, :, None]
    points = (ends[:, :1] * (1 - along) + ends[:, 1:] * along).astype(np.float32)
    if len(points) == 0:
        return np.zeros(0)
    left, right = (
        cv2.remap(
            image.astype(np.float32),
            points + np.float32([by, 0]),
            None,
            cv2.INTER_LINEAR,
            borderMode=cv2.BORDER_REPLICATE,
        )
        for by in (-2.5, 2.5)
    )
    return np.abs(np.median(right - left, axis=1))


def _camera_of(path: Path) -> Camera:
    fields = yaml.safe_load(path.read_text())
    fx, _, cx, _, fy, cy = fields["camera_matrix"]["data"][:6]
    mount = fields["mount"]
    angles = {f"{name}_rad": np.deg2rad(mount[f"{name}_deg"]) for name in ("tilt", "roll", "yaw")}
    return replace(
        Camera(
            fields["image_width"], fields["image_height"], fx, fy, cx, cy, Mount(height_m=mount["height_m"], **angles)
        ),
        distortion_model=fields["distortion_model"],
        distortion=tuple(fields["distortion_coefficients"]["data"]),
    )


def _rows(path: Path) -> list[dict[str, str]]:
    with path.open() as file:
        return list(csv.DictReader(file))
