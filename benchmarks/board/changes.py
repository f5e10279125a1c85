"""What goes wrong with a drive or its map: wheels err, the robot is carried, the map is worn or of another building."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from board.run import CORRECT_RAD, Drive
from localiser import Trajectory, compose, wrap_angle
from localiser.geometry import Array, between
from localiser.landmarks import LandmarkMap

FAULT_S = 3.0
STEP_NS = 200_000_000
BEFORE_S, AFTER_S = 10.0, 16.0
WORN, MOVED_M = 0.3, 0.3  # share of the landmarks, and how far

# -- wheels ------------------------------------------------------------------------------------------------------------


def wheels_wrong(drive: Drive, fault: str, begin_s: float) -> Drive:
    """Return a drive whose wheels err for 3 s: `frozen`, `twice` as fast, `missing`; or they are `restarted` at 0."""
    wheels, begin_ns = drive.odometry, int(drive.t_ns[0] + 1e9 * begin_s)
    bad = (wheels.t_ns >= begin_ns) & (wheels.t_ns < begin_ns + int(1e9 * FAULT_S))
    if fault == "missing":
        return replace(drive, odometry=Trajectory(wheels.t_ns[~bad], wheels.poses[~bad]))
    if fault == "restarted":
        later = int(np.argmax(bad))
        poses = np.concatenate([wheels.poses[:later], between(wheels.poses[later], wheels.poses[later:])])
        return replace(drive, odometry=Trajectory(wheels.t_ns, poses))
    factor = {"frozen": 0.0, "twice": 2.0}[fault]
    poses = [wheels.poses[0]]
    for k in range(1, len(bad)):
        step = between(wheels.poses[k - 1], wheels.poses[k])
        poses.append(compose(poses[-1], factor * step if bad[k] else step))
    return replace(drive, odometry=Trajectory(wheels.t_ns, np.array(poses)))


def part_about(drive: Drive, begin_s: float) -> Drive:
    """Return the images from 10 s before to 16 s after a time; the time is then 10 s after the first image."""
    seconds = (drive.t_ns - drive.t_ns[0]) / 1e9
    kept = np.flatnonzero((seconds >= begin_s - BEFORE_S) & (seconds < begin_s + AFTER_S))
    first_ns, last_ns = drive.t_ns[kept[[0, -1]]]
    wheels = (drive.odometry.t_ns > first_ns - STEP_NS) & (drive.odometry.t_ns < last_ns + STEP_NS)
    track = Trajectory(drive.odometry.t_ns[wheels], drive.odometry.poses[wheels])
    edges = [drive.edges[k] for k in kept]
    return replace(drive, t_ns=drive.t_ns[kept], edges=edges, truth=drive.truth[kept], odometry=track)


def late_images(drive: Drive, seconds: float) -> Drive:
    """Return a drive whose images have stamps that are too late, beside those of the wheels."""
    shift = int(1e9 * seconds)
    return replace(drive, odometry=Trajectory(drive.odometry.t_ns - shift, drive.odometry.poses))


# -- carried -----------------------------------------------------------------------------------------------------------


def carried(drive: Drive, seed: int, *, before: int = 60, after: int = 150, far_m: float = 2.0) -> Drive:
    """Return a drive of which the robot is carried to a place at least `far_m` away that it drives through too."""
    rng, count = np.random.default_rng([seed, 7]), len(drive.t_ns)
    after = min(after, count // 3)
    while True:
        first, then = int(rng.integers(0, count - before)), int(rng.integers(0, count - after))
        until = first + before - 1
        moved = between(drive.truth[until], drive.truth[then])
        if np.hypot(moved[0], moved[1]) >= far_m and abs(moved[2]) > 2 * CORRECT_RAD:
            break
    wheels = drive.odometry
    begin_ns, until_ns, then_ns = (int(drive.t_ns[k]) for k in (first, until, then))
    last_ns, shift = int(drive.t_ns[min(then + after, count) - 1]), until_ns + STEP_NS - then_ns
    early = (wheels.t_ns > begin_ns - STEP_NS) & (wheels.t_ns < until_ns)
    late = (wheels.t_ns > then_ns) & (wheels.t_ns <= last_ns + STEP_NS)
    here, there = (wheels.sampled([t]).poses[0] for t in (until_ns, then_ns))
    poses = [wheels.poses[early], [here, here], compose(here, between(there, wheels.poses[late]))]
    t_ns = np.concatenate([wheels.t_ns[early], [until_ns, until_ns + STEP_NS], wheels.t_ns[late] + shift])
    index = np.concatenate([np.arange(first, until + 1), np.arange(then, min(then + after, count))])
    is_late = np.arange(len(index)) >= before
    return replace(
        drive,
        odometry=Trajectory(t_ns, np.concatenate(poses)),
        t_ns=np.where(is_late, drive.t_ns[index] + shift, drive.t_ns[index]),
        edges=[drive.edges[k] for k in index],
        truth=drive.truth[index],
        carried=before,
    )


def elsewhere(drive: Drive, seed: int, far_m: float = 2.0) -> Array:
    """Return a pose (3,) of the drive at least `far_m` from its first one, turned at random: a start that is wrong."""
    rng = np.random.default_rng([seed, 8])
    distance = np.hypot(*(drive.truth[:, :2] - drive.truth[0, :2]).T)
    chosen = drive.truth[rng.choice(np.flatnonzero(distance >= far_m))]
    return np.array([*chosen[:2], wrap_angle(rng.uniform(-np.pi, np.pi))])


# -- maps --------------------------------------------------------------------------------------------------------------


def mirrored(landmark_map: LandmarkMap) -> LandmarkMap:
    """Return the map with left and right exchanged, about its middle; polarities with them."""
    middle = landmark_map.points[:, 0].mean()
    points = landmark_map.points * [-1.0, 1.0] + [2 * middle, 0.0]
    cov = landmark_map.cov * [[1.0, -1.0], [-1.0, 1.0]]
    return replace(landmark_map, points=points, cov=cov, polarity=-landmark_map.polarity, quality=None)


def removed(landmark_map: LandmarkMap, seed: int) -> LandmarkMap:
    """Return the map without 30 % of its landmarks."""
    rng = np.random.default_rng([seed, 12])
    kept = rng.permutation(len(landmark_map))[: round((1 - WORN) * len(landmark_map))]
    return landmark_map.take(np.sort(kept))


def moved(landmark_map: LandmarkMap, seed: int) -> LandmarkMap:
    """Return the map with 30 % of its landmarks 0.3 m from where they stand."""
    rng = np.random.default_rng([seed, 13])
    chosen = rng.permutation(len(landmark_map))[: round(WORN * len(landmark_map))]
    angle = rng.uniform(-np.pi, np.pi, len(chosen))
    points = landmark_map.points.copy()
    points[chosen] += MOVED_M * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    return replace(landmark_map, points=points)


def half_mapped(drive: Drive) -> Drive:
    """Return a drive on the map of the half where it begins, and 1 m more: across the median x of its way."""
    middle = float(np.median(drive.truth[:, 0]))
    side = 1.0 if drive.truth[0, 0] > middle else -1.0
    kept = np.flatnonzero(side * (drive.landmark_map.points[:, 0] - middle) > -1.0)
    return replace(drive, landmark_map=drive.landmark_map.take(kept))


def off(landmark_map: LandmarkMap, seed: int, sigma_m: float = 0.03) -> LandmarkMap:
    """Return the map with every landmark off by a draw of this sigma in x and z."""
    rng = np.random.default_rng([seed, 14])
    return replace(landmark_map, points=landmark_map.points + rng.normal(0.0, sigma_m, landmark_map.points.shape))
