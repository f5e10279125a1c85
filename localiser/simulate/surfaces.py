"""How surfaces look: their textures, even light, a main direction, lamps, and floors that darken towards walls."""

from __future__ import annotations

import zlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from localiser import geometry
from localiser.errors import InputError
from localiser.geometry import Array
from localiser.markers import DICTIONARIES
from localiser.simulate.solids import Solids
from localiser.simulate.world import Light, Material

# -- textures ---------------------------------------------------------------------------------------------------------

Image = NDArray[np.float32]

TILE_PX = 512
LEVELS = 8


@dataclass(frozen=True, slots=True, eq=False)
class Atlas:
    """Textures of M materials, each repeated without seam and stored at LEVELS halvings of its resolution.

    image: the atlas, (H, W, 3) float32, grey values 0–255, RGB. index: material name → m. tile_m: (M,) size of the
    repeated square. corner_px: (M, LEVELS, 2) where (column, row) each level's square begins.
    """

    image: Image
    index: Mapping[str, int]
    tile_m: Array
    corner_px: Image

    def sample(
        self, material: NDArray[np.intp], across_m: Image, up_m: Image, footprint_m: NDArray[np.float32]
    ) -> Image:
        """Return colours (S, 3) float32 at texture positions (S,) m, averaged over about `footprint_m` (S,) each."""
        tile = self.tile_m.astype(np.float32)[material]
        level = np.log2(np.maximum(footprint_m * (TILE_PX / tile), 1.0)).astype(np.intp)
        np.minimum(level, LEVELS - 1, out=level)
        corner = self.corner_px[material, level]
        size = (TILE_PX >> level).astype(np.float32)
        pixels = []
        for axis, position in enumerate((across_m, -up_m)):
            share = position / tile
            share -= np.floor(share)
            pixels.append(share * size + corner[:, axis] - np.float32(0.5))
        return look_up(self.image, *pixels)


def look_up(image: Image, column: Image, row: Image) -> Image:
    """Return the image (H, W, …) at sub-pixel positions (S,), interpolated between its pixels; its rim outside."""
    # OpenCV's look-up takes at most 32767 samples in a row: fold them to a rectangle.
    width, count = 4096, len(column)
    if count == 0:  # an image that shows no floor
        return np.zeros((0, *image.shape[2:]), dtype=np.float32)
    folded = []
    for position in (column, row):
        padded = np.zeros(-(-count // width) * width, dtype=np.float32)
        padded[:count] = position
        folded.append(padded.reshape(-1, width))
    sampled = cv2.remap(image, folded[0], folded[1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(sampled, dtype=np.float32).reshape(-1, *image.shape[2:])[:count]


def atlas_of(materials: Mapping[str, Material]) -> Atlas:
    """Return the atlas of these materials; each texture depends on nothing but its material and its name."""
    strips, tile_m = [], []
    for name, material in materials.items():
        rng = np.random.default_rng(zlib.crc32(name.encode()))
        texture, default_m = _TEXTURES[material.texture]
        if material.texture == "marker":
            texture = partial(texture, material.number)
        shade, side_m = texture(material.size_m or default_m, material.contrast, rng)
        colour = np.array(material.colour, dtype=np.float32)
        tinted = shade * colour if shade.ndim == 3 else shade[..., None] * colour
        tile, levels = np.clip(tinted, 0, 255).astype(np.float32), []
        for size in (TILE_PX >> level for level in range(LEVELS)):
            small = cv2.resize(tile, (size, size), interpolation=cv2.INTER_AREA)
            padded = cv2.copyMakeBorder(small, _PAD, _PAD, _PAD, _PAD, cv2.BORDER_WRAP)
            levels.append(cv2.copyMakeBorder(padded, 0, TILE_PX - size, 0, 0, cv2.BORDER_CONSTANT))
        strips.append(np.concatenate(levels, axis=1))
        tile_m.append(side_m)
    corners = np.array([[_corner(m, level) for level in range(LEVELS)] for m in range(len(strips))], dtype=np.float32)
    return Atlas(np.concatenate(strips), {name: m for m, name in enumerate(materials)}, np.array(tile_m), corners)


_PAD = 1  # each level's square repeats its rim, so that interpolation wraps


def _corner(m: int, level: int) -> tuple[int, int]:
    column = sum((TILE_PX >> k) + 2 * _PAD for k in range(level))
    return column + _PAD, m * (TILE_PX + 2 * _PAD) + _PAD


# -- the textures: (size_m, contrast, rng) → brightness (TILE, TILE) or (TILE, TILE, 3) about 1, and the tile's side ---

Texture = tuple[NDArray[np.floating[Any]], float]


def _noise(rng: np.random.Generator, across_px: float, up_px: float) -> Image:
    """Return smooth noise of unit variance that repeats without seam, correlated over so many pixels."""
    k = np.fft.fftfreq(TILE_PX)
    response = np.exp(-2 * (np.pi * k[None, :] * across_px) ** 2 - 2 * (np.pi * k[:, None] * up_px) ** 2)
    smooth = np.fft.ifft2(np.fft.fft2(rng.standard_normal((TILE_PX, TILE_PX))) * response).real
    return np.asarray((smooth - smooth.mean()) / smooth.std(), dtype=np.float32)


def _cells(position: NDArray[np.floating[Any]], count: int) -> tuple[NDArray[np.intp], Image]:
    """Return which of `count` equal cells a position in [0, 1) lies in, and the distance (cells) from its border."""
    scaled = position * count
    cell = np.floor(scaled)
    return cell.astype(np.intp) % count, np.asarray(0.5 - np.abs(scaled - cell - 0.5), dtype=np.float32)


def _grid() -> tuple[Image, Image]:
    """Return positions across and up (TILE, TILE) of pixels' middles, as shares of the tile."""
    middle = ((np.arange(TILE_PX) + 0.5) / TILE_PX).astype(np.float32)
    return np.broadcast_to(middle, (TILE_PX, TILE_PX)), np.broadcast_to(middle[::-1, None], (TILE_PX, TILE_PX))


def _seam(distance_m: NDArray[np.floating[Any]], width_m: float, tile_m: float) -> Image:
    """Return 1 inside a seam of this width, 0 outside, with soft sides of one pixel."""
    return np.asarray(np.clip((width_m / 2 - distance_m) / (tile_m / TILE_PX) + 0.5, 0.0, 1.0), dtype=np.float32)


def _plain(size_m: float, contrast: float, rng: np.random.Generator) -> Texture:
    return 1 + 0.02 * contrast * _noise(rng, 60, 60), size_m


def _plaster(size_m: float, contrast: float, rng: np.random.Generator) -> Texture:
    mottled = 0.5 * _noise(rng, 50, 50) + 0.5 * _noise(rng, 12, 12) + 0.6 * _noise(rng, 2, 2)
    return 1 + 0.05 * contrast * mottled, size_m


def _carpet(size_m: float, contrast: float, rng: np.random.Generator) -> Texture:
    return 1 + contrast * (0.12 * _noise(rng, 1.2, 1.2) + 0.08 * _noise(rng, 30, 30)), size_m


def _wallpaper(size_m: float, contrast: float, rng: np.random.Generator) -> Texture:
    """Upright stripes, two of them in size_m, on paper."""
    across, _ = _grid()
    stripe, _ = _cells(across, 8)
    paper = np.array([1.0, 1.0 - 0.25 * contrast], dtype=np.float32)[stripe % 2]
    return paper + 0.02 * _noise(rng, 3, 3), 4 * size_m


def _wood(size_m: float, contrast: float, rng: np.random.Generator) -> Texture:
    grain = 0.7 * _noise(rng, 2.5, 120) + 0.5 * _noise(rng, 20, 200)
    return 1 + 0.1 * contrast * grain, size_m


def _brick(size_m: float, contrast: float, rng: np.random.Generator) -> Texture:
    """Stretcher bond: bricks size_m long and a third of it high, every other course shifted by half a brick."""
    columns, courses = 4, 12
    tile = columns * size_m
    across, up = _grid()
    course, above = _cells(up, courses)
    brick, beside = _cells(across + (course % 2) * np.float32(0.5 / columns), columns)
    tone = rng.normal(1.0, 0.12 * contrast, size=(courses, columns)).astype(np.float32)[course, brick]
    mortar = np.maximum(_seam(above * tile / courses, 0.01, tile), _seam(beside * tile / columns, 0.01, tile))
    rough = 1 + 0.04 * _noise(rng, 2, 2)
    return (tone * (1 - mortar) + (1 - 0.55 * contrast) * mortar) * rough, tile


def _planks(size_m: float, contrast: float, rng: np.random.Generator) -> Texture:
    """Boards size_m wide, eight in the tile and as long as it, with staggered ends and dark seams."""
    boards = 8
    tile = boards * size_m
    across, up = _grid()
    board, beside = _cells(across, boards)
    shift = rng.random(boards).astype(np.float32)[board]
    _, end = _cells((up + shift) % 1.0, 1)
    tone = rng.normal(1.0, 0.09 * contrast, size=boards).astype(np.float32)[board]
    grain = 0.6 * _noise(rng, 1.5, 60) + 0.6 * _noise(rng, 6, 120)
    # Every board is cut from another place of the wood.
    rows = (np.arange(TILE_PX)[:, None] + (shift * TILE_PX).astype(np.intp)) % TILE_PX
    grain = grain[rows, np.arange(TILE_PX)[None, :]]
    seam = np.maximum(_seam(beside * tile / boards, 0.006, tile), _seam(end * tile, 0.006, tile))
    return tone * (1 + 0.08 * contrast * grain) * (1 - 0.6 * contrast * seam), tile


def _tiles(size_m: float, contrast: float, rng: np.random.Generator) -> Texture:
    """Square tiles of size_m, four by four, with grout between."""
    count = 4
    tile = count * size_m
    across, up = _grid()
    row, above = _cells(up, count)
    column, beside = _cells(across, count)
    tone = rng.normal(1.0, 0.06 * contrast, size=(count, count)).astype(np.float32)[row, column]
    grout = np.maximum(_seam(above * size_m, 0.008, tile), _seam(beside * size_m, 0.008, tile))
    marble = 0.03 * contrast * (_noise(rng, 20, 20) + 0.5 * _noise(rng, 4, 4))
    return (tone + marble) * (1 - 0.5 * contrast * grout), tile


def _picture(size_m: float, contrast: float, rng: np.random.Generator) -> Texture:
    """A landscape of soft hills and a few bright blocks, one picture in size_m; no two materials show the same."""
    _, up = _grid()
    sky = np.array([0.75, 0.85, 1.0], dtype=np.float32)
    picture = np.broadcast_to(sky, (TILE_PX, TILE_PX, 3)).copy()
    for k in range(4):
        horizon = 0.7 - 0.17 * k + 0.06 * _noise(rng, 50, 400)[:1]
        picture[up < horizon] = rng.uniform(0.15, 0.8, size=3)
    for _ in range(6):
        left, below = rng.integers(40, TILE_PX - 120, size=2)
        wide, high = rng.integers(30, 110, size=2)
        picture[below : below + high, left : left + wide] = rng.uniform(0.1, 1.0, size=3)
    picture = 1 + contrast * (picture - 1)
    picture[:20] = picture[-20:] = picture[:, :20] = picture[:, -20:] = 0.12
    return np.asarray(picture, dtype=np.float32), size_m


def _marker(number: int, size_m: float, _contrast: float, _rng: np.random.Generator) -> Texture:
    """An AprilTag of 8 × 8 cells on paper that is a cell wider on each side."""
    dictionary = cv2.aruco.getPredefinedDictionary(DICTIONARIES["tag36h11"])
    tag = cv2.copyMakeBorder(
        cv2.aruco.generateImageMarker(dictionary, number, 8), 1, 1, 1, 1, cv2.BORDER_CONSTANT, value=255
    )
    fine = cv2.resize(tag, (TILE_PX, TILE_PX), interpolation=cv2.INTER_NEAREST)
    return (0.08 + 0.92 * fine / 255.0).astype(np.float32), size_m


_TEXTURES: dict[str, tuple[Callable[..., Texture], float]] = {
    "plain": (_plain, 2.0),
    "plaster": (_plaster, 1.5),
    "carpet": (_carpet, 1.0),
    "wallpaper": (_wallpaper, 0.2),
    "wood": (_wood, 0.6),
    "brick": (_brick, 0.22),
    "planks": (_planks, 0.14),
    "tiles": (_tiles, 0.4),
    "picture": (_picture, 0.8),
    "marker": (_marker, 0.25),
}
"""Each texture with its size_m where a material states none."""


# -- light ------------------------------------------------------------------------------------------------------------

_CELL_M = 0.04
_SHADOW_M = 0.16  # how far a solid darkens the floor around it
_SHADOW = 0.75  # share of the light that it takes away right at its foot, from both sides together
_UNDERSIDE = 0.6
_MARGIN_M = 0.5
MOST_FLOOR_M2 = 20_000  # around all that is in the world


@dataclass(frozen=True, slots=True, eq=False)
class Lighting:
    """Light of one world. floor: (H, W) brightness of cells of the floor, origin: (2,) x, z of its first cell."""

    light: Light
    floor: NDArray[np.float32]
    origin: Array

    def of_floor(self, x: NDArray[np.float32], z: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return the brightness of floor points (S,)."""
        x_cell, z_cell = (
            np.float32(1 / _CELL_M) * (value - np.float32(o)) for value, o in zip((x, z), self.origin, strict=True)
        )
        return look_up(self.floor, x_cell, z_cell)

    def of_faces(self, points: Array, normals: Array) -> Array:
        """Return the brightness of upright faces at points (S, 2) with outward normals (S, 2)."""
        towards = normals @ geometry.forward(np.deg2rad(self.light.from_deg))
        return _lamps(self.light, points) * (1.0 + self.light.directional * towards)

    def of_tops(self, points: Array, is_underside: NDArray[np.bool_]) -> Array:
        """Return the brightness of tops and undersides at points (S, 2)."""
        return _lamps(self.light, points) * np.where(is_underside, _UNDERSIDE, 1.1)


def lighting_of(light: Light, solids: Solids, path: Array) -> Lighting:
    """Return the light of a world of solids; path: (T, 2) points that the floor must reach as well.

    Raises InputError for a floor that is too large to be drawn.
    """
    points = np.concatenate([solids.corners.reshape(-1, 2), path])
    origin = points.min(axis=0) - _MARGIN_M
    extent = points.max(axis=0) + _MARGIN_M - origin
    if extent.prod() > MOST_FLOOR_M2:
        problem = (
            f"expected a floor of at most {MOST_FLOOR_M2} m² to be drawn, found {extent[0]:.0f} m × {extent[1]:.0f} m"
        )
        raise InputError(problem, field="walls")
    width, height = np.ceil(extent / _CELL_M).astype(int) + 1
    covered = np.zeros((height, width), dtype=np.float32)
    for corners in solids.corners[(solids.bottom_m < 0.3) & ~solids.is_flat]:
        fine = np.round((corners - origin) / _CELL_M * 16).astype(np.int32)
        cv2.fillConvexPoly(covered, fine, 1.0, cv2.LINE_AA, shift=4)
    shadow = cv2.GaussianBlur(covered, (0, 0), _SHADOW_M / _CELL_M)
    x, z = np.meshgrid(np.arange(width) * _CELL_M + origin[0], np.arange(height) * _CELL_M + origin[1])
    lamps = _lamps(light, np.stack([x, z], axis=-1))
    return Lighting(light, (lamps * (1 - _SHADOW * shadow)).astype(np.float32), origin)


def _lamps(light: Light, points: Array) -> Array:
    """Return ambient light plus that of lamps, which falls off with the square of the distance, at points (..., 2)."""
    bright = np.full(points.shape[:-1], light.ambient)
    for lamp in light.lamps:
        distance_squared = ((points - [lamp.x, lamp.z]) ** 2).sum(axis=-1)
        bright += lamp.strength / (1 + distance_squared / lamp.height_m**2)
    return bright
