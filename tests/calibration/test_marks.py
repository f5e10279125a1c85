"""The truth of a drive over marks: a simulated drive whose poses are known, and marks that are wrong."""

from __future__ import annotations

import numpy as np
import pytest

from localiser.calibration import Mark, MarkedDrive, drive_over_marks
from localiser.errors import InputError
from localiser.evaluate import nees
from localiser.geometry import Array, Trajectory, compose, wrap_angle
from localiser.motion import EXACT, MotionParameters

STEPS, EVERY = 400, 50
SIGMA_M = 0.01
CONSTANTS = (0.02, -0.03, 0.008)  # within the priors of the motion model
NOISE = MotionParameters(alpha1=1e-3, alpha2=3e-4, alpha3=3e-4, alpha4=1e-4)


def drive(seed: int) -> tuple[Trajectory, Trajectory]:
    """Return odometry in a frame of its own, and the true poses, of 10 m with bends at 20 Hz."""
    rng = np.random.default_rng(seed)
    ahead, turn = np.full(STEPS, 0.025), 0.02 * np.sin(np.arange(STEPS) / 60.0)
    true_ahead = (1 + CONSTANTS[0]) * ahead
    true_ahead = true_ahead + np.sqrt(NOISE.alpha3 * ahead + NOISE.alpha4 * np.abs(turn)) * rng.normal(size=STEPS)
    true_turn = (1 + CONSTANTS[1]) * turn + CONSTANTS[2] * ahead
    true_turn = true_turn + np.sqrt(NOISE.alpha1 * np.abs(turn) + NOISE.alpha2 * ahead) * rng.normal(size=STEPS)
    t_ns = 5_000 + np.arange(STEPS + 1) * 50_000_000
    tracks = []
    for way, angle, at in ((ahead, turn, [7.0, -3.0, 2.5]), (true_ahead, true_turn, [1.0, 2.0, -3.0])):
        poses = [np.array(at)]
        for moved, turned in zip(way, angle, strict=True):
            half = turned / 2
            poses.append(compose(poses[-1], [-moved * np.sin(half), -moved * np.cos(half), turned]))
        tracks.append(Trajectory(t_ns, np.array(poses)))
    return tracks[0], tracks[1]


def marks_of(truth: Trajectory, seed: int) -> list[Mark]:
    rng = np.random.default_rng(seed)
    at = range(0, STEPS + 1, EVERY)
    return [
        Mark(int(truth.t_ns[k]), *(truth.poses[k, :2] + SIGMA_M * rng.normal(size=2)).tolist(), sigma_m=SIGMA_M)
        for k in at
    ]


def errors(found: MarkedDrive, truth: Trajectory) -> Array:
    off = found.trajectory.poses - truth.sampled(found.trajectory.t_ns).poses
    off[:, 2] = wrap_angle(off[:, 2])
    return off


@pytest.mark.slow
def test_poses_between_marks_are_within_their_sigma() -> None:
    off, normalised, constants = [], [], []
    for seed in range(6):
        odometry, truth = drive(seed)
        found = drive_over_marks(odometry, marks_of(truth, seed + 50), NOISE)
        error = errors(found, truth)
        off.append(np.hypot(error[:, 0], error[:, 1]) / found.position_sigma_m)
        normalised.append(nees(error, found.covs).mean())
        constants.append((found.constants - CONSTANTS) / found.sigmas)
        assert len(found.trajectory) == STEPS + 1
    assert 0.6 < np.sqrt(np.mean(np.square(off))) < 1.4
    assert 1.8 < np.mean(normalised) < 4.5  # 3 is right
    assert np.abs(constants).max() < 4.0


def test_marks_bound_the_error_and_odometry_alone_drifts() -> None:
    odometry, truth = drive(3)
    found = drive_over_marks(odometry, marks_of(truth, 1), NOISE)
    error = errors(found, truth)
    assert np.hypot(error[:, 0], error[:, 1]).max() < 0.1
    ends = drive_over_marks(odometry, [marks_of(truth, 1)[k] for k in (0, -1)], NOISE)
    assert ends.position_sigma_m.max() > 1.5 * found.position_sigma_m.max()


def test_one_heading_turns_a_drive_that_stayed_at_one_place() -> None:
    t_ns = np.arange(3) * 1_000_000_000
    odometry = Trajectory(t_ns, np.array([[5.0, 5.0, 0.5], [5.0, 4.9, 0.5], [5.0, 5.0, 0.5]]))
    marks = [Mark(0, 1.0, 2.0, heading_rad=-1.0), Mark(2_000_000_000, 1.0, 2.0)]
    found = drive_over_marks(odometry, marks)
    assert found.trajectory.poses[0] == pytest.approx([1.0, 2.0, -1.0], abs=0.03)
    with pytest.raises(InputError, match=r"marks at least 0\.3 m apart, or a heading"):
        drive_over_marks(odometry, [Mark(0, 1.0, 2.0), Mark(2_000_000_000, 1.0, 2.0)])


def test_a_mark_taken_for_another_is_named() -> None:
    odometry, truth = drive(4)
    marks = marks_of(truth, 2)
    wrong = marks[5]
    marks[5] = Mark(wrong.t_ns, wrong.x_m + 1.0, wrong.z_m, sigma_m=SIGMA_M)
    with pytest.raises(InputError, match="is it another mark") as told:
        drive_over_marks(odometry, marks, NOISE)
    assert told.value.line == 6


def test_times_must_be_the_odometrys_and_in_order() -> None:
    odometry, truth = drive(5)
    marks = marks_of(truth, 3)
    with pytest.raises(InputError, match="at least two marks, found 1"):
        drive_over_marks(odometry, marks[:1])
    with pytest.raises(InputError, match="expected a time of the odometry"):
        drive_over_marks(odometry, [Mark(0, 0.0, 0.0), *marks])
    with pytest.raises(InputError, match="expected a time after") as told:
        drive_over_marks(odometry, [marks[1], marks[0]])
    assert told.value.line == 2


def test_odometry_without_errors_and_exact_marks_give_the_drive() -> None:
    _, truth = drive(6)
    exact = MotionParameters(1e-6, 1e-6, 1e-6, 1e-6, EXACT)
    marks = [Mark(int(truth.t_ns[k]), *truth.poses[k, :2].tolist()) for k in (0, 150, 400)]
    found = drive_over_marks(truth, marks, exact)
    assert np.abs(errors(found, truth)).max() < 1e-3
