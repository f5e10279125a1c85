"""A whole simulated log: drive, odometry, images and map of one world, from one seed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from localiser.camera import Camera, Mount
from localiser.errors import InputError
from localiser.geometry import Array, wrap_angle
from localiser.landmarks import LandmarkMap
from localiser.simulate.drive import Drive, drive_of, stated_mount
from localiser.simulate.render import Scene, expose, scene_of
from localiser.simulate.solids import clearance_m
from localiser.simulate.structure import Visible, visible_landmarks
from localiser.simulate.world import World

FEWEST_SIGHTINGS = 5  # images that must show a landmark for it to be on the map of the log
ROBOT_RADIUS_M = 0.15
_DRIVE, _START, _IMAGES, _MOUNTS = range(4)  # independent streams of random numbers


@dataclass(frozen=True, slots=True, eq=False)
class SimulatedLog:
    """A log as it is recorded, with its truth.

    landmark_map: landmarks that at least five images show; their ids are their indices in the map of the whole world.
    start, start_cov: stated pose (3,) at the first image, off the truth by a draw from that covariance (3, 3).
    visible: for each image what it truly shows; its landmarks are ids. mounts: of the camera at each image as the robot
    states them, None where it does not move.
    """

    name: str
    camera: Camera
    drive: Drive
    landmark_map: LandmarkMap
    start: Array
    start_cov: Array
    visible: tuple[Visible, ...]
    mounts: tuple[Mount | None, ...]
    jpeg_quality: int
    seed: int
    scene: Scene

    def __len__(self) -> int:
        return len(self.drive.image_t_ns)

    def image(self, index: int) -> NDArray[np.uint8]:
        """Return one image, (H, W) grey or (H, W, 3) BGR; the same whenever it is asked for."""
        rng = np.random.default_rng([self.seed, _IMAGES, index])
        return expose(self.scene, self.drive.truth, int(self.drive.image_t_ns[index]), rng)


def simulated_log(world: World, seed: int) -> SimulatedLog:
    """Return the log of the world's drive; images are rendered when they are asked for.

    Raises InputError when the drive runs into something, or when the camera looks straight down.
    """
    try:
        scene = scene_of(world)
    except ValueError as error:
        raise InputError(str(error), field="camera.mount.tilt_deg") from None
    drive = drive_of(world, np.random.default_rng([seed, _DRIVE]))
    camera_pose, height_m = scene.camera.pose_in_map(drive.truth.poses), scene.camera.mount.height_m
    for points, radius, who in ((drive.truth.poses, ROBOT_RADIUS_M, "robot"), (camera_pose, 0.0, "camera")):
        distance = clearance_m(scene.structure.solids, points[:, :2], height_m)
        worst = int(distance.argmin())
        if distance[worst] < radius:
            x, z = points[worst, :2]
            raise InputError(
                f"expected the {who} at least {radius:.2f} m from everything, found {distance[worst]:.2f} m "
                f"at x = {x:.2f}, z = {z:.2f}, {drive.truth.t_ns[worst] / 1e9:.1f} s after the start",
                field="drive.path",
            )
    poses = drive.truth.sampled(drive.image_t_ns).poses
    times = [int(t_ns) for t_ns in drive.image_t_ns]
    visible = tuple(
        visible_landmarks(scene.structure, scene.camera_at(t_ns), pose) for t_ns, pose in zip(times, poses, strict=True)
    )
    start_cov = np.diag([world.start.sigma_m, world.start.sigma_m, np.deg2rad(world.start.sigma_deg)]) ** 2
    start = poses[0] + np.sqrt(np.diag(start_cov)) * np.random.default_rng([seed, _START]).standard_normal(3)
    start[2] = wrap_angle(start[2])
    motion, rng = world.camera.motion, np.random.default_rng([seed, _MOUNTS])
    mounts = [None if motion is None else stated_mount(scene.camera_at(t_ns).mount, motion, rng) for t_ns in times]
    return SimulatedLog(
        name=world.name,
        camera=scene.camera,
        drive=drive,
        landmark_map=_seen(scene.structure.landmark_map, visible),
        start=start,
        start_cov=start_cov,
        visible=visible,
        mounts=tuple(mounts),
        jpeg_quality=world.image.jpeg_quality,
        seed=seed,
        scene=scene,
    )


def _seen(everything: LandmarkMap, visible: tuple[Visible, ...]) -> LandmarkMap:
    count = np.zeros(len(everything), dtype=int)
    for shown in visible:
        count[shown.landmark] += 1
    kept = np.flatnonzero(count >= FEWEST_SIGHTINGS)
    return LandmarkMap.from_points(
        everything.points[kept],
        name=everything.name,
        ids=tuple(int(index) for index in kept),
        bottom_m=everything.bottom_m[kept],
        top_m=everything.top_m[kept],
        source="simulated",
    )
