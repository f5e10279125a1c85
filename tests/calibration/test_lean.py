"""Tilt and roll where things lean: what stands in one row is one error, in however many images it is seen."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from edge_images import camera_of
from leaning_rows import leaning_drive

from localiser.calibration.lean import mount_with_leans
from localiser.calibration.lines import Lines
from localiser.calibration.plumb import Plumb, fitted
from localiser.geometry import Array

CAMERA = camera_of(tilt_deg=20.0, roll_deg=1.0)
TRUE = np.deg2rad([20.0, 1.0])


def scaled_errors(seeds: range, **world: float) -> tuple[Array, Array]:
    """Return the errors of tilt and roll in sigmas (N, 2) of lines taken as leaning, and of lines that err alone."""
    leaning, alone = [], []
    for seed in seeds:
        drive = leaning_drive(seed, **world)
        plumb = fitted(drive.lines, drive.mount, drive.mount)
        found = mount_with_leans(drive.lines, plumb, drive.odometry, drive.camera, drive.mount)
        leaning.append((found.mount - drive.mount) / np.sqrt(np.diag(found.cov)))
        alone.append((plumb.mount - drive.mount) / np.sqrt(np.diag(plumb.cov)))
    return np.array(leaning), np.array(alone)


def test_sigma_covers_the_error_where_rows_lean() -> None:
    leaning, alone = scaled_errors(range(8), row_deg=0.3, own_deg=0.15)
    assert np.sqrt((leaning**2).mean()) < 1.6
    assert np.abs(leaning).max() < 4.0
    assert np.sqrt((alone**2).mean()) > 5.0


@pytest.mark.slow  # quick: eight worlds above
@pytest.mark.parametrize("along", ["any", "along", "back"])
def test_sigma_covers_the_error_in_many_worlds(along: str) -> None:
    leaning, _ = scaled_errors(range(100, 140), row_deg=0.3, own_deg=0.15, along=along)
    assert np.all(np.sqrt((leaning**2).mean(axis=0)) < 1.5)
    assert (np.abs(leaning) > 3.0).mean() < 0.05


def test_a_plumb_building_is_told_from_one_that_leans() -> None:
    sigma, row = [], []
    for row_deg, own_deg in ((0.0, 0.02), (0.3, 0.15)):
        drive = leaning_drive(5, row_deg=row_deg, own_deg=own_deg)
        plumb = fitted(drive.lines, drive.mount, drive.mount)
        found = mount_with_leans(drive.lines, plumb, drive.odometry, drive.camera, drive.mount)
        sigma.append(np.sqrt(np.diag(found.cov)))
        row.append(found.row)
    assert np.all(sigma[0] < 0.6 * sigma[1])
    assert row[0] < np.deg2rad(0.1) < np.deg2rad(0.2) < row[1]


def test_driving_the_same_way_again_tells_nothing_new() -> None:
    """The second round shows the same things with the same leans and errors of their edges."""
    drive = leaning_drive(5, row_deg=0.3, own_deg=0.15)
    once, images = drive.lines, len(drive.odometry)
    again = Lines(once.normal, once.per_turn, once.sigma, once.frame + images)
    plumb = fitted(once, drive.mount, drive.mount)
    one = mount_with_leans(once, plumb, drive.odometry, drive.camera, drive.mount)
    twice = replace(plumb, vertical=np.tile(plumb.vertical, 2))
    poses = np.tile(drive.odometry, (2, 1))
    two = mount_with_leans(Lines.together([once, again]), twice, poses, drive.camera, drive.mount)
    np.testing.assert_allclose(two.mount, one.mount, atol=1e-6)
    np.testing.assert_allclose(two.cov, one.cov, rtol=1e-3)


def test_where_a_drive_begins_does_not_matter() -> None:
    """Poses are those of odometry, in a frame of its own: shifted by whole patches it gives the same."""
    drive = leaning_drive(1, row_deg=0.3, own_deg=0.15)
    plumb = fitted(drive.lines, drive.mount, drive.mount)
    here = mount_with_leans(drive.lines, plumb, drive.odometry, drive.camera, drive.mount)
    shifted = drive.odometry + np.array([4.0, -7.0, 0.0])
    there = mount_with_leans(drive.lines, plumb, shifted, drive.camera, drive.mount)
    np.testing.assert_allclose(there.mount, here.mount, atol=1e-7)
    np.testing.assert_allclose(there.cov, here.cov, rtol=1e-4)


def test_without_lines_what_is_known_stays() -> None:
    plumb = Plumb(TRUE, np.diag([1e-2, 1e-3]), 1e-3, np.zeros(0))
    found = mount_with_leans(Lines.together([]), plumb, np.zeros((0, 3)), CAMERA, TRUE)
    np.testing.assert_array_equal(found.mount, TRUE)
    np.testing.assert_array_equal(found.cov, plumb.cov)
