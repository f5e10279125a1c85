"""Image → vertical edges."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np

from localiser.camera import Camera, Mount
from localiser.edges.measure import edges_of_segments
from localiser.edges.parameters import EdgeParameters
from localiser.edges.profile import polarity_of_profiles, profiles
from localiser.edges.search import columns
from localiser.edges.segments import Detector, hough, lsd
from localiser.edges.types import Edges
from localiser.edges.undistort import Image, ideal_camera
from localiser.edges.vertical import same_edge, vertical_segments
from localiser.edges.verticality import vertical_probability
from localiser.errors import InputError

DETECTORS: dict[str, Detector] = {"lsd": lsd, "hough": hough, "columns": columns}


def find_edges(image: Image, camera: Camera, parameters: EdgeParameters) -> Edges:
    """Return the vertical edges of an image: find segments, keep what meets the nadir point, join what is one edge.

    image: (H, W) grey or (H, W, 3) BGR, uint8, of the size that the camera says. Raises InputError otherwise.
    """
    grey = grey_image(image, camera)
    mount_sigma_rad = np.deg2rad([parameters.tilt_sigma_deg, parameters.roll_sigma_deg])
    segments = DETECTORS[parameters.detector](grey, camera, parameters)
    plumb_sigma_rad = float(np.deg2rad(parameters.plumb_sigma_deg))
    vertical, mount = vertical_segments(segments, camera, mount_sigma_rad, plumb_sigma_rad, parameters.gate_sigma)
    kept = segments.take(vertical)
    if not kept.polarity.all():
        kept = replace(kept, polarity=polarity_of_profiles(profiles(kept.ends_px, grey, camera)))
    edge = same_edge(kept, camera, mount, parameters.gate_sigma)
    edges = edges_of_segments(kept, edge, grey, camera, mount_sigma_rad)
    edges = edges.take(edges.length_px >= parameters.min_length_px)
    others = segments.take(~vertical)
    rejected = ideal_camera(camera).image_from_pixels(others.ends_px)
    return replace(
        edges,
        vertical_probability=vertical_probability(edges, others, camera, mount_sigma_rad, plumb_sigma_rad),
        rejected_px=camera.pixels_from_image(rejected),
    )


def warm_up(camera: Camera, parameters: EdgeParameters) -> None:
    """Compile all loops and make the tables of a camera, so that no image has to wait for it.

    Loops are compiled by finding one edge that has a foot, tables made by finding none.
    """
    plain = Camera(320, 240, 300.0, 300.0, 159.5, 119.5, Mount(tilt_rad=0.35, height_m=1.0))
    pillar = np.full((plain.height, plain.width), 50, dtype=np.uint8)
    pillar[40:200, plain.width // 2 :] = 200
    find_edges(pillar, plain, parameters)
    find_edges(np.zeros((camera.height, camera.width), dtype=np.uint8), camera, parameters)


def grey_image(image: Image, camera: Camera) -> Image:
    """Return the grey image (H, W) of a grey or BGR one. Raises InputError when type or size is not as expected."""
    size, expected = image.shape[:2], (camera.height, camera.width)
    is_grey, is_colour = image.ndim == 2, image.ndim == 3 and image.shape[2] == 3
    if image.dtype != np.uint8 or not (is_grey or is_colour):
        raise InputError(f"expected 8-bit grey or BGR, found {image.dtype} {image.shape}", field="image")
    if size != expected:
        found = f"{size[1]}×{size[0]}"
        raise InputError(f"expected {camera.width}×{camera.height} as the camera says, found {found}", field="image")
    # Compiled loops are compiled anew for every kind of array.
    grey = image if is_grey else cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
    return np.require(grey, dtype=np.uint8, requirements=["C", "W"])
