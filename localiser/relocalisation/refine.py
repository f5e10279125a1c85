"""Refinement of poses: least squares on the edges that each pose explains, in windows that narrow."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from localiser.geometry import Array, robot_from_map, wrap_angle
from localiser.landmarks import bearing_jacobian, by_robot_pose, half_view_rad, image_heights, in_camera
from localiser.relocalisation.evidence import Evidence, evidence_of
from localiser.relocalisation.places import Places
from localiser.relocalisation.views import View

Indices = NDArray[np.int64]

# How far off bearings may be at each step (rad); feet follow at the same angle.
WINDOWS_RAD = np.radians([2.0, 1.0, 0.5, 0.25, 0.1])
AT_ONCE = 1000  # landmarks on a map; on a larger one only those around each pose are looked at
# What a hypothesis knows by itself, so that edges which leave a freedom leave it bounded.
LOOSE_SIGMA = np.array([0.3, 0.3, np.radians(10.0)])


def refined(view: View, places: Places, poses: Array) -> tuple[Array, Array]:
    """Return poses (K, 3) after Gauss-Newton on bearings and feet, and their covariances (K, 3, 3).

    The landmarks in view are those of the first pose; each belongs, at every step, to the edge that explains it best in
    a window that narrows, with the weight by which it does so better than clutter.
    """
    covs = np.tile(np.diag(LOOSE_SIGMA**2), (len(poses), 1, 1))
    if len(poses) == 0:
        return poses, covs
    pair = _in_reach(view, places, poses)
    for window in WINDOWS_RAD:
        information = np.tile(np.diag(LOOSE_SIGMA**-2.0), (len(poses), 1, 1))
        gradient = np.zeros((len(poses), 3))
        evidence = evidence_of(view, window)
        _add_normal_equations(evidence, places, poses, pair, window, information, gradient)
        covs = np.linalg.inv(information)
        poses = poses + np.einsum("kij,kj->ki", covs, gradient)
        poses[:, 2] = wrap_angle(poses[:, 2])
    return poses, covs


def _in_reach(view: View, places: Places, poses: Array) -> tuple[Indices, Indices]:
    """Return pairs (P,) of pose and landmark that can be in view, a little beyond its sides included."""
    cameras = view.camera.pose_in_map(poses)
    if len(places) <= AT_ONCE:
        return _in_reach_of(view, places, cameras, np.arange(len(places)))
    found = [
        _in_reach_of(view, places, cameras[k : k + 1], places.reach.beside(cameras[k : k + 1, :2]), k)
        for k in range(len(poses))
    ]
    pose, landmark = (np.concatenate(part) for part in zip(*found, strict=True))
    return pose, landmark


def _in_reach_of(view: View, places: Places, cameras: Array, near: Indices, first: int = 0) -> tuple[Indices, Indices]:
    """Return the pairs of these cameras (K, 3), the first of which has this number, and the landmarks `near`."""
    right, ahead = in_camera(cameras, places.points[near])
    beside = np.tan(half_view_rad(view.camera)) * ahead + 0.2
    possible = (ahead > 0.1) & (ahead < places.sight.range_max_m) & (np.abs(right) < beside)
    pose, landmark = np.nonzero(possible)
    return pose + first, near[landmark]


def _add_normal_equations(
    evidence: Evidence,
    places: Places,
    poses: Array,
    pair: tuple[Indices, Indices],
    window: float,
    information: Array,
    gradient: Array,
) -> None:
    """Add JᵀWJ (K, 3, 3) and JᵀWr (K, 3) of bearings and feet."""
    view, camera, (pose, landmark) = evidence.view, evidence.view.camera, pair
    cameras = camera.pose_in_map(poses)
    right, back = robot_from_map(cameras[pose], places.points[landmark]).T
    ahead = np.maximum(-back, 0.05)
    e, _ = image_heights(camera, ahead, places.bottom_m[landmark], places.top_m[landmark])
    edge, fit = evidence.look_up(right / ahead, e)
    keep = np.flatnonzero((edge >= 0) & np.isfinite(e))
    pose, landmark, edge, fit = pose[keep], landmark[keep], edge[keep], fit[keep]
    right, ahead, e = right[keep], ahead[keep], e[keep]
    # The probability that the edge is this landmark and not clutter, as in the mixture.
    trust = fit / (fit + np.bincount(pose, minlength=len(poses))[pose])
    by_bearing = bearing_jacobian(poses[pose], cameras[pose], places.points[landmark])
    squared = np.square(places.points[landmark] - cameras[pose, :2]).sum(axis=1)
    variance = view.bearing_sigma[edge] ** 2 + places.sigma_m[landmark] ** 2 / squared + window**2
    # The foot: e depends on the distance ahead alone, de/dahead = (s - e c) / depth.
    s, c = np.sin(camera.mount.tilt_rad), np.cos(camera.mount.tilt_rad)
    per_ahead = (s - e * c) / (ahead * c - (places.bottom_m[landmark] - camera.mount.height_m) * s)
    heading = cameras[pose, 2]
    by_camera = per_ahead[:, None] * np.stack([np.sin(heading), np.cos(heading), -right], axis=-1)
    by_foot = by_robot_pose(by_camera, poses[pose], cameras[pose])
    residual = view.bearing[edge] - np.arctan2(right, ahead)
    _accumulate(pose, by_bearing, residual, trust / variance, information, gradient)
    miss, sigma = view.foot[edge] - e, np.hypot(view.foot_sigma, window)
    near = ~view.cut[edge] & (np.abs(miss) < 2.0 * sigma)
    _accumulate(pose, by_foot, np.where(near, miss, 0.0), np.where(near, trust / sigma**2, 0.0), information, gradient)


def _accumulate(pose: Indices, jac: Array, residual: Array, weight: Array, information: Array, gradient: Array) -> None:
    count = len(information)
    for row in range(3):
        weighted = weight * jac[:, row]
        gradient[:, row] += np.bincount(pose, weighted * residual, count)
        for column in range(row, 3):
            sums = np.bincount(pose, weighted * jac[:, column], count)
            information[:, row, column] += sums
            if column > row:
                information[:, column, row] += sums
