"""The quick score and the indices behind it, against plain counting."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from proposal_room import CAMERA, drawn_frames, room

from localiser.landmarks import field_of_view_rad, half_view_rad, image_heights, in_camera
from localiser.relocalisation import Places, view_of
from localiser.relocalisation.evidence import arguments, evidence_of, score_poses
from localiser.relocalisation.evidence_kernel import score

ROOM = room()
PLACES = Places.of(ROOM, CAMERA)


@pytest.fixture(scope="module")
def evidence():
    _, frames = drawn_frames(ROOM, 1, seed=2, clutter=8)
    return evidence_of(view_of(CAMERA, frames[0]), 0.01)


@settings(max_examples=40)
@given(low=st.floats(-1, 9), width=st.floats(0, 2), first=st.integers(0, 39), second=st.integers(0, 39))
def test_pairs_are_found_by_class_and_distance(low, width, first, second):
    group = np.searchsorted(PLACES.class_m, PLACES.bottom_m - 0.0251)
    wanted = group[first] * len(PLACES.class_m) + group[second]
    start, stop = PLACES.pairs_between(np.array([wanted]), np.array([low]), np.array([low + width]))
    found = {tuple(pair) for pair in PLACES.pair[start[0] : stop[0]]}
    gap = np.hypot(*(PLACES.points[:, None] - PLACES.points[None]).T).T
    code = group[:, None] * len(PLACES.class_m) + group[None, :]
    inside = (gap >= low) & (gap <= low + width) & (gap > 1e-3) & (gap <= 2 * PLACES.sight.range_max_m)
    assert found == {tuple(pair) for pair in np.argwhere(inside & (code == wanted))}


def plain_score(evidence, poses):
    """The score of `evidence`'s docstring, each landmark given to the edge that fits it best, without tables."""
    view, camera = evidence.view, evidence.view.camera
    span, (_, _, e_low, e_high) = field_of_view_rad(camera), camera.upright_bounds
    sigma_b, sigma_e = np.hypot(view.bearing_sigma, 0.01), np.hypot(view.foot_sigma, 0.01)
    right, ahead = in_camera(camera.pose_in_map(poses), PLACES.points)
    scores = []
    for across, forward in zip(right, ahead, strict=True):
        explained, in_view = np.zeros(len(view)), 0
        for k in range(len(PLACES)):
            if forward[k] <= 0 or abs(np.arctan2(across[k], forward[k])) > half_view_rad(camera):
                continue
            foot, top = image_heights(camera, forward[k], PLACES.bottom_m[k], PLACES.top_m[k])
            if not 0.2 <= np.hypot(across[k], forward[k]) <= 12 or top < e_low or foot > e_high:
                continue
            in_view += 1
            b = np.arctan2(across[k], forward[k])
            fit = span * np.exp(-0.5 * ((b - view.bearing) / sigma_b) ** 2) / np.sqrt(2 * np.pi) / sigma_b
            at_foot = np.exp(-0.5 * ((foot - view.foot) / sigma_e) ** 2) / np.sqrt(2 * np.pi) / sigma_e
            hanging = 0.5 * at_foot * (e_high - e_low) + np.where(foot < view.foot + sigma_e, 0.5, 0.05)
            cut = np.where(foot < e_low, 1.0, np.where(foot < view.foot + 2 * sigma_e, 0.5, 0.05))
            fit = fit * np.where(view.cut, cut, hanging)
            explained[fit.argmax()] += fit.max()
        scores.append(np.log(0.5 + 0.5 * explained / max(in_view, 1)).sum())
    return np.array(scores)


def test_score_is_that_of_the_plain_formula(evidence):
    """Apart from the cells of the table, which matter most where a term is small and steep."""
    truth, _ = drawn_frames(ROOM, 1, seed=2, clutter=8)
    rng = np.random.default_rng(0)
    poses = np.concatenate([truth + rng.normal(0, [0.02, 0.02, 0.005], (30, 3)), drawn_frames(ROOM, 60, seed=3)[0]])
    ours, plain = score_poses(evidence, PLACES, poses), plain_score(evidence, poses)
    assert np.abs(ours - plain).max() < 2.0
    assert np.corrcoef(ours, plain)[0, 1] > 0.995
    assert np.median(plain[:30]) > plain[30:].max()  # the formula itself tells right from wrong


def test_compiled_score_is_that_of_the_loops(evidence):
    poses = drawn_frames(ROOM, 40, seed=4)[0]
    loop = getattr(score, "py_func", score)
    expected = loop(*arguments(evidence, PLACES, poses))
    np.testing.assert_allclose(score_poses(evidence, PLACES, poses), expected, rtol=1e-9, atol=1e-9)


def test_poses_off_the_map_explain_nothing(evidence):
    """All edges are clutter then, as they are to poses that look away from all landmarks."""
    nowhere = np.array([[100.0, 0.0, 0.0], [0.0, -100.0, 1.0]])
    np.testing.assert_allclose(score_poses(evidence, PLACES, nowhere), len(evidence.view) * np.log(0.5))
