"""The drive: straights, arcs and turns on the spot, exactly; what odometry makes of them; a camera that moves.

A camera moves on a head that pans and tilts, on a lift, on a robot that balances.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from localiser import geometry
from localiser.camera import Mount, MountSigma
from localiser.errors import InputError
from localiser.geometry import Array, Trajectory
from localiser.simulate.world import DriveSpec, MountMotionSpec, OdometrySpec, Sway, World

MOST_POSES = 1_000_000


@dataclass(frozen=True, slots=True, eq=False)
class Drive:
    """truth: in the map, at the odometry's times. odometry: in its own frame, from (0, 0, 0). image_t_ns: (I,)."""

    truth: Trajectory
    odometry: Trajectory
    image_t_ns: NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class _Piece:
    """A part of the path with constant speed (m/s) and turn rate (rad/s, anticlockwise)."""

    speed: float
    turn_rate: float
    duration_s: float


def drive_of(world: World, rng: np.random.Generator) -> Drive:
    """Return the world's drive and one draw of its odometry's errors."""
    spec = world.drive
    truth = truth_of(spec)
    half_exposure_ns = round(world.image.exposure_s * 5e8)
    before_s, after_s = world.camera.camera().readout_s
    first_ns = max(round(spec.image_offset_s * 1e9), half_exposure_ns + round(-before_s * 1e9))
    last_ns = truth.t_ns[-1] - half_exposure_ns - round(after_s * 1e9)
    if last_ns < first_ns:
        problem = f"expected a first image by {last_ns / 1e9:g} s, as long before the end as it is exposed, found"
        raise InputError(f"{problem} {first_ns / 1e9:g} s", field="drive.image_offset_s")
    count = int((last_ns - first_ns) * spec.image_hz / 1e9) + 1
    image_t_ns = first_ns + np.round(np.arange(count) * 1e9 / spec.image_hz).astype(np.int64)
    return Drive(truth, odometry_of(truth, world.odometry, rng), image_t_ns)


def truth_of(spec: DriveSpec) -> Trajectory:
    """Return the exact poses at the odometry's times, from the start to the first time after the end.

    Raises InputError for a drive without an end in sight.
    """
    pieces = [piece for piece in _pieces(spec) if piece.duration_s > 1e-12]
    begin_s = np.concatenate([[0.0], np.cumsum([piece.duration_s for piece in pieces])])
    poses = [np.array([*spec.path[0].to, spec.headings[0]])]
    for piece in pieces:
        poses.append(_after(poses[-1], piece, piece.duration_s))
    if begin_s[-1] * max(spec.odometry_hz, spec.image_hz) > MOST_POSES:
        raise InputError(
            f"expected a drive of at most {MOST_POSES} poses and images, found one of {begin_s[-1]:.3g} s",
            field="drive",
        )
    count = int(np.ceil(begin_s[-1] * spec.odometry_hz - 1e-9)) + 1
    t_ns = np.round(np.arange(count) * 1e9 / spec.odometry_hz).astype(np.int64)
    index = np.clip(np.searchsorted(begin_s, t_ns / 1e9, side="right") - 1, 0, len(pieces) - 1)
    since_s = np.minimum(t_ns / 1e9 - begin_s[index], [pieces[k].duration_s for k in index])
    sampled = [_after(poses[k], pieces[k], float(s)) for k, s in zip(index, since_s, strict=True)]
    return Trajectory(t_ns, np.array(sampled))


def odometry_of(truth: Trajectory, spec: OdometrySpec, rng: np.random.Generator) -> Trajectory:
    """Return the poses that odometry integrates from (0, 0, 0) while the robot drives along `truth`.

    In each step, distance and turn are scaled by a constant and by a slowly varying error; the heading veers and walks
    with the distance, and errs with the turn.
    """
    step_s = np.diff(truth.t_ns) / 1e9
    slow_distance, slow_turn = (_slow_scale(step_s, spec, rng) for _ in range(2))
    pose = np.zeros(3)
    poses = [pose]
    draws = rng.standard_normal((len(step_s), 3))
    for k, draw in enumerate(draws):
        motion = geometry.between(truth.poses[k], truth.poses[k + 1])
        velocity, turn = geometry.arc_log(motion), float(motion[2])
        distance = float(np.hypot(*velocity))
        scale = 1.0 + spec.distance_scale + slow_distance[k]
        if distance > 0:
            scale += spec.distance_noise_m_per_sqrt_m * draw[0] / np.sqrt(distance)
        measured_turn = turn * (1.0 + spec.rotation_scale + slow_turn[k]) + np.deg2rad(
            spec.veer_deg_per_m * distance
            + spec.heading_walk_deg_per_sqrt_m * np.sqrt(distance) * draw[1]
            + spec.turn_noise_deg_per_sqrt_deg * np.sqrt(np.rad2deg(abs(turn))) * draw[2]
        )
        pose = geometry.compose(pose, geometry.arc_motion(velocity * scale, measured_turn, 1.0))
        poses.append(pose)
    return Trajectory(truth.t_ns, np.array(poses))


def _pieces(spec: DriveSpec) -> Iterator[_Piece]:
    headings, cuts = spec.headings, spec.cuts_m
    turn_rate = np.deg2rad(spec.turn_deg_s)
    yield _Piece(0.0, 0.0, spec.path[0].pause_s)
    for k, (here, there) in enumerate(zip(spec.path[:-1], spec.path[1:], strict=True)):
        speed = there.speed_m_s or spec.speed_m_s
        length = float(np.hypot(there.to[0] - here.to[0], there.to[1] - here.to[1]))
        yield _Piece(speed, 0.0, (length - cuts[k] - cuts[k + 1]) / speed)
        is_last = k == len(headings) - 1
        turn = np.deg2rad(spec.end_turn_deg) if is_last else float(geometry.wrap_angle(headings[k + 1] - headings[k]))
        if cuts[k + 1] > 0:
            rate = speed / there.corner_radius_m
            yield _Piece(speed, np.copysign(rate, turn), abs(turn) / rate)
        else:
            yield _Piece(0.0, np.copysign(turn_rate, turn), abs(turn) / turn_rate)
        yield _Piece(0.0, 0.0, there.pause_s)


def _after(pose: Array, piece: _Piece, duration_s: float) -> Array:
    velocity = np.array([0.0, -piece.speed])
    return geometry.compose(pose, geometry.arc_motion(velocity, piece.turn_rate * duration_s, duration_s))


def _slow_scale(step_s: Array, spec: OdometrySpec, rng: np.random.Generator) -> Array:
    """Return a stationary Ornstein–Uhlenbeck process (T,) with the stated sigma and correlation time."""
    keep = np.exp(-step_s / spec.slow_scale_time_s)
    draws = spec.slow_scale_sigma * rng.standard_normal(len(step_s))
    values = np.zeros(len(step_s))
    value = spec.slow_scale_sigma * rng.standard_normal()
    for k in range(len(step_s)):
        value = keep[k] * value + np.sqrt(1 - keep[k] ** 2) * draws[k]
        values[k] = value
    return values


# -- a camera that moves on the robot ---------------------------------------------------------------------------------


def mount_at(mount: Mount, motion: MountMotionSpec | None, t_ns: int) -> Mount:
    """Return the true mount at a time: the usual one, plus what each part sways by."""
    if motion is None:
        return mount

    def swayed(sway: Sway | None) -> float:
        if sway is None:
            return 0.0
        return sway.amplitude * math.sin(2.0 * math.pi * sway.hz * t_ns / 1e9 + math.radians(sway.phase_deg))

    return replace(
        mount,
        tilt_rad=mount.tilt_rad + math.radians(swayed(motion.tilt_deg)),
        roll_rad=mount.roll_rad + math.radians(swayed(motion.roll_deg)),
        yaw_rad=mount.yaw_rad + math.radians(swayed(motion.yaw_deg)),
        height_m=mount.height_m + swayed(motion.height_m),
    )


def stated_mount(true: Mount, motion: MountMotionSpec, rng: np.random.Generator) -> Mount:
    """Return the mount as the robot states it: tilt and roll err by `stated_sigma_deg`, anew in each image."""
    sigma_rad = math.radians(motion.stated_sigma_deg)
    if sigma_rad == 0.0:
        return true
    tilt, roll = sigma_rad * rng.standard_normal(2)
    sigma = MountSigma(tilt_rad=sigma_rad, roll_rad=sigma_rad)
    return replace(true, tilt_rad=true.tilt_rad + float(tilt), roll_rad=true.roll_rad + float(roll), sigma=sigma)
