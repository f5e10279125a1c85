"""Where the robot may be, from one frame and nothing else."""

from __future__ import annotations

import numpy as np
import pytest
from floor_points import floor_points
from proposal_room import CAMERA, drawn_frames, room

from localiser.edges import Edges
from localiser.geometry import wrap_angle
from localiser.landmarks import LandmarkMap
from localiser.observation import EdgeObservation, ObservationParameters, Sighting
from localiser.particles import POSE, Particles, effective_sample_size, normalised
from localiser.relocalisation import Places, ProposalParameters, propose, view_of, warm_up
from localiser.relocalisation.refine import refined

ROOM = room()
PLACES = Places.of(ROOM, CAMERA)
QUICK = ProposalParameters(hypotheses=8000, refined=60)


def likelihood(edges, landmark_map, kind="line"):
    observation = EdgeObservation(CAMERA, ObservationParameters(kind=kind))
    return lambda poses: observation.log_likelihood(
        Particles(POSE, poses.T, np.zeros(len(poses))), Sighting(0, edges), landmark_map
    )


def beside(poses, pose, metres=0.25, degrees=5.0):
    near = np.hypot(*(poses[:, :2] - pose[:2]).T) < metres
    return near & (np.abs(wrap_angle(poses[:, 2] - pose[2])) < np.radians(degrees))


@pytest.mark.parametrize(("kind", "clutter", "least"), [("line", 0, 0.9), ("line", 15, 0.8), ("slope", 5, 0.6)])
def test_one_frame_proposes_the_true_pose(kind, clutter, least):
    """Of 25 random poses from which at least six landmarks are measured."""
    hits = []
    for pose, edges in zip(*drawn_frames(ROOM, 90, seed=1, clutter=clutter), strict=True):
        if (edges.landmark_id >= 0).sum() >= 6 and len(hits) < 25:
            view = view_of(CAMERA, edges, kind)
            found = propose(view, PLACES, likelihood(edges, ROOM, kind), np.random.default_rng(0), QUICK)
            hits.append(beside(found.mean, pose).any())
    assert len(hits) == 25
    assert np.mean(hits) >= least


def test_draws_are_many_where_the_posterior_is_and_their_weights_say_the_truth():
    """With ten edges and no clutter, the posterior lies at the true pose, and 2 % of the draws are effective.

    Of even draws over this room and all headings, one in a hundred million would be.
    """
    effective = []
    for pose, edges in zip(*drawn_frames(ROOM, 60, seed=5), strict=True):
        if len(edges) >= 10:
            score, rng = likelihood(edges, ROOM), np.random.default_rng(1)
            poses, log_weight = propose(view_of(CAMERA, edges), PLACES, score, rng, QUICK).drawn(4000, rng)
            weight = normalised(log_weight + score(poses))
            assert weight[beside(poses, pose)].sum() > 0.9
            assert np.hypot(*(weight @ poses[:, :2] - pose[:2])) < 0.05
            effective.append(effective_sample_size(weight) / len(weight))
    assert len(effective) >= 10
    assert np.median(effective) > 0.04
    assert min(effective) > 0.015  # the ends of edges, of which proposals know little, sharpen the posterior


def test_refinement_leads_to_the_truth_with_its_covariance():
    """From 5 cm and 1° off, without clutter: three errors of four are within the 75 % ellipsoid."""
    rng = np.random.default_rng(3)
    nees = []
    for pose, edges in zip(*drawn_frames(ROOM, 120, seed=6), strict=True):
        if len(edges) >= 7:
            start = pose + rng.normal(0, [0.05, 0.05, np.radians(1)])
            mean, cov = refined(view_of(CAMERA, edges), PLACES, start[None])
            error = mean[0] - pose
            error[2] = wrap_angle(error[2])
            nees.append(error @ np.linalg.solve(cov[0], error))
    assert len(nees) >= 15
    # Better than that: the edges of a simulation stand exactly where the map says, and the window is wider than they.
    assert np.mean(np.array(nees) < 4.1) >= 0.75


def test_bearings_alone_propose_the_pose():
    """No heights on the map, no ends measured: triples of bearings."""
    bare = LandmarkMap.from_points(room(14, seed=4).points)
    places = Places.of(bare, CAMERA)
    hits = []
    for pose, edges in zip(*drawn_frames(bare, 60, seed=7), strict=True):
        edges.ends_px[:] = np.nan
        if len(edges) >= 5:
            found = propose(view_of(CAMERA, edges), places, likelihood(edges, bare), np.random.default_rng(0))
            hits.append(beside(found.mean, pose).any())
    assert len(hits) >= 5
    assert np.mean(hits) >= 0.8


@pytest.mark.parametrize("count", [0, 1, 4])
def test_few_edges_are_left_to_even_draws(count):
    _, frames = drawn_frames(ROOM, 1, seed=8, clutter=10)
    edges = frames[0].take(np.arange(count))
    found = propose(view_of(CAMERA, edges), PLACES, likelihood(edges, ROOM), np.random.default_rng(0))
    assert len(found) == 0
    assert found.even == 1.0


def test_the_same_seed_proposes_the_same():
    _, frames = drawn_frames(ROOM, 1, seed=9, clutter=10)
    view, score = view_of(CAMERA, frames[0]), likelihood(frames[0], ROOM)
    one, other = (propose(view, PLACES, score, np.random.default_rng(7), QUICK) for _ in range(2))
    np.testing.assert_array_equal(one.mean, other.mean)
    np.testing.assert_array_equal(one.log_weight, other.log_weight)


def test_a_map_of_one_landmark_is_left_to_even_draws():
    lonely = LandmarkMap.from_points(np.zeros((1, 2)))
    _, frames = drawn_frames(ROOM, 1, seed=9, clutter=10)
    score = likelihood(frames[0], lonely)
    found = propose(view_of(CAMERA, frames[0]), Places.of(lonely, CAMERA), score, np.random.default_rng(0))
    assert len(found) == 0


def test_a_floor_range_says_the_same_as_the_end_that_it_was_measured_from():
    """Edges of something that reports the range of their feet and no ends."""
    _, frames = drawn_frames(ROOM, 60, seed=5)
    edges = next(edges for edges in frames if len(edges) >= 12)
    view = view_of(CAMERA, edges)
    foot_px = np.take_along_axis(edges.ends_px, edges.ends_px[..., 1].argmax(axis=1)[:, None, None], axis=1)[:, 0]
    range_m = np.linalg.norm(floor_points(CAMERA, foot_px), axis=-1)
    bare = Edges.from_columns(edges.bearing, edges.bearing_sigma, edges.lean, edges.lean_sigma, foot_range_m=range_m)
    seen = np.isfinite(view_of(CAMERA, bare).foot)
    assert seen.sum() >= 8
    # The end itself errs across the edge, not along the bearing, by half a pixel.
    np.testing.assert_allclose(view_of(CAMERA, bare).foot[seen], view.foot[seen], atol=2e-3)


def test_warming_up_needs_no_edges():
    warm_up(view_of(CAMERA, Edges.none()), PLACES)
