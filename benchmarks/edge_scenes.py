"""Simulated images with known vertical edges, for judging edge detectors, and images in another light."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import cv2
import numpy as np

from localiser.camera import Camera, Mount
from localiser.geometry import Array

COUNTED_LENGTH_PX = 60.0
COUNTED_SIMULATED_STEP = 16.0
LEAST_STEP = 2.0
NEIGHBOUR_PX = 6.0
_LEAST_RUN_PX = 8.0


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """An image and its true vertical edges. truth_px: (T, 2, 2) bottom and top in the image as it was taken.

    share: (T,) how much of an edge between its ends nothing hides. counted: (T,) edges that a detector should find.
    alone: (T,) edges whose line is known exactly and has no other within 6 px, at any height.
    """

    image: Array
    camera: Camera
    truth_px: Array
    share: Array
    counted: Array
    alone: Array


@dataclass(frozen=True, slots=True)
class Difficulty:
    """How a simulated image is taken: lens, blur, noise. steps: grey levels between neighbours."""

    noise_sigma: float = 4.0
    blur_px: float = 0.7
    motion_px: int = 1
    steps: tuple[float, ...] = (20.0, 40.0, 70.0)
    model: str = "none"
    distortion: tuple[float, ...] = ()

    def camera(self) -> Camera:
        """Return the camera."""
        mount = Mount(np.deg2rad(20.0), 0.8, np.deg2rad(1.0))
        return Camera(640, 480, 554.0, 554.0, 319.5, 239.5, mount, self.model, self.distortion)


DIFFICULTIES = {
    "clean": Difficulty(noise_sigma=0.0, blur_px=0.0),
    "moderate": Difficulty(model="plumb_bob", distortion=(-0.25, 0.0, 0.0, 0.0)),
    "hard": Difficulty(noise_sigma=10.0, blur_px=0.0, motion_px=5, steps=(20.0,)),
}


@dataclass(frozen=True, slots=True)
class Light:
    """A change of an image: it is blurred (sigma, px), multiplied by `gain`, and noise (grey levels) is added."""

    gain: float = 1.0
    noise_sigma: float = 0.0
    blur_px: float = 0.0

    def taken(self, image: Array, rng: np.random.Generator) -> Array:
        """Return the changed image with noise, in 8 bits."""
        grey = image.astype(np.float64)
        if self.blur_px:
            grey = cv2.GaussianBlur(grey, (0, 0), self.blur_px)
        grey = np.clip(self.gain * grey, 0, 255)
        return np.clip(np.rint(grey + rng.normal(0, max(self.noise_sigma, 1e-9), grey.shape)), 0, 255).astype(np.uint8)


def simulated(difficulty: Difficulty, count: int, seed: int = 0) -> Iterator[Scene]:
    """Yield scenes of boxes that stand before one another, with shading and floor boards."""
    camera = difficulty.camera()
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

    def beyond(self, right: Array | float) -> Array:
        """Return the share (H, W) of each pixel that lies to the right of an edge, vertical or at (H, W) places."""
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
            for run in _visible_runs(camera, image.clip(0, 255), grey_at, index, (side, bottom, top)):
                truth.append(run[0])
                counted.append(run[1])
    ends = np.array(truth).reshape(-1, 2, 2)
    sides = np.tan(camera.bearing_of_segments(ends))[:, None] - np.ravel([box[:2] for box in boxes])
    alone = (np.abs(sides) * camera.focal_px < NEIGHBOUR_PX).sum(axis=1) == 1
    taken = _taken(image, difficulty, rng)
    return Scene(taken, camera, ends, np.ones(len(ends)), np.array(counted, dtype=bool), alone)


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
