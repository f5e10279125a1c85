"""What a detector did on the images of one kind against the truth, and tilt and roll of single photographs."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from edge_scenes import Scene

from localiser.camera import Camera
from localiser.edges import EdgeParameters, Edges, find_edges
from localiser.edges.mount import LENS_SIGMA, fit_mount, mount_error_of_edges, nadir_miss
from localiser.edges.types import Segments
from localiser.geometry import Array

NEAR_PX = 2.5
COVERED_SHARE = 0.5
STATED_SIGMA_DEG = np.array([3.0, 2.0])
LABEL_SIGMA_PX = 0.7
_ROUNDS = 5
_PLUMB_RAD = np.deg2rad(EdgeParameters().plumb_sigma_deg)


class Score:
    """Counts and errors of one detector on the images of one kind.

    Found is a true edge when what was reported lies within 2.5 px of it along at least half of its visible length;
    true is a reported edge when at least half of it lies within 2.5 px of any true one. Errors are those of found
    edges that are alone, against the reported edge that runs nearest.
    """

    def __init__(self) -> None:
        self.found = self.counted = self.true = self.reported = 0
        self.error_deg: list[float] = []
        self.normalised: list[float] = []
        self.lean_normalised: list[float] = []
        self.seconds: dict[int, list[float]] = {}

    def add(self, scene: Scene, edges: Edges) -> None:
        """Match the edges of one image to the truth."""
        truth, measured = undistorted(scene.truth_px, scene.camera), undistorted(edges.ends_px, scene.camera)
        far = distances(truth, measured)
        found = scene.counted & ((far <= NEAR_PX).any(axis=2).mean(axis=1) >= COVERED_SHARE * scene.share)
        self.found, self.counted = self.found + int(found.sum()), self.counted + int(scene.counted.sum())
        is_true = (distances(measured, truth) <= NEAR_PX).any(axis=2).mean(axis=1) >= COVERED_SHARE
        self.true, self.reported = self.true + int(is_true.sum()), self.reported + len(edges)
        bearing, lean = scene.camera.bearing_of_segments(scene.truth_px), scene.camera.lean_of_segments(scene.truth_px)
        for index in np.flatnonzero(found & scene.alone):
            match = int(np.argmin(np.minimum(far[index], 2 * NEAR_PX).mean(axis=0)))
            error = edges.bearing[match] - bearing[index]
            self.error_deg.append(float(np.rad2deg(error)))
            self.normalised.append(error / edges.bearing_sigma[match])
            self.lean_normalised.append((edges.lean[match] - lean[index]) / edges.lean_sigma[match])

    @property
    def recall(self) -> float:
        """The share of the edges that should be found that are found."""
        return self.found / max(self.counted, 1)

    @property
    def missed(self) -> int:
        """How many edges that should be found are not."""
        return self.counted - self.found

    @property
    def precision(self) -> float:
        """The share of the reported edges that are true."""
        return self.true / max(self.reported, 1)

    @property
    def median_error_deg(self) -> float:
        """The median size of the error of a bearing."""
        return float(np.median(np.abs(self.error_deg)))

    @property
    def bias_deg(self) -> float:
        """The median error of a bearing."""
        return float(np.median(self.error_deg))

    def milliseconds(self, threads: int) -> float:
        """Return the median time of an image."""
        return 1e3 * float(np.median(self.seconds[threads]))

    def time_over(self, other: Score, threads: int) -> float:
        """Return the median over images of this detector's time over another's on the same image."""
        return float(np.median(np.array(self.seconds[threads]) / other.seconds[threads]))


def undistorted(ends_px: Array, camera: Camera) -> Array:
    """Return segments (E, 2, 2) where lines are straight."""
    return camera.ideal.pixels_from_image(camera.image_from_pixels(ends_px))


def robust_std(values: list[float]) -> float:
    """Return 1.48 times the median distance from the median: what the bulk says, whatever the tails do."""
    return 1.4826 * float(np.median(np.abs(values - np.median(values)))) if values else float("nan")


def distances(ends_px: Array, others_px: Array) -> Array:
    """Return (A, 41, B) how far points along segments (A, 2, 2) are from segments (B, 2, 2)."""
    along = np.linspace(0, 1, 41)[None, :, None]
    points = ends_px[:, :1] * (1 - along) + ends_px[:, 1:] * along
    start, direction = others_px[:, 0], others_px[:, 1] - others_px[:, 0]
    relative = points[:, :, None] - start
    share = ((relative * direction).sum(axis=-1) / np.maximum((direction**2).sum(axis=-1), 1e-9)).clip(0, 1)
    return np.linalg.norm(relative - share[..., None] * direction, axis=-1)


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
        ends, prior = camera.image_from_pixels(edges.ends_px), np.deg2rad(sigma)
        told_by = mount_error_of_edges(edges, ends, camera, prior, _PLUMB_RAD, lens_sigma=LENS_SIGMA)
        camera = _moved(camera, told_by.mean)
        told.append(_mount(camera))
    return np.asarray(np.mean(told[1:], axis=0))
