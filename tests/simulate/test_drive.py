"""The drive follows its path exactly; odometry errs as much as its file says, and only so."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError

from localiser import geometry
from localiser.simulate.drive import odometry_of, truth_of
from localiser.simulate.world import DriveSpec, OdometrySpec


def drive(*path: dict[str, Any], **changes: Any) -> DriveSpec:
    return DriveSpec.model_validate({"path": path, "odometry_hz": 50.0, **changes})


CORNER = ({"to": [0, 0]}, {"to": [0, -3], "corner_radius_m": 1.0}, {"to": [2, -3]})


def test_a_drive_starts_at_its_first_point_facing_the_second_and_ends_at_the_last() -> None:
    truth = truth_of(drive({"to": [1, 2]}, {"to": [-1, 2]}, end_turn_deg=90.0))
    np.testing.assert_allclose(truth.poses[0], [1, 2, np.pi / 2], atol=1e-12)
    np.testing.assert_allclose(truth.poses[-1, :2], [-1, 2], atol=1e-12)
    assert abs(geometry.wrap_angle(truth.poses[-1, 2] - np.pi)) < 1e-12
    assert (np.diff(truth.t_ns) == 20_000_000).all()


def test_a_rounded_corner_is_an_exact_arc() -> None:
    truth = truth_of(drive(*CORNER))
    on_arc = (truth.poses[:, 1] < -2) & (truth.poses[:, 0] < 1)
    assert on_arc.sum() > 50
    from_centre = np.hypot(truth.poses[on_arc, 0] - 1.0, truth.poses[on_arc, 1] + 2.0)
    np.testing.assert_allclose(from_centre, 1.0, atol=1e-12)
    np.testing.assert_allclose(truth.poses[-1, 2], -np.pi / 2, atol=1e-12)


def test_speed_is_constant_and_straight_ahead_also_on_the_arc() -> None:
    spec = drive(*CORNER, speed_m_s=0.4)
    truth = truth_of(spec)
    turning = 1.0 / 0.4 * np.pi / 2
    duration = (2.0 + 1.0) / 0.4 + turning
    assert truth.t_ns[-1] / 1e9 == pytest.approx(duration, abs=0.02)
    inside = truth.t_ns[:-1] / 1e9 < duration - 0.04
    for start, end in zip(truth.poses[:-1][inside], truth.poses[1:][inside], strict=True):
        motion = geometry.between(start, end)
        if abs(motion[2]) in (0.0, pytest.approx(0.4 * 0.02)):  # not where two pieces meet
            np.testing.assert_allclose(geometry.arc_log(motion), [0.0, -0.4 * 0.02], atol=1e-12)


def test_a_corner_without_radius_turns_on_the_spot_the_short_way() -> None:
    truth = truth_of(drive({"to": [0, 0]}, {"to": [0, -1], "pause_s": 1.0}, {"to": [1, -1]}, turn_deg_s=45.0))
    at_corner = np.hypot(truth.poses[:, 0], truth.poses[:, 1] + 1) < 1e-9
    assert at_corner.sum() / 50 == pytest.approx(2.0 + 1.0, abs=0.05)
    turned = np.diff(np.unwrap(truth.poses[at_corner, 2]))
    assert (turned <= 1e-12).all(), "to the right only"
    assert turned.sum() == pytest.approx(-np.pi / 2, abs=0.02)


@pytest.mark.parametrize(
    ("path", "message"),
    [
        (({"to": [0, 0]}, {"to": [0, 0]}), "apart"),
        (({"to": [0, 0]}, {"to": [0, -0.5], "corner_radius_m": 1.0}, {"to": [2, -0.5]}), "room for the corners"),
        (({"to": [0, 0]}, {"to": [0, -3], "corner_radius_m": 0.5}, {"to": [0, 0]}), "room for the corners"),
    ],
)
def test_a_path_that_cannot_be_driven_is_refused(path: tuple[dict[str, Any], ...], message: str) -> None:
    with pytest.raises(ValidationError, match=message):
        drive(*path)


def test_odometry_without_errors_repeats_the_truth_in_its_own_frame() -> None:
    truth = truth_of(drive(*CORNER, {"to": [2, 1]}))
    odometry = odometry_of(truth, OdometrySpec(), np.random.default_rng(0))
    np.testing.assert_allclose(odometry.poses[0], 0.0)
    in_map = geometry.compose(truth.poses[0], odometry.poses)
    np.testing.assert_allclose(in_map[:, :2], truth.poses[:, :2], atol=1e-9)
    np.testing.assert_allclose(geometry.wrap_angle(in_map[:, 2] - truth.poses[:, 2]), 0.0, atol=1e-9)


def test_systematic_errors_have_the_stated_size() -> None:
    truth = truth_of(drive({"to": [0, 0]}, {"to": [0, -4]}, end_turn_deg=90.0))
    spec = OdometrySpec(distance_scale=0.1, rotation_scale=-0.2)
    end = odometry_of(truth, spec, np.random.default_rng(0)).poses[-1]
    np.testing.assert_allclose(end, [0.0, -4.4, np.deg2rad(72)], atol=1e-9)
    veering = odometry_of(truth, OdometrySpec(veer_deg_per_m=5.0), np.random.default_rng(0)).poses[-1]
    assert veering[2] == pytest.approx(np.deg2rad(90 + 4 * 5.0))
    assert veering[0] < -0.5, "a positive veer is anticlockwise: to the left"


def test_turn_noise_grows_with_the_root_of_the_turn() -> None:
    truth = truth_of(drive({"to": [0, 0]}, {"to": [0, -0.1]}, end_turn_deg=100.0))
    spec = OdometrySpec(turn_noise_deg_per_sqrt_deg=0.3)
    ends = [odometry_of(truth, spec, np.random.default_rng(seed)).poses[-1, 2] for seed in range(150)]
    assert np.rad2deg(np.std(ends)) == pytest.approx(3.0, rel=0.25)


def test_the_slow_scale_varies_by_its_sigma_and_stays_for_its_time() -> None:
    spec = OdometrySpec(slow_scale_sigma=0.05, slow_scale_time_s=4.0)
    truth = truth_of(drive({"to": [0, 0]}, {"to": [0, -400]}, speed_m_s=1.0, odometry_hz=5.0))
    odometry = odometry_of(truth, spec, np.random.default_rng(0))
    step = np.hypot(*np.diff(odometry.poses[:, :2], axis=0).T) / np.hypot(*np.diff(truth.poses[:, :2], axis=0).T) - 1
    assert step.std() == pytest.approx(0.05, rel=0.25)
    lag = 20  # 4 s
    assert np.corrcoef(step[:-lag], step[lag:])[0, 1] == pytest.approx(np.exp(-1), abs=0.2)


def test_a_half_turn_needs_no_arc() -> None:
    """There and back by the same way; numpy's warnings of the package's own numbers are errors."""
    truth = truth_of(drive({"to": [0, 0]}, {"to": [0, -1]}, {"to": [0, 0]}, turn_deg_s=90.0))
    np.testing.assert_allclose(truth.poses[-1, :2], [0, 0], atol=1e-9)
    assert abs(geometry.wrap_angle(truth.poses[-1, 2] - np.pi)) < 1e-9
