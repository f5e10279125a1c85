"""Tilt and roll of single photographs from their edges, against those of hand-labelled vertical lines."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from edge_scenes import Scene
from edge_score import undistorted

from localiser.camera import Camera
from localiser.edges import EdgeParameters, find_edges
from localiser.edges.mount import fit_mount, mount_error_of_edges, nadir_miss
from localiser.edges.segments import Segments
from localiser.geometry import Array

STATED_SIGMA_DEG = np.array([3.0, 2.0])
LABEL_SIGMA_PX = 0.7
_ROUNDS = 5
_PLUMB_RAD = np.deg2rad(EdgeParameters().plumb_sigma_deg)


@dataclass(frozen=True, slots=True, eq=False)
class MountScore:
    """error_deg: (I, 2) of tilt and roll of each image. stated_deg: (I, 2) by how much what was stated is off."""

    error_deg: Array
    stated_deg: Array

    @classmethod
    def of(cls, scenes: Iterable[Scene], seed: int = 0) -> MountScore:
        """Return the errors when each image's stated tilt and roll are off by a draw from N(0, 3°) and N(0, 2°)."""
        rng = np.random.default_rng(seed)
        found, stated = [], []
        for scene in scenes:
            truth = _labelled(scene)
            off = np.deg2rad(rng.normal(0, STATED_SIGMA_DEG))
            found.append(np.rad2deg(_from_edges(scene, _moved(scene.camera, truth + off)) - _mount(scene.camera)))
            found[-1] -= np.rad2deg(truth)
            stated.append(np.rad2deg(off))
        return cls(np.array(found), np.array(stated))

    def text(self) -> str:
        """Return a line to print."""
        within = np.mean(np.all(np.abs(self.error_deg) < 1, axis=1))
        before = np.mean(np.all(np.abs(self.stated_deg) < 1, axis=1))
        tilt, roll = np.median(np.abs(self.error_deg), axis=0)
        return (
            f"Tilt and roll of single photographs: within 1° of the labels' in {within:.0%} of {len(self.error_deg)} "
            f"images ({before:.0%} as stated); median error {tilt:.2f}° tilt, {roll:.2f}° roll"
        )


def _mount(camera: Camera) -> Array:
    return np.array([camera.mount.tilt_rad, camera.mount.roll_rad])


def _moved(camera: Camera, by_rad: Array) -> Camera:
    tilt, roll = _mount(camera) + by_rad
    return camera.with_mount(tilt_rad=float(tilt), roll_rad=float(roll))


def _labelled(scene: Scene) -> Array:
    """Return by how much tilt and roll (2,) of the labelled verticals differ from what is stated with the image."""
    lines = Segments.of_ends(undistorted(scene.truth_px, scene.camera), LABEL_SIGMA_PX)
    off = np.zeros(2)
    for _ in range(3):
        camera = _moved(scene.camera, off)
        off = off + fit_mount(nadir_miss(lines, camera, _PLUMB_RAD), np.deg2rad([5.0, 5.0])).mean
    return off


def _from_edges(scene: Scene, camera: Camera) -> Array:
    """Return tilt and roll (2,) from the edges of the image, in rounds, each from what the last one told.

    Where thresholds decide, a little tilt makes other edges; the mean of all rounds but the first depends less on it.
    """
    sigma, told = STATED_SIGMA_DEG, []
    parameters = EdgeParameters(tilt_sigma_deg=float(sigma[0]), roll_sigma_deg=float(sigma[1]))
    for _ in range(_ROUNDS):
        edges = find_edges(scene.image, camera, parameters)
        camera = _moved(camera, mount_error_of_edges(edges, camera, np.deg2rad(sigma), _PLUMB_RAD).mean)
        told.append(_mount(camera))
    return np.asarray(np.mean(told[1:], axis=0))
