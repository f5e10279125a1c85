"""How surely an edge is a vertical one."""

from __future__ import annotations

import numpy as np
import pytest
from edge_images import camera_of, wall_image

from localiser.edges import EdgeParameters, Edges, find_edges
from localiser.edges.segments import Segments
from localiser.edges.verticality import REACH_RAD, vertical_probability

CAMERA = camera_of(tilt_deg=20.0)
MOUNT_RAD = np.deg2rad([0.5, 0.3])
PLUMB_RAD = np.deg2rad(0.3)
WALLS_DEG = np.linspace(-24, 24, 9)


def lines(bearings_deg, turned_deg=0.0, heights=(-0.25, 0.2)) -> np.ndarray:
    """Return the images (E, 2, 2) of vertical edges, each turned about its middle."""
    tangent, e = np.tan(np.deg2rad(np.atleast_1d(bearings_deg)))[:, None], np.array(heights)[None, :]
    tilt = CAMERA.mount.tilt_rad
    ends = CAMERA.pixels_from_upright(np.stack(np.broadcast_arrays(tangent * (np.cos(tilt) + e * np.sin(tilt)), e), -1))
    turn = np.broadcast_to(np.deg2rad(turned_deg), len(ends))
    middle = ends.mean(axis=1, keepdims=True)
    c, s = np.cos(turn), np.sin(turn)
    return middle + np.einsum("eij,ekj->eki", np.stack([np.stack([c, -s], -1), np.stack([s, c], -1)], 1), ends - middle)


def probability(ends_px, lean_sigma_deg=0.05, rejected_px=None) -> np.ndarray:
    sigma = np.broadcast_to(np.deg2rad(lean_sigma_deg), len(ends_px)).astype(float)
    edges = Edges.from_columns(np.zeros(len(ends_px)), sigma, np.zeros(len(ends_px)), sigma, ends_px=ends_px)
    rejected = np.zeros((0, 2, 2)) if rejected_px is None else rejected_px
    return vertical_probability(edges, Segments.of_ends(rejected, 0.5), CAMERA, MOUNT_RAD, PLUMB_RAD)


def test_no_edges():
    assert probability(np.zeros((0, 2, 2))).shape == (0,)


def test_the_further_a_slope_is_from_the_predicted_one_the_less_sure():
    walls, other = lines(WALLS_DEG), lines([-20.0, 3.0, 15.0], [9.0, -8.0, 6.0])
    found = [probability(np.concatenate([walls, lines(10.0, turn)]), rejected_px=other) for turn in (0, 0.3, 0.6, 1.0)]
    last = np.array([each[-1] for each in found])
    assert np.all(np.diff(last) < 0)
    assert last[0] > 0.9
    assert last[-1] < 0.2
    assert all(np.all(each[:-1] > 0.8) for each in found)


def test_a_vague_slope_is_as_likely_as_the_images_lines_are():
    walls, other = lines(WALLS_DEG), lines(WALLS_DEG, 5.0)
    sigma = np.append(np.full(len(walls), 0.05), 60.0)
    vague = probability(np.concatenate([walls, lines(10.0)]), sigma, rejected_px=other)[-1]
    sure = probability(np.concatenate([walls, lines(10.0)]), rejected_px=other)[-1]
    assert vague == pytest.approx(0.5, abs=0.1)
    assert sure > 0.9


def test_a_line_is_less_sure_in_an_image_full_of_slanted_lines():
    walls, doubtful = lines(WALLS_DEG), lines(10.0, 0.4)
    rng = np.random.default_rng(0)
    few, many = (lines(rng.uniform(-25, 25, n), rng.uniform(2, 7, n) * rng.choice([-1, 1], n)) for n in (2, 60))
    both = [probability(np.concatenate([walls, doubtful]), rejected_px=other)[-1] for other in (few, many)]
    assert both[0] > both[1] + 0.1


def test_among_lines_of_all_directions_the_probability_is_the_share_of_vertical_ones():
    """Half of all lines vertical, 0.3° from plumb, measured with 0.4°: of those said to be vertical with p, p are."""
    rng, said, true = np.random.default_rng(3), [], []
    for _ in range(120):
        is_vertical = rng.random(24) < 0.5
        off = np.where(is_vertical, 0.0, np.rad2deg(rng.uniform(-REACH_RAD, REACH_RAD, 24))) + rng.normal(0, 0.5, 24)
        ends = lines(rng.uniform(-25, 25, 24), off)
        kept = np.abs(off) < 2.0
        said += probability(ends[kept], 0.4, rejected_px=ends[~kept]).tolist()
        true += is_vertical[kept].tolist()
    for low, high in ((0.0, 0.75), (0.75, 0.9), (0.9, 1.0)):
        inside = (np.array(said) >= low) & (np.array(said) < high)
        assert inside.sum() > 50
        assert np.mean(np.array(said)[inside]) == pytest.approx(np.mean(np.array(true)[inside]), abs=0.15)


@pytest.mark.parametrize("detector", ["columns", "lsd", "hough"])
def test_walls_are_surely_vertical(detector):
    image = wall_image(CAMERA, [-21.0, -6.0, 4.0, 19.0], [60, 170, 90, 200, 110], noise_sigma=2.0)
    edges = find_edges(image, CAMERA, EdgeParameters(detector=detector), with_probabilities=True)
    assert len(edges) >= 4
    assert np.all((edges.vertical_probability > 0.9) & (edges.vertical_probability <= 1))
    assert find_edges(np.zeros_like(image), CAMERA, with_probabilities=True).vertical_probability.shape == (0,)
