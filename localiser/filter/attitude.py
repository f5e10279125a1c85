"""The attitude: tilt and roll of the camera, estimated by a Kalman filter of two states (docs/filter.md).

An error of the mount moves all edges of an image together, and those of the next image in the same way, so averaging
does not reduce it. As an error of each edge it would let an edge fit several landmarks. But a vertical edge points at
the nadir point, whatever the pose and the landmark [Taylor06]. What the edges of an image tell of that corrects them.
The uncertainty that remains is common to them.

Floors are uneven and a load shifts, so what was learnt is forgotten over 100 m. Half a degree of stated uncertainty
then allows 0.14° between places 4 m apart: 10 mm, which is what DIN 18202 allows a floor. A mount that is stated for
an image without a sigma was measured, and its edges are taken as they are, as those are that a map was made of. With a
sigma of its own, its error is another in each image.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from localiser import geometry
from localiser.camera import Camera
from localiser.edges import Edges, mount_error_of_edges
from localiser.geometry import Array
from localiser.observation import at_border

MEMORY_M = 100.0  # way after which what was learnt of tilt and roll is forgotten
MOUNT = ("tilt", "roll")
_OF_MOUNT = slice(len(MOUNT))  # those of the common errors of edges
_LEAST_SIGMA_RAD = np.deg2rad(0.1)  # of a prior that can be taken back


@dataclass(frozen=True, slots=True, eq=False)
class Attitude:
    """By how much tilt and roll differ from what is stated: mean (2,) rad and covariance (2, 2)."""

    mean: Array
    cov: Array

    def after(self, path_m: float, stated_cov: Array) -> Attitude:
        """Return what is known after a way: an Ornstein-Uhlenbeck process about the stated mount."""
        kept = float(np.exp(-path_m / MEMORY_M))
        return Attitude(kept * self.mean, kept**2 * self.cov + (1 - kept**2) * stated_cov)

    def given(self, edges: Edges, ends: Array, camera: Camera, plumb_sigma_rad: float, novelty: float) -> Attitude:
        """Return what is known after an image. novelty: how much of its evidence is new, 0 … 1.

        ends: (E, 2, 2) of the edges in image coordinates. camera: as it was mounted then. plumb_sigma_rad: how far real
        edges are from plumb.
        """
        prior_sigma = np.maximum(np.sqrt(np.diag(edges.common.cov)[_OF_MOUNT]), _LEAST_SIGMA_RAD)
        image = mount_error_of_edges(edges, ends, camera, prior_sigma, plumb_sigma_rad, lens_sigma=0.0)
        # What the image tells beside the prior, which counts once and not with every image.
        certain = np.linalg.inv(image.cov)
        information, pull = novelty * (certain - np.diag(prior_sigma**-2.0)), novelty * certain @ image.mean
        cov = self.cov @ np.linalg.inv(np.eye(2) + information @ self.cov)  # also right where nothing is uncertain
        cov = (cov + cov.T) / 2
        return Attitude(self.mean + cov @ (pull - information @ self.mean), cov)

    def levelled(self, edges: Edges, ends: Array, camera: Camera) -> Edges:
        """Return the edges as a camera mounted as stated would have measured them; what is common to them is `cov`.

        ends, camera: as for `given`.
        """
        common, lean = edges.common, edges.lean
        bearing = edges.bearing + common.bearing_from_line[:, _OF_MOUNT] @ self.mean
        if not geometry.is_level(camera.mount.tilt_rad):  # else a lean tells no bearing
            lean = lean + common.bearing_from_lean[:, _OF_MOUNT] @ self.mean / geometry.bearing_per_lean(
                edges.bearing, camera.mount.tilt_rad
            )
        cov = common.cov.copy()
        cov[_OF_MOUNT, _OF_MOUNT] = self.cov
        mount, (tilt, roll) = camera.mount, self.mean.tolist()
        turned = camera.with_mount(tilt_rad=mount.tilt_rad + tilt, roll_rad=mount.roll_rad + roll)
        rays = np.concatenate([ends, -np.ones_like(ends[..., :1])], axis=-1)
        moved_px = camera.project_level(rays @ turned.level_from_camera.T)
        is_cut = at_border(edges.ends_px, camera)[..., None]  # an end at the border is still there
        ends_px = np.where(is_cut | ~np.isfinite(moved_px), edges.ends_px, moved_px)
        return replace(edges, bearing=bearing, lean=lean, ends_px=ends_px, common=replace(common, cov=cov))


@dataclass(frozen=True, slots=True, eq=False)
class Level:
    """What edges tell of tilt and roll. plumb_sigma_rad: how far real edges are from plumb."""

    camera: Camera
    plumb_sigma_rad: float

    def levelled(
        self, attitude: Attitude | None, edges: Edges, path_m: float, novelty: float
    ) -> tuple[Edges, Attitude | None]:
        """Return the edges corrected by what they and those before tell of tilt and roll, and what that is.

        attitude: what was known at the last image. Edges of which it is not known what the mount does to them stay as
        they are.
        """
        if edges.common.names[_OF_MOUNT] != MOUNT or not np.isfinite(edges.ends_px).all():
            return edges, attitude
        stated_cov, camera = edges.common.cov[_OF_MOUNT, _OF_MOUNT], self.camera.at(edges.mount)
        sigma = camera.mount.sigma  # of what was measured for this image: its error tells nothing of the next one's
        if sigma is not None and not (sigma.tilt_rad is None and sigma.roll_rad is None):
            attitude, novelty = None, 1.0
        elif (camera.mount.tilt_rad, camera.mount.roll_rad) != (self.camera.mount.tilt_rad, self.camera.mount.roll_rad):
            return edges, attitude
        before = Attitude(np.zeros(2), stated_cov) if attitude is None else attitude.after(path_m, stated_cov)
        ends = camera.image_from_pixels(edges.ends_px)  # to undo a lens's distortion takes long
        now = before.given(edges, ends, camera, self.plumb_sigma_rad, novelty)
        return now.levelled(edges, ends, camera), now
