"""Wheels that stand still, slip or fall silent on the shipped drive: the edges are followed, and it is told."""

from collections import deque
from collections.abc import Iterator
from dataclasses import replace
from itertools import product
from typing import Any

import numpy as np
import pytest
from board.run import located
from board.worlds import hours_of
from short_log import corridor_with_edges
from two_views import CAMERA, edges_from

from localiser import Localiser
from localiser.config import read_config
from localiser.edges import Edges
from localiser.filter import LocatedFrame, Odometry, Start
from localiser.filter.events import is_silent
from localiser.filter.motion_hypotheses import ASTRAY, LEAST_SIGMA, Wheels, contradicts
from localiser.geometry import Increment, between, compose, wrap_angle
from localiser.particles import POSE, Estimate
from localiser.replay.run import start_of
from localiser.storage import Log
from localiser.visual_odometry import Gaussian, Odometer, TwoImages, VisualOdometryParameters, follow, with_scale

BEGIN_S, END_S = 12.0, 15.0


def events_with(log: Log, start: Start, fault: str) -> Iterator[Any]:
    """Yield the events of a log whose wheels have a fault for 3 s."""
    before: Odometry | None = None
    pose, first_ns = np.zeros(3), log.odometry.t_ns[0]
    for event in log.events(start, anywhere=False):
        if isinstance(event, Odometry):
            is_faulty = BEGIN_S <= (event.t_ns - first_ns) / 1e9 < END_S
            step = np.zeros(3) if before is None else between(before.pose, event.pose)
            factor = {"stand still": 0.0, "count double": 2.0}.get(fault, 1.0) if is_faulty else 1.0
            pose, before = compose(pose, factor * step), event
            if fault != "fall silent" or not is_faulty:
                yield Odometry(event.t_ns, pose)
        else:
            yield event


@pytest.mark.parametrize(
    "fault",
    ["stand still", *(pytest.param(each, marks=pytest.mark.slow) for each in ("none", "count double", "fall silent"))],
)
def test_wheels_that_err_for_three_seconds(fault: str) -> None:
    log, edges = corridor_with_edges()
    localiser = Localiser(log.landmark_map, log.camera, read_config(None, (), log.settings))
    start = start_of(log, "truth", localiser.rng)
    frames: list[LocatedFrame] = localiser.start(start.mean, start.cov, start.t_ns)
    for event in events_with(log, start, fault):
        if isinstance(event, Odometry):
            frames += localiser.odometry(event.t_ns, event.pose)
        elif not isinstance(event, Start):
            frames += localiser.edges(event.t_ns, edges[event.t_ns])
    frames += localiser.finish()

    truth = log.groundtruth.sampled([frame.located.t_ns for frame in frames]).poses
    error = np.array([frame.located.estimate.pose for frame in frames]) - truth
    error_m, error_rad = np.hypot(*error[:, :2].T), np.abs(wrap_angle(error[:, 2]))
    sure = np.array([frame.located.p_correct > 0.9 for frame in frames])
    told = np.array([frame.located.wheels_are_wrong for frame in frames])
    seconds = (np.array([frame.located.t_ns for frame in frames]) - log.odometry.t_ns[0]) / 1e9
    faulty = (seconds >= BEGIN_S) & (seconds < END_S)
    assert not (sure & ((error_m > 0.5) | (error_rad > np.radians(10.0)))).any()
    assert error_m.max() < 0.25 and error_m[seconds > END_S + 1.0].max() < 0.05
    if fault == "none":
        assert not told.any()
    elif fault == "fall silent":  # then edges alone tell the motion, whose covariance comes with it
        by_edges = np.array([frame.located.increment.cov.any() for frame in frames])
        assert by_edges[faulty].all() and not by_edges[(seconds < BEGIN_S) | (seconds > END_S + 1.0)].any()
    else:
        assert told[faulty].mean() > 0.7 and told[seconds < BEGIN_S].sum() == 0


def test_odometry_is_silent_where_poses_are_more_than_a_second_apart() -> None:
    second = 10**9
    odometry = deque(Odometry(t_ns, np.zeros(3)) for t_ns in (0, second, 4 * second, 5 * second))
    for begin, end, silent in ((0, 1, False), (1, 2, True), (2, 3, True), (3, 5, True), (4, 6, False)):
        assert is_silent(odometry, begin * second, end * second) == silent
    assert not is_silent(deque(), 0, second)


def test_an_image_that_does_not_fit_leaves_the_pace_of_before() -> None:
    """Wheels that count double move the estimate a little at first; that must not become the expected pace."""
    parameters, pace = VisualOdometryParameters(), Gaussian(np.array([0.0, -0.4, 0.0]), 1e-4 * np.eye(3))
    nothing = TwoImages.of(Edges.none(), Edges.none(), CAMERA)
    known = Wheels(usual=np.array([10.0, 0.0]), pose=np.zeros(3), pace=pace)
    double = Increment.from_mean(np.array([0.0, -0.16, 0.0]))

    fit = np.array([2.0, 0.0])
    told, other = known.after(fit, lambda: nothing, lambda _: 2.0, double, 1e-4 * np.eye(3), parameters, 0.2)
    assert other is None
    told = told.located(Estimate(POSE, np.array([0.0, -0.16, 0.0]), 1e-4 * np.eye(3)), 0.2)
    np.testing.assert_allclose(told.pace.mean, parameters.expected(pace, 0.2).mean / 0.2)
    again = told.located(Estimate(POSE, np.array([0.0, -0.17, 0.0]), 1e-4 * np.eye(3)), 0.0)
    assert again.pace is told.pace  # of two images at one time the second tells no speed


def test_the_pace_errs_in_the_robots_frame() -> None:
    pose, cov = np.array([0.0, 0.0, 0.5]), np.array([[0.04, 0.01, 0.0], [0.01, 0.02, 0.003], [0.0, 0.003, 0.01]])
    told = Wheels(pose=pose).located(Estimate(POSE, pose, cov), 0.5)
    axes = np.column_stack([between(pose, pose + step) for step in np.eye(3)])
    np.testing.assert_allclose(told.pace.cov, axes @ cov @ axes.T / 0.25, atol=1e-15)


def test_an_image_without_edges_leaves_the_pace_while_wheels_are_doubted() -> None:
    """Its particles follow the wheels, so wheels that stand still would agree with a pace of 0 from then on."""
    log, edges = corridor_with_edges()
    localiser = Localiser(log.landmark_map, log.camera, read_config(None, (), log.settings))
    start = start_of(log, "truth", localiser.rng)
    localiser.start(start.mean, start.cov, start.t_ns)
    blank_ns = min(t_ns for t_ns in edges if t_ns - log.odometry.t_ns[0] > (BEGIN_S + 1.0) * 1e9)
    known: list[Wheels] = []
    for event in events_with(log, start, "stand still"):
        if isinstance(event, Odometry):
            localiser.odometry(event.t_ns, event.pose)
        elif not isinstance(event, Start):
            localiser.edges(event.t_ns, Edges.none() if event.t_ns >= blank_ns else edges[event.t_ns])
            known.append(localiser.state.wheels)
            if event.t_ns > blank_ns + 10**9:
                break
    blank = known[-5:]
    assert all(one.wrong > 0.5 for one in blank) and len({one.pace for one in blank}) == 1
    assert blank[0].pace is not None and blank[0].pace.mean[1] < -0.2, "it went ahead"


def test_other_motions_are_compared_where_an_image_fits_far_worse_than_usual() -> None:
    """The map must fit worse by log(999 / 19 / 20) / 0.6 = 1.61: with less, one image cannot bring wheels in doubt."""
    still, nothing = Increment.from_mean(np.zeros(3)), TwoImages.of(Edges.none(), Edges.none(), CAMERA)
    pairs = ([10.0, 10.0], [7.0, 4.0]), ([2.0, 10.0], [0.39, 4.0]), ([-1.0, -2.0], [-2.61, -2.0])
    for (usual, least), off in product(pairs, ((0.01, 0.01), (-0.01, 0.01), (0.01, -0.01))):
        wheels = Wheels(usual=np.array(usual), pose=np.zeros(3), pace=Gaussian(np.zeros(3), 1e-4 * np.eye(3)))
        asked: list[Increment] = []
        by_map, fit = lambda motion, asked=asked: float(asked.append(motion) is None), np.add(least, off)
        wheels.after(fit, lambda: nothing, by_map, still, 1e-4 * np.eye(3), VisualOdometryParameters(), 0.2)
        assert bool(asked) == (min(off) < 0)


def test_one_motion_seen_says_only_so_much_against_the_wheels() -> None:
    """Edges that go astray now and then must not make wheels wrong at once; edges that agree speak for them."""
    cov, pace = np.diag([1e-6, 1e-4, 1e-5]), Gaussian(np.array([0.0, -0.1, 0.0]), np.diag([0.01, 0.01, 0.02]))
    wheels = Gaussian(pace.mean, cov + np.diag(LEAST_SIGMA**2))
    seen = Gaussian(wheels.mean, np.diag([1e-5, 1e-5, 1e-6]))

    def off_by(*move: float) -> float:
        return contradicts(wheels, replace(seen, mean=seen.mean + move), pace)

    agree, slip, noise = off_by(0.0, 0.0, 0.0), off_by(0.0, 0.0, 0.15), off_by(0.0, 0.008, 0.002)
    assert agree < -4.0 and agree < noise < -3.0
    assert slip == pytest.approx(np.log(1.0 / ASTRAY), abs=0.01)
    assert contradicts(wheels, pace, pace) == pytest.approx(0.0, abs=1e-6)  # edges that tell nothing
    # The same turn, written twice.
    half, other = np.array([0.0, 0.0, np.pi - 0.01]), np.array([0.0, 0.0, -np.pi - 0.01])
    turned = [replace(each, mean=each.mean + half) for each in (wheels, pace)]
    assert contradicts(turned[0], replace(seen, mean=seen.mean + other), turned[1]) == pytest.approx(agree)


def test_the_camera_does_not_take_for_granted_that_a_robot_steers() -> None:
    """Someone who walks sideways past things with no feet in view: edges tell the turn, and no more, of the wheels."""
    parameters, right_m, sigma = VisualOdometryParameters(), 0.1, np.array([2e-3, 1e-2, 2e-3])
    move = np.array([right_m, -0.1, 0.02])
    rng = np.random.default_rng(0)
    before, after = (edges_from(pose, rng, feet=False) for pose in (np.zeros(3), move))
    pace = Gaussian(np.array([0.0, -0.5, 0.1]), 1e-4 * np.eye(3))
    expected = parameters.expected(pace, 0.2)
    steers, _ = Odometer(CAMERA, parameters).motion(before, after, 0.2, pace)
    of_wheels, of_steering = (
        contradicts(Gaussian(move, np.diag(sigma**2)), with_scale(seen, walks=False), expected)
        for seen in (follow(TwoImages.of(before, after, CAMERA), [(expected, 0.0)]), steers)
    )
    assert of_wheels < 0.5 and of_steering > 2.0


def test_the_scale_of_ranges_is_in_the_covariance_of_a_motion_seen() -> None:
    """Over 2 m the random walk errs as much as the scale does, 12 %; across the way and in the turn by nothing."""
    step = Gaussian(np.array([0.0, -0.1, 0.01]), np.zeros((3, 3)))
    once, walk = with_scale(step, walks=False), with_scale(step, walks=True)
    assert once.cov[1, 1] ** 0.5 == pytest.approx(0.012)
    assert (20 * walk.cov[1, 1]) ** 0.5 == pytest.approx(0.24)
    for cov in (once.cov, walk.cov):
        np.testing.assert_array_equal(cov[[0, 2]], 0.0)
    stands = with_scale(Gaussian(np.zeros(3), np.eye(3)), walks=True)
    np.testing.assert_array_equal(stands.cov, np.eye(3))


@pytest.mark.parametrize("kind", ["line", "slope"])
def test_people_who_walk_by_are_no_reason_to_doubt_the_wheels(kind: str) -> None:
    """In one image after another, most of the edges belong to someone who crosses the view while the robot turns."""
    drive = hours_of("crowd", 3, 0.5)
    robot = Localiser(drive.landmark_map, drive.camera, read_config(None, [f"observation.kind={kind}"]), 0)
    robot.start(drive.truth[0], np.diag([0.1, 0.1, np.radians(3.0)]) ** 2, int(drive.t_ns[0]))
    frames = [frame for frame, _ in located(robot, drive)]
    error = np.array([frame.located.estimate.pose for frame in frames]) - drive.truth
    assert np.hypot(*error[:, :2].T).max() < 0.25  # 0.74 m where one image may decide
    assert sum(frame.located.wheels_are_wrong for frame in frames) <= 1
