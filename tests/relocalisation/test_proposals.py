"""Where the robot may be, from one frame and nothing else."""

from __future__ import annotations

import numpy as np
import pytest
from proposal_room import CAMERA, drawn_frames, room

from localiser import geometry
from localiser.edges import Edges
from localiser.geometry import wrap_angle
from localiser.landmarks import LandmarkMap
from localiser.observation import EdgeObservation, ObservationParameters, Sighting
from localiser.particles import POSE, Particles, effective_sample_size, normalised
from localiser.relocalisation import Places, ProposalParameters, propose, view_of, warm_up
from localiser.relocalisation.refine import refined
from localiser.simulate import EdgeNoise, simulated_edges

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
            found = propose([view], PLACES, likelihood(edges, ROOM, kind), np.random.default_rng(0), QUICK)
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
            poses, log_weight = propose([view_of(CAMERA, edges)], PLACES, score, rng, QUICK).drawn(4000, rng)
            weight = normalised(log_weight + score(poses))
            assert weight[beside(poses, pose)].sum() > 0.9
            assert np.hypot(*(weight @ poses[:, :2] - pose[:2])) < 0.05
            effective.append(effective_sample_size(weight) / len(weight))
    assert len(effective) >= 10
    assert np.median(effective) > 0.05
    assert min(effective) > 0.015  # the ends of edges, of which proposals know little, sharpen the posterior


def test_refinement_leads_to_the_truth_with_its_covariance():
    """From 5 cm and 1° off, without clutter: three errors of four are within the 75 % ellipsoid."""
    rng = np.random.default_rng(3)
    nees = []
    for pose, edges in zip(*drawn_frames(ROOM, 120, seed=6), strict=True):
        if len(edges) >= 7:
            start = pose + rng.normal(0, [0.05, 0.05, np.radians(1)])
            mean, cov = refined([view_of(CAMERA, edges)], PLACES, start[None])
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
            found = propose([view_of(CAMERA, edges)], places, likelihood(edges, bare), np.random.default_rng(0))
            hits.append(beside(found.mean, pose).any())
    assert len(hits) >= 5
    assert np.mean(hits) >= 0.8


def test_earlier_views_help_where_the_present_one_shows_little():
    """Two bearings now and some before a turn, carried forward by odometry."""
    bare = LandmarkMap.from_points(room(14, seed=4).points)
    places = Places.of(bare, CAMERA)
    motion = np.array([0.05, -0.3, np.radians(40.0)])
    before, frames = drawn_frames(bare, 60, seed=7)
    now = geometry.compose(before, motion)
    hits = []
    for pose, earlier, index in zip(now, frames, range(60), strict=True):
        present = _seen_from(bare, pose, index)
        if len(present) >= 2 and len(earlier) >= 4:
            present = present.take(np.arange(2))
            for edges in (earlier, present):
                edges.ends_px[:] = np.nan
            views = [view_of(CAMERA, present), view_of(CAMERA, earlier, motion=motion, motion_cov=np.zeros((3, 3)))]
            back = geometry.between(motion, np.zeros(3))
            then, here = likelihood(earlier, bare), likelihood(present, bare)

            def both(poses, then=then, here=here, back=back):
                return here(poses) + then(geometry.compose(poses, back))

            found = propose(views, places, both, np.random.default_rng(0))
            hits.append(beside(found.mean, pose).any())
    assert len(hits) >= 5
    assert np.mean(hits) >= 0.7


def _seen_from(landmark_map, pose, seed):
    track = geometry.Trajectory(np.zeros(1, dtype=np.int64), pose[None])
    return simulated_edges(landmark_map, CAMERA, track, np.random.default_rng(seed), noise=EdgeNoise())[0]


@pytest.mark.parametrize("count", [0, 1, 4])
def test_few_edges_are_left_to_even_draws(count):
    _, frames = drawn_frames(ROOM, 1, seed=8, clutter=10)
    edges = frames[0].take(np.arange(count))
    found = propose([view_of(CAMERA, edges)], PLACES, likelihood(edges, ROOM), np.random.default_rng(0))
    assert len(found) == 0
    assert found.even == 1.0


def test_the_same_seed_proposes_the_same():
    _, frames = drawn_frames(ROOM, 1, seed=9, clutter=10)
    view, score = view_of(CAMERA, frames[0]), likelihood(frames[0], ROOM)
    one, other = (propose([view], PLACES, score, np.random.default_rng(7), QUICK) for _ in range(2))
    np.testing.assert_array_equal(one.mean, other.mean)
    np.testing.assert_array_equal(one.log_weight, other.log_weight)


def test_a_map_of_one_landmark_is_left_to_even_draws():
    lonely = LandmarkMap.from_points(np.zeros((1, 2)))
    _, frames = drawn_frames(ROOM, 1, seed=9, clutter=10)
    score = likelihood(frames[0], lonely)
    found = propose([view_of(CAMERA, frames[0])], Places.of(lonely, CAMERA), score, np.random.default_rng(0))
    assert len(found) == 0


def test_a_present_image_without_edges_leaves_the_word_to_an_earlier_one():
    pose, frames = drawn_frames(ROOM, 60, seed=5)
    index = next(k for k, edges in enumerate(frames) if len(edges) >= 12)
    motion = np.array([0.0, -0.2, 0.1])
    views = [view_of(CAMERA, Edges.none()), view_of(CAMERA, frames[index], motion=motion)]
    then = likelihood(frames[index], ROOM)
    back = geometry.between(motion, np.zeros(3))
    found = propose(views, PLACES, lambda poses: then(geometry.compose(poses, back)), np.random.default_rng(0), QUICK)
    assert beside(found.mean, geometry.compose(pose[index], motion)).any()


def test_a_floor_range_says_the_same_as_the_end_that_it_was_measured_from():
    """Edges of something that reports the range of their feet and no ends."""
    _, frames = drawn_frames(ROOM, 60, seed=5)
    edges = next(edges for edges in frames if len(edges) >= 12)
    view = view_of(CAMERA, edges)
    foot_px = np.take_along_axis(edges.ends_px, edges.ends_px[..., 1].argmax(axis=1)[:, None, None], axis=1)[:, 0]
    range_m = np.linalg.norm(CAMERA.floor_points(foot_px), axis=-1)
    bare = Edges.from_columns(edges.bearing, edges.bearing_sigma, edges.lean, edges.lean_sigma, foot_range_m=range_m)
    seen = np.isfinite(view_of(CAMERA, bare).foot)
    assert seen.sum() >= 8
    # The end itself errs across the edge, not along the bearing, by half a pixel.
    np.testing.assert_allclose(view_of(CAMERA, bare).foot[seen], view.foot[seen], atol=2e-3)


def test_warming_up_needs_no_edges():
    warm_up(view_of(CAMERA, Edges.none()), PLACES)
