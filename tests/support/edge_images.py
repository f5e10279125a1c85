"""Images of a plain wall with vertical stripes, drawn through a `Camera` with tilt, roll and lens distortion."""

from functools import lru_cache

import cv2
import numpy as np

from localiser.camera import Camera, Mount

SUPERSAMPLING = 5


@lru_cache
def camera_of(width=640, height=480, *, tilt_deg=20.0, roll_deg=0.0, k1=0.0, focal_px=None) -> Camera:
    focal = 554.0 * width / 640 if focal_px is None else focal_px
    distortion = () if k1 == 0 else (k1, 0.0, 0.0, 0.0, 0.0)
    mount = Mount(np.deg2rad(tilt_deg), 0.8, np.deg2rad(roll_deg))
    model = "plumb_bob" if distortion else "none"
    centre = ((width - 1) / 2, (height - 1) / 2)
    return Camera(width, height, focal, focal, *centre, mount, model, distortion)


@lru_cache(maxsize=4)
def supersampled_directions(camera: Camera) -> tuple[np.ndarray, np.ndarray]:
    """Return (right, up) over ahead, (H k, W k) each, of the rays through a k times finer grid of pixels.

    The grid is smooth, so it is computed once per pixel, one pixel beyond the image, and interpolated.
    """
    k = SUPERSAMPLING
    pixels = np.stack(np.meshgrid(np.arange(-1.0, camera.width + 1), np.arange(-1.0, camera.height + 1)), axis=-1)
    rays = camera.level_rays(pixels)
    fine = cv2.resize(rays[..., :2] / -rays[..., 2:], None, fx=k, fy=k, interpolation=cv2.INTER_LINEAR)[k:-k, k:-k]
    return fine[..., 0], fine[..., 1]


def wall_image(
    camera: Camera, bearings_deg, greys, *, wall_ahead_m=None, floor_grey=90.0, noise_sigma=0.0, seed=0
) -> np.ndarray:
    """Return the (H, W) uint8 image of a wall straight ahead, whose grey changes at the given bearings.

    bearings_deg: (E,) ascending. greys: (E + 1,) from left to right. wall_ahead_m: where it stands on a floor of
    `floor_grey`; None: it has no foot. The same image is drawn once and copied.
    """
    return _drawn(camera, tuple(bearings_deg), tuple(greys), wall_ahead_m, floor_grey, noise_sigma, seed).copy()


@lru_cache(maxsize=64)
def _drawn(camera, bearings_deg, greys, wall_ahead_m, floor_grey, noise_sigma, seed) -> np.ndarray:
    k = SUPERSAMPLING
    tangent, elevation = supersampled_directions(camera)
    fine = np.asarray(greys, dtype=np.float64)[np.searchsorted(np.tan(np.deg2rad(bearings_deg)), tangent)]
    if wall_ahead_m is not None:
        fine[elevation < -camera.mount.height_m / wall_ahead_m] = floor_grey
    image = fine.reshape(camera.height, k, camera.width, k).mean(axis=(1, 3))
    image += np.random.default_rng(seed).normal(0.0, noise_sigma, image.shape)
    return np.clip(np.rint(image), 0, 255).astype(np.uint8)
