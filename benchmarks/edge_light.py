"""Images taken anew in other light: darker or brighter, noisier, or blurred, one change at a time.

An edge is expected to be found where a filter matched to it could find it: its own profile within 3 px, averaged along
it, over the noise that is left of that average (`matched_snr`). Which edges those are depends on the change, what finds
them does not.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

import cv2
import numpy as np
from edge_scenes import COUNTED_LENGTH_PX, Difficulty, Scene, simulated

from localiser.geometry import Array

LEAST_SNR = 8.0
"""Edges with a matched signal-to-noise ratio of at least this should be found."""
_OFFSETS_PX = np.arange(-4.0, 4.25, 0.5)
_MATCHED = np.flatnonzero(np.isin(_OFFSETS_PX, np.arange(-3.0, 3.5)))
"""Which of the offsets are the whole pixels that the matched filter uses."""
_OWN_PEAK_PX = 1.0
"""An edge shows where its picture is steepest; where that is elsewhere, another edge hides it in its blur."""
_ROUNDING_SIGMA = 1 / np.sqrt(12.0)


@dataclass(frozen=True, slots=True)
class Light:
    """A change of an image: it is blurred (sigma, px), multiplied by `gain`, and noise (grey levels) is added."""

    gain: float = 1.0
    noise_sigma: float = 0.0
    blur_px: float = 0.0

    def of(self, image: Array) -> Array:
        """Return the changed image (H, W) without the noise that is added, as grey levels that may be fractions."""
        grey = image.astype(np.float64)
        if self.blur_px:
            grey = cv2.GaussianBlur(grey, (0, 0), self.blur_px)
        return np.clip(self.gain * grey, 0, 255)

    def taken(self, image: Array, rng: np.random.Generator) -> Array:
        """Return the changed image with noise, in 8 bits."""
        grey = self.of(image)
        return np.clip(np.rint(grey + rng.normal(0, max(self.noise_sigma, 1e-9), grey.shape)), 0, 255).astype(np.uint8)


LIGHTS = {
    "plain": Light(),
    **{f"gain {gain}": Light(gain=gain) for gain in (0.15, 0.3, 0.6, 1.5, 2.5)},
    **{f"noise {noise}": Light(noise_sigma=float(noise)) for noise in (5, 10, 20)},
    **{f"blur {blur} px": Light(blur_px=float(blur)) for blur in (1, 2, 3)},
}


def photographed(scenes: Iterable[Scene], light: Light, seed: int = 0) -> Iterator[Scene]:
    """Yield scenes whose images are taken anew; counted are edges of at least 60 px that a matched filter finds."""
    for index, scene in enumerate(scenes):
        image = scene.image if scene.image.ndim == 2 else cv2.cvtColor(scene.image, cv2.COLOR_BGR2GRAY)
        own = noise_of(image) * light.gain * _kept_noise(light.blur_px)
        yield _scene(scene, light.of(image), light.taken(image, np.random.default_rng([seed, index])), light, own)


def rendered_anew(difficulty: Difficulty, light: Light, count: int, seed: int = 0) -> Iterator[Scene]:
    """Yield simulated scenes in another light: drawn so, not changed afterwards; the camera's noise stays as it is."""
    blur_px = float(np.hypot(difficulty.blur_px, light.blur_px))
    noise = float(np.hypot(difficulty.noise_sigma, light.noise_sigma))
    changed = replace(difficulty, gain=difficulty.gain * light.gain, blur_px=blur_px, noise_sigma=noise)
    quiet = replace(changed, noise_sigma=0.0)
    kinds = (simulated(each, count, seed) for each in (difficulty, quiet, changed))
    for scene, clean, taken in zip(*kinds, strict=True):
        yield _scene(scene, clean.image, taken.image, replace(light, noise_sigma=noise), 0.0)


def _scene(scene: Scene, clean: Array, taken: Array, light: Light, own_noise: float) -> Scene:
    noise = float(np.sqrt(own_noise**2 + light.noise_sigma**2 + _ROUNDING_SIGMA**2))
    visible_px = np.linalg.norm(scene.truth_px[:, 1] - scene.truth_px[:, 0], axis=1) * scene.share
    profile = profiles_of(clean, scene.truth_px)
    counted = (visible_px >= COUNTED_LENGTH_PX) & (matched_snr(profile, visible_px, noise) >= LEAST_SNR)
    return replace(scene, image=taken, counted=counted & has_own_peak(profile))


def profiles_of(image: Array, ends_px: Array) -> Array:
    """Return the median grey values (T, P) across edges (T, 2, 2), at P places from left to right."""
    if len(ends_px) == 0:
        return np.zeros((0, len(_OFFSETS_PX)))
    along = np.linspace(0.02, 0.98, 60)[None, :, None]
    points = ends_px[:, :1] * (1 - along) + ends_px[:, 1:] * along
    up = ends_px[:, 1] - ends_px[:, 0]
    across = np.stack([-up[:, 1], up[:, 0]], axis=-1) / np.maximum(np.linalg.norm(up, axis=1), 1e-9)[:, None]
    at = points[:, :, None] + across[:, None, None] * _OFFSETS_PX[:, None]
    u, v = np.moveaxis(at.reshape(len(ends_px), -1, 2).astype(np.float32), -1, 0)
    grey = cv2.remap(image.astype(np.float32), u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(np.median(grey.reshape(*at.shape[:3]), axis=1))


def matched_snr(profile: Array, visible_px: Array, noise: float) -> Array:
    """Return (T,) the signal-to-noise ratio of edges with profiles (T, P), for a filter matched to each.

    √(L Σ p²) / noise: L px are visible, p is the odd part of the profile within 3 px.
    """
    odd = (profile - profile[:, ::-1])[:, _MATCHED] / 2
    return np.asarray(np.sqrt(visible_px * (odd**2).sum(axis=1)) / noise)


def has_own_peak(profile: Array) -> Array:
    """Return (T,) whether profiles (T, P) are steepest, of all places nearby, within a pixel of the edge itself."""
    steepness = profile[:, 2:] - profile[:, :-2]
    middle = steepness.shape[1] // 2
    sign = np.sign((steepness[:, middle - 1 : middle + 2]).sum(axis=1, keepdims=True))
    rising = sign * steepness
    inner = rising[:, 1:-1]
    peak = (inner > 0) & (inner >= rising[:, :-2]) & (inner >= rising[:, 2:])
    near = np.abs(_OFFSETS_PX[2:-2]) <= _OWN_PEAK_PX
    return np.asarray((peak & near).any(axis=1))


def noise_of(image: Array) -> float:
    """Return the sigma of an image's (H, W) own noise: of the quarter of its patches that vary least."""
    grey = image.astype(np.float64)
    detail = cv2.filter2D(grey, -1, np.array([[1.0, -2, 1], [-2, 4, -2], [1, -2, 1]]) / 6)
    power = cv2.blur(detail**2, (15, 15))[8:-8:8, 8:-8:8]
    return float(np.sqrt(np.quantile(power, 0.25)))


def _kept_noise(blur_px: float) -> float:
    """Return the fraction of white noise's sigma that a blur leaves."""
    if blur_px == 0:
        return 1.0
    kernel = cv2.getGaussianKernel(2 * int(np.ceil(4 * blur_px)) + 1, blur_px)
    return float((kernel**2).sum())
