"""The foot of an edge: where it meets the floor, and how likely its lower end stands on the floor.

A lower end determines a range only if it stands on the floor. If it is above the floor (a window, a pane over its
rail, a thing on a table) or hidden by something in front, it appears to be farther away. One image cannot decide this,
but it has three hints:

- At a foot, the border between wall and floor meets the edge, and below it there is only floor, down to the border of
  the image. If the end is above the floor, the foot of the wall is below it. If it is hidden, the foot of the thing in
  front is below it. Either is a stronger change of grey than that at the end itself.
- Rooms are some metres wide. An end near the height of the camera appears to be far away.
- A camera sees the tops of what is lower than itself, and what stands on them. One near the floor sees none of that.

From these the probability that the end stands on the floor is computed. docs/notes/edges.md says how often it is right.
"""

from __future__ import annotations

import numpy as np

from localiser import geometry
from localiser.camera import Camera
from localiser.edges.undistort import Image
from localiser.geometry import Array

FOOT_SIGMA_PX = 2.0
"""Error of an edge's lower end along the edge: where a line stops is far less certain than where it runs."""
BORDER_PX = 4.0 * FOOT_SIGMA_PX
"""An edge that is found to end this close to the image border may as well be cut off by it."""

_PLACES_PX = np.arange(8.0, -42.0, -2.0)
"""Places around the end, upwards along the edge, between which grey values change."""
_END, _NEAR = (0, 9), (6, len(_PLACES_PX))
"""First and last place of the changes at the end (within 5 px), and of those below it."""
_STEPS_DOWN = 120
"""In how many steps the height of the image is searched for what lies before the foot."""
_SIDES_PX = np.array([-8.0, -5.5, -3.0, 3.0, 5.5, 8.0])
"""Three samples on either side of the line."""
_NODES = 13
_LEAST_DEPTH = 0.05
_FAINT_GREY = 4.0
"""Steps that are smaller than this are as good as none."""
_TYPICAL_RANGE_M = 4.0
_TYPICAL_HEIGHT_M = 0.75
LOG_ODDS = {"always": 3.5, "height": -1.0, "range": -0.7, "junction": -0.7, "near": -2.4, "far": -1.5}
"""Logistic regression on furnished rooms, two worlds and a rendered house: docs/notes/edges.md."""
_MOST_PROBABLE = 0.85
"""What was said to be likelier than this was not found to be, in buildings that the regression had not seen."""


def foot_of_edges(bottom_px: Array, camera: Camera, taken_px: Array | None = None) -> tuple[Array, Array]:
    """Return the floor range (E,) m of feet seen at pixels (E, 2), and its sigma; nan where no foot is seen.

    A foot is where an edge ends inside the image and below the horizon. Design equation 9. taken_px: (E, 2) where the
    image shows them, if a rolling shutter took them elsewhere.
    """
    size, taken_px = np.array([camera.width, camera.height]), bottom_px if taken_px is None else taken_px
    inside = np.all((taken_px >= BORDER_PX) & (taken_px <= size - 1 - BORDER_PX), axis=1)
    rays = camera.level_rays(bottom_px)
    depression = np.arctan2(-rays[:, 1], np.hypot(rays[:, 0], rays[:, 2]))
    sigma_rad = FOOT_SIGMA_PX / camera.focal_px
    seen = inside & (depression > sigma_rad)
    range_m = geometry.floor_range(camera.mount.height_m, np.where(seen, depression, np.nan))
    return range_m, geometry.floor_range_sigma(camera.mount.height_m, range_m, sigma_rad)


def foot_probability(bottom_px: Array, range_m: Array, image: Image, camera: Camera) -> Array:
    """Return how likely (E,) it is that lower ends at pixels (E, 2) stand on the floor, within `FOOT_SIGMA_PX`.

    range_m: (E,) where they would stand, nan where no foot is seen; 0 is returned there. image: (H, W) as taken.
    """
    seen = np.isfinite(range_m)
    probability = np.zeros(len(range_m))
    if seen.any():
        evidence = foot_evidence(bottom_px[seen], range_m[seen], image, camera)
        likely = 1 / (1 + np.exp(-sum(LOG_ODDS[name] * value for name, value in evidence.items())))
        probability[seen] = np.minimum(likely, _MOST_PROBABLE)
    return probability


def foot_evidence(bottom_px: Array, range_m: Array, image: Image, camera: Camera) -> dict[str, Array]:
    """Return what speaks for and against feet (E,) at pixels (E, 2), by name; range_m: (E,), all finite."""
    far_step = camera.height / _STEPS_DOWN
    far_px = np.arange(_PLACES_PX[-1], -float(camera.height), -far_step)
    grey = _sides(bottom_px, np.concatenate([_PLACES_PX, far_px]), image, camera)
    at_end, below = (_change(grey[:, slice(*between)]) for between in (_END, _NEAR))
    far = _change(grey[:, len(_PLACES_PX) :])
    junction = at_end.min(axis=1)
    return {
        "always": np.ones(len(range_m)),
        "height": np.full(len(range_m), np.log(camera.mount.height_m / _TYPICAL_HEIGHT_M)),
        "range": np.log(range_m / _TYPICAL_RANGE_M) ** 2,
        "junction": junction,
        "near": np.maximum(below.max(axis=1) - at_end.max(axis=1), 0),
        "far": np.maximum(far.max(axis=1) - junction, 0),
    }


def _change(grey: Array) -> Array:
    """Return by how much grey values (E, S, 2) change at most between two places and the next two: (E, 2).

    As a logarithm, so that differences do not depend on exposure or light.
    """
    pairs = grey[:, :-1] + grey[:, 1:]
    steps = np.abs(pairs[:, :-2] - pairs[:, 2:]) / 2
    return np.asarray(np.log(_FAINT_GREY + np.nan_to_num(steps).max(axis=1, initial=0.0)))


def _sides(bottom_px: Array, along_px: Array, image: Image, camera: Camera) -> Array:
    """Return grey values (E, S, 2) left and right of edges that end at pixels (E, 2), `along_px` (S,) above the end.

    Along the line to the nadir point, taken as straight between few nodes, which no lens bends much; nan from where it
    leaves the image.
    """
    from scipy.ndimage import map_coordinates

    nodes_px = np.linspace(along_px[0], along_px[-1], _NODES)
    a, e = camera.upright_from_pixels(bottom_px).T[:, :, None]
    heights = e + nodes_px / camera.focal_px
    depth = _depth(heights, camera) / _depth(e, camera)
    nodes = camera.pixels_from_upright(np.stack([a * depth, heights], axis=-1))
    place = (along_px - nodes_px[0]) / (nodes_px[1] - nodes_px[0])
    before = np.minimum(place.astype(np.int64), _NODES - 2)
    share = (place - before)[:, None]
    u, v = np.moveaxis(nodes[:, before] * (1 - share) + nodes[:, before + 1] * share, -1, 0)
    reach = np.abs(_SIDES_PX).max()
    outside = ~((u >= reach) & (u <= camera.width - 1 - reach) & (v >= 0) & (v <= camera.height - 1))
    # Where a line has left the image, a lens model may bend it back inside.
    outside |= np.logical_or.accumulate(outside & (along_px <= 0), axis=1)
    beside = u[..., None] + _SIDES_PX
    rows = np.broadcast_to(v[..., None], beside.shape)
    grey = map_coordinates(image.astype(np.float64), [np.nan_to_num(rows), np.nan_to_num(beside)], order=1)
    grey[outside] = np.nan
    return np.asarray(grey.reshape(*u.shape, 2, -1).mean(axis=-1))


def _depth(e: Array, camera: Camera) -> Array:
    tilt = camera.mount.tilt_rad
    return np.asarray(np.maximum(np.cos(tilt) + e * np.sin(tilt), _LEAST_DEPTH))
