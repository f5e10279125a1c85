"""The likelihood of edges by plain loops over poses, landmarks and edges, written from the equations in docs."""

from dataclasses import replace
from math import atan, cos, exp, inf, isfinite, pi, sin, sqrt, tan

import numpy as np

from localiser import geometry
from localiser.camera import Camera
from localiser.edges import Edges
from localiser.geometry import Array
from localiser.landmarks import LandmarkMap, image_heights, sight
from localiser.observation import INLIER_RATES, EdgeObservation, Sighting
from localiser.observation.frame import MISSED
from localiser.particles import CAMERA_YAW, Particles


def camera_poses(camera: Camera, particles: Particles) -> Array:
    """Return the floor poses (N, 3) of the particles' cameras in the map, each with its own yaw on the mount."""
    poses = camera.pose_in_map(particles.poses)
    poses[:, 2] += particles[CAMERA_YAW] if CAMERA_YAW in particles.names else 0.0
    return poses


def normal(error: float, variance: float) -> float:
    return exp(-0.5 * error**2 / variance) / sqrt(2 * pi * variance)


def compared(kind: str, bearing: float, tilt_rad: float) -> tuple[float, float]:
    """The angle that is compared and its derivative by the bearing, from tan(lean) = s tan(b)."""
    if kind == "line":
        return bearing, 1.0
    lean = atan(sin(tilt_rad) * tan(bearing))
    return lean, sin(tilt_rad) * cos(lean) ** 2 / cos(bearing) ** 2


def measured(kind: str, edges: Edges, e: int, tilt_rad: float) -> tuple[float, float]:
    """Measured angle and variance, the common error included."""
    if kind == "line":
        jacobian = edges.common.bearing_from_line[e]
        return float(edges.bearing[e]), float(edges.bearing_sigma[e] ** 2 + jacobian @ edges.common.cov @ jacobian)
    jacobian = edges.common.bearing_from_lean[e]
    bearing = geometry.bearing_from_lean(edges.lean[e], tilt_rad)
    spread = jacobian @ edges.common.cov @ jacobian / geometry.bearing_per_lean(bearing, tilt_rad) ** 2
    return float(edges.lean[e]), float(edges.lean_sigma[e] ** 2 + spread)


def plain_pairs(
    observation: EdgeObservation, camera_pose: Array, sighting: Sighting, landmark_map: LandmarkMap, more_var: Array
) -> tuple[dict[tuple[int, int], tuple[float, float, float]], dict[int, float]]:
    """Return residual, its variance and c_el N(q_e; q_l, σ_el²) by (edge, landmark), and how open each landmark is.

    more_var: (L,) of the angle at which a landmark is expected, rad². Pairs beyond six sigmas are left out.
    """
    frame, limits, pairs, is_open = observation.frame(sighting.edges), observation.parameters.sight, {}, {}
    ends, camera, edges, kind = frame.ends, frame.camera, sighting.edges, observation.parameters.kind
    tilt_rad, margin = camera.mount.tilt_rad, limits.margin_px / camera.focal_px
    missed = MISSED if frame.has_ends else 1.0
    angles = [measured(kind, edges, e, tilt_rad) for e in range(len(edges))]
    lowest, highest = camera.upright_bounds[2] - margin, camera.upright_bounds[3] + margin
    seen = sight(camera, camera_pose[None], landmark_map, replace(limits, range_max_m=limits.farthest_m))
    sigma_m = sighting.map_scale * landmark_map.sigma_m(observation.parameters.landmark_sigma_m)
    ahead_m, of = seen.range_m * np.cos(np.arctan(seen.tangent)), seen.landmark
    e_ends = image_heights(camera, ahead_m, landmark_map.bottom_m[of], landmark_map.top_m[of])
    columns = np.column_stack([seen.tangent, seen.range_m, *e_ends, sigma_m[of]])
    for k, (t, range_m, *at, sigma) in zip(seen.landmark.tolist(), columns.tolist(), strict=True):
        expected, slope = compared(kind, atan(t), tilt_rad)
        shown = min(at[1], highest) - max(at[0], lowest)
        is_open[k] = min(1.0, (limits.range_max_m / range_m) ** 4)
        for e, (q, q_var) in enumerate(angles):
            residual, variance = q - expected, q_var + (slope * sigma / range_m) ** 2 + float(more_var[k])
            if not residual**2 < 36.0 * variance:
                continue
            bottom, top = at[0] if at[0] > lowest else -inf, at[1] if at[1] < highest else inf
            inside = min(top, ends.e[e, 1]) - max(bottom, ends.e[e, 0]) + 12.0 / camera.focal_px
            agreement = min(max(inside * ends.per_length[e], 0.0), 1.0) ** 2
            agreement *= 1.0 + 0.8 * edges.polarity[e] * landmark_map.polarity[k]
            for side, height_m in enumerate((landmark_map.bottom_m[k], landmark_map.top_m[k])):
                room, in_image = ends.room[e, side], lowest < at[side] < highest
                if isfinite(height_m):
                    short = (missed if in_image else 1.0) * min(room / shown, 1.0)
                    reaches = in_image and not ends.cut[e, side]
                    peak = (1 - missed) * room * normal(ends.e[e, side] - at[side], ends.sigma[e, side] ** 2)
                    agreement *= short + (peak if reaches else 0.0)
            pairs[e, k] = residual, variance, agreement * normal(residual, variance)
    return pairs, is_open


def by_rate_plain(
    observation: EdgeObservation,
    particles: Particles,
    sighting: Sighting,
    landmark_map: LandmarkMap,
    blur_rad: float = 0.0,
) -> Array:
    """Return what `EdgeObservation.by_rate` does, (K, N)."""
    camera, span_rad = observation.frame(sighting.edges).camera, observation.frame(sighting.edges).span_rad
    blur_var, result = np.full(len(landmark_map), blur_rad**2), np.zeros((len(INLIER_RATES), len(particles)))
    for n, pose in enumerate(camera_poses(camera, particles)):
        pairs, is_open = plain_pairs(observation, pose, sighting, landmark_map, blur_var)
        # A pose that sees no landmark can explain no edge: its densities are zero, all edges are clutter.
        ratio = np.zeros(len(sighting.edges))
        for (e, k), (_, _, density) in pairs.items():
            ratio[e] += span_rad * is_open[k] * density / max(sum(is_open.values()), 1.0)
        if sighting.persistent is not None:
            ratio /= sighting.persistent
        result[:, n] = np.log1p(INLIER_RATES[:, None] * (ratio - 1.0)).sum(axis=1)
    return result
