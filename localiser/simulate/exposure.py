"""Automatic exposure: exposure time and gain follow how bright the images are, with a delay.

The camera compares the mean of each image, as it stores it, with the one it is to reach, and corrects its exposure by
their ratio within a time constant. So images are too bright for a while when the robot comes out of a dark room, and
too dark after it has looked at a window.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from localiser.camera import Camera
from localiser.geometry import Array, Trajectory
from localiser.simulate.render import Exposure, Scene, radiance

_METERED_PX = 40
"""Width of the image that tells how bright a scene is."""
_LEAST, _MOST = 1 / 64, 64.0
"""Limits of the amount of light, over that of the world file's exposure and gain."""


@dataclass(frozen=True, eq=False)
class Exposures:
    """How each image of a drive is exposed. truth: where the robot is. image_t_ns: (I,)."""

    scene: Scene
    truth: Trajectory
    image_t_ns: NDArray[np.int64]

    def of(self, index: int) -> Exposure:
        """Return how an image is exposed: longer while that is allowed, then with more gain."""
        spec = self.scene.world.image
        if spec.auto_exposure is None:
            return Exposure(spec.exposure_s)
        amount = float(self._amounts[index])
        exposure_s = min(spec.exposure_s * amount, spec.longest_exposure_s)
        return Exposure(exposure_s, amount, max(spec.exposure_s * amount / exposure_s, 1.0))

    @cached_property
    def _amounts(self) -> Array:
        """How much light (I,) each image takes in, gain included, over what the world file states."""
        image = self.scene.world.image
        assert image.auto_exposure is not None
        metered = _metered(self.scene.camera)
        amounts, log_amount, last_ns = [], 0.0, None
        for t_ns in map(int, self.image_t_ns):
            mounted = self.scene.camera_at(t_ns).mount
            light = image.gain * radiance(self.scene, self.truth.at(t_ns), replace(metered, mount=mounted))
            if last_ns is None:
                log_amount = _settled(light, image.auto_exposure.mean_grey)
            amounts.append(np.exp(log_amount))
            elapsed_s = 0.0 if last_ns is None else (t_ns - last_ns) / 1e9
            follow = 1.0 - np.exp(-elapsed_s / image.auto_exposure.delay_s)
            log_amount += follow * _lacking(light, log_amount, image.auto_exposure.mean_grey)
            log_amount, last_ns = float(np.clip(log_amount, np.log(_LEAST), np.log(_MOST))), t_ns
        return np.array(amounts)


def _lacking(light: NDArray[np.float32], log_amount: float, mean_grey: float) -> float:
    """Return the logarithm of how much more light an image should have taken in; what is clipped tells no more."""
    stored = np.clip(light * np.exp(log_amount), 0.0, 255.0)
    return float(np.log(mean_grey / max(float(stored.mean()), 1.0)))


def _settled(light: NDArray[np.float32], mean_grey: float) -> float:
    """Return the logarithm of the amount of light with which a view that stays has the mean that it is to have."""
    log_amount = 0.0
    for _ in range(20):
        log_amount += _lacking(light, log_amount, mean_grey)
    return float(np.clip(log_amount, np.log(_LEAST), np.log(_MOST)))


def _metered(camera: Camera) -> Camera:
    """Return a camera that sees the same in few pixels."""
    step = max(camera.width // _METERED_PX, 1)
    return replace(
        camera,
        width=camera.width // step,
        height=camera.height // step,
        fx=camera.fx / step,
        fy=camera.fy / step,
        cx=(camera.cx - (step - 1) / 2) / step,
        cy=(camera.cy - (step - 1) / 2) / step,
    )
