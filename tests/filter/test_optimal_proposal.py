"""Particles that are moved to where the edges say: exact weights, and hardly any of them lost."""

from dataclasses import replace

import numpy as np
import pytest
from simulated_edges import simulated_edges

from localiser.camera import Camera, Mount
from localiser.edges import Edges
from localiser.filter import optimal_proposal
from localiser.filter.optimal_proposal import OptimalProposal, drawn, flattened, step_density
from localiser.geometry import Increment, Trajectory
from localiser.landmarks import LandmarkMap, in_camera
from localiser.motion import MotionParameters
from localiser.observation import EdgeObservation, Frame, ObservationParameters, Sighting, Targets
from localiser.particles import effective_sample_size, from_gaussian, normalised, take

MOUNT = Mount(tilt_rad=np.radians(20), height_m=1.0, right_m=0.05, back_m=-0.1, yaw_rad=0.02)
CAMERA = Camera(640, 480, 554.0, 554.0, 319.5, 239.5, mount=MOUNT)
POINTS = np.array([[-1.2, -3.0], [0.4, -4.0], [1.5, -3.5]])
MAP = LandmarkMap.from_points(POINTS, bottom_m=np.zeros(3), top_m=np.full(3, 2.0))
MOVE = Increment.from_mean([0.0, -0.2, 0.05])
MOTION = MotionParameters()


def observation(kind="line", known=True):
    parameters = ObservationParameters(kind=kind, landmark_sigma_m=0.0, association="known" if known else "unknown")
    return EdgeObservation(CAMERA, parameters)


def cloud(count=2000, seed=0, sigma=0.02):
    return from_gaussian(np.zeros(3), np.diag([sigma, sigma, sigma]) ** 2, count, np.random.default_rng(seed))


def edges_at(pose, seed=1):
    return simulated_edges(MAP, CAMERA, Trajectory(np.array([0]), np.array([pose])), np.random.default_rng(seed))[0]


def expected_angles(poses, kind):
    """Return what `step_density` linearises, (N, K), by the plain functions."""
    right, ahead = in_camera(CAMERA.pose_in_map(np.column_stack(poses)), POINTS)
    return Frame(Edges.none(), CAMERA, ObservationParameters(kind=kind)).predicted(right / ahead)[0]


@pytest.mark.parametrize("off_rad", [[0.01, 0.01, 0.01], [0.7, -1.2, 2.4]])
@pytest.mark.parametrize("kind", ["line", "slope"])
def test_the_loop_does_what_arrays_and_differences_do(kind, off_rad):
    step = MOTION.expected_step(cloud(20), MOVE)
    sigma = np.array([0.01, 0.02, 0.03])
    angle = expected_angles(step.poses, kind).mean(axis=0) + off_rad
    targets = Targets(POINTS, angle, sigma**2, kind == "slope")
    root, explained, log_evidence = step_density(step, CAMERA, targets, 0.5)
    shift = 1e-6
    gradient = np.stack(
        [
            (expected_angles(step.poses + shift * step.axes[:, k], kind) - expected_angles(step.poses, kind)) / shift
            for k in range(3)
        ],
        axis=-1,
    )  # (N, K, 3)
    residual = angle - expected_angles(step.poses, kind)
    weight = 0.5 / sigma**2
    information = np.eye(3) + np.einsum("k,nki,nkj->nij", weight, gradient, gradient)
    towards = np.einsum("k,nki,nk->ni", weight, gradient, residual)
    lower = np.zeros((20, 3, 3))
    for row, (i, j) in enumerate([(0, 0), (1, 0), (1, 1), (2, 0), (2, 1), (2, 2)]):
        lower[:, i, j] = root[row]
    assert lower @ np.swapaxes(lower, 1, 2) == pytest.approx(information, rel=1e-4)
    assert np.einsum("nij,jn->ni", lower, explained) == pytest.approx(towards, rel=1e-4, abs=1e-3)
    # ψ is the logarithm of a normal density's integral: log N(r; 0, I/w + G Gᵀ) up to what all particles share.
    for n in range(20):
        spread = np.diag(1 / weight) + gradient[n] @ gradient[n].T
        whole = -0.5 * residual[n] @ np.linalg.solve(spread, residual[n]) - 0.5 * np.linalg.slogdet(spread)[1]
        assert log_evidence[n] == pytest.approx(whole + 0.5 * np.log(1 / weight).sum(), abs=1e-3)


def test_weights_take_back_where_steps_were_drawn():
    """Whatever edges say, weighted steps are standard normal, as if they had been drawn blindly."""
    step = MOTION.expected_step(take(cloud(1), np.zeros(200_000, dtype=np.int64)), MOVE)
    angle = expected_angles(step.poses[:, :1], "line")[0] + 0.02
    targets = Targets(POINTS, angle, np.full(3, 0.02**2), False)
    normal, log_ratio = drawn(*step_density(step, CAMERA, targets, 1.0)[:2], np.random.default_rng(3))
    weight = normalised(log_ratio)
    assert log_ratio.max() <= -np.log(optimal_proposal.BLIND) + 1e-9
    error = 5 / np.sqrt(effective_sample_size(weight))
    assert normal @ weight == pytest.approx(np.zeros(3), abs=error)
    assert (normal * weight) @ normal.T == pytest.approx(np.eye(3), abs=2 * error)
    assert abs(np.average(normal[2])) > 10 * error  # drawn elsewhere than blindly


def test_nothing_told_moves_particles_blindly():
    nothing = Targets(np.zeros((0, 2)), np.zeros(0), np.zeros(0), False)
    step = MOTION.expected_step(cloud(), MOVE)
    moved = OptimalProposal(CAMERA, nothing, 1.0, 0.3, 0.5).moved(cloud(), step, MOVE, MOTION, np.random.default_rng(0))
    assert np.ptp(moved.log_weight) < 1e-12
    blind = MOTION.predict(cloud(), MOVE, np.random.default_rng(0))
    assert moved.columns.tobytes() == blind.columns.tobytes()


@pytest.mark.parametrize("kind", ["line", "slope"])
def test_posterior_is_that_of_blind_moves_with_far_more_of_the_particles(kind):
    rng = np.random.default_rng(5)
    truth = MOTION.predict(cloud(1, seed=8), MOVE, rng).poses[0]
    edges, one = edges_at(truth), observation(kind)
    posterior, effective = [], []
    for guided, count in ((True, 4000), (False, 400_000)):
        before = cloud(count, seed=6)
        if guided:
            step = MOTION.expected_step(before, MOVE)
            ahead = MOTION.predict(take(before, np.arange(500)), MOVE, rng).estimate
            targets = one.associate(ahead.pose, Sighting(0, edges), MAP, ahead.cov).targets(0.9)
            moved = OptimalProposal(CAMERA, targets, 1.0, 0.3, 0.5).moved(before, step, MOVE, MOTION, rng)
        else:
            moved = MOTION.predict(before, MOVE, rng)
        weighed = replace(moved, log_weight=moved.log_weight + one.log_likelihood(moved, Sighting(0, edges), MAP))
        posterior.append(weighed.estimate)
        effective.append(effective_sample_size(weighed.weight) / count)
    found, oracle = posterior
    sigma = np.sqrt(np.diag(oracle.cov))
    # Resampled stages count for less than effective samples: within a tenth of a sigma, a fifth of the covariance.
    assert (found.mean - oracle.mean) / sigma == pytest.approx(np.zeros(3), abs=0.15)
    assert found.cov / np.outer(sigma, sigma) == pytest.approx(oracle.cov / np.outer(sigma, sigma), abs=0.25)
    assert effective[0] > 0.4
    assert effective[0] > 3 * effective[1]


def test_only_edges_of_landmarks_in_no_doubt_are_targets():
    truth = np.array([0.02, -0.2, 0.05])
    edges, one = edges_at(truth), observation(known=False)
    order = np.argsort(edges.landmark_id)
    near = one.associate(np.zeros(3), Sighting(0, edges_at(np.zeros(3))), MAP, 1e-4 * np.eye(3)).targets(0.8)
    assert near.points == pytest.approx(POINTS[edges.landmark_id[order]])
    # Neither where which is which cannot be told, nor where nearly all edges are clutter.
    for sigma, rate in ((0.3, 0.8), (0.01, 0.02)):
        none = one.associate(np.zeros(3), Sighting(0, edges), MAP, sigma**2 * np.eye(3)).targets(rate)
        assert len(none.angle) == 0
    # Two landmarks side by side: neither may claim the edge.
    points = np.vstack([POINTS, POINTS[1] + [0.03, 0.0]])
    twins = LandmarkMap.from_points(points, bottom_m=np.zeros(4), top_m=np.full(4, 2.0))
    kept = one.associate(np.zeros(3), Sighting(0, edges_at(np.zeros(3))), twins, 1e-4 * np.eye(3)).targets(0.8).points
    assert sorted(kept[:, 0]) == pytest.approx([-1.2, 1.5])


def test_weights_take_back_stages_that_were_cut_short(monkeypatch):
    """Without being weighed by the edges, guided particles stand for where blind ones are."""
    monkeypatch.setattr(optimal_proposal, "MOST_STAGES", 1)
    angle = expected_angles(MOTION.expected_step(cloud(1, sigma=0.0), MOVE).poses, "line")[0] + 0.03
    targets = Targets(POINTS, angle, np.full(3, 0.08**2), False)
    before = cloud(50_000, sigma=0.05)
    guided = OptimalProposal(CAMERA, targets, 1.0, 0.3, 0.99).moved(
        before, MOTION.expected_step(before, MOVE), MOVE, MOTION, np.random.default_rng(0)
    )
    found = guided.estimate
    blind = MOTION.predict(cloud(50_000, sigma=0.05), MOVE, np.random.default_rng(1)).estimate
    sigma = np.sqrt(np.diag(blind.cov))
    assert (found.mean - blind.mean) / sigma == pytest.approx(np.zeros(3), abs=0.1)
    assert np.sqrt(np.diag(found.cov)) / sigma == pytest.approx(np.ones(3), abs=0.1)


def test_a_share_of_the_mean_keeps_particles_that_edges_do_not_like():
    log_evidence = np.array([0.0, -1000.0])
    flat = flattened(log_evidence, np.zeros(2))
    assert normalised(flat)[1] == pytest.approx(optimal_proposal.BLIND / 2, rel=1e-6)
