"""Errors of places that images from one direction share; sparse least squares."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.sparse import csc_array

from localiser.camera import Camera, Mount
from localiser.edges import Edges
from localiser.geometry import Array, wrap_angle
from localiser.mapping import Built, Sightings
from localiser.mapping.landmarks import fit_landmarks
from localiser.mapping.quality import place_cov
from localiser.mapping.sightings import direction_of, per_point
from localiser.mapping.sparse import Block, Factor, Linearised

CAMERA = Camera(640, 480, 554.0, 554.0, 319.5, 239.5, Mount(np.deg2rad(20.0), 0.9))
POINTS = np.array([[0.0, -3.0], [0.4, -2.0]])
SIGMA_RAD, PLACE_M, CORRELATED_RAD = 1e-4, 0.006, np.pi / 4


def arc(reach_rad: float, frames: int = 30) -> Array:
    """Return cameras (T, 3) around (0, -3), 3 m away, that look at it, over an angle."""
    heading = np.linspace(-reach_rad / 2, reach_rad / 2, frames)
    return np.column_stack([3 * np.sin(heading), -3 + 3 * np.cos(heading), heading])


def wandering(heading: Array, rng: np.random.Generator) -> Array:
    """Return errors (K,) m across the line of sight of edges that are seen along headings (K,)."""
    apart = np.abs(wrap_angle(heading[:, None] - heading[None]))
    return (
        PLACE_M
        * np.linalg.cholesky(np.exp(-apart / CORRELATED_RAD) + 1e-9 * np.eye(len(heading)))
        @ rng.normal(size=len(heading))
    )


def built(cameras: Array, rng: np.random.Generator | None) -> tuple[Sightings, Built, Array]:
    """Return landmarks that are seen from all cameras (T, 3), their places off by the direction of view."""
    frames = []
    off = np.zeros((len(POINTS), len(cameras)))
    for landmark, point in enumerate(POINTS):
        heading, range_m = direction_of(np.tile(point, (len(cameras), 1)), cameras)
        if rng is not None:
            off[landmark] = wandering(heading, rng) / range_m
    for frame, camera in enumerate(cameras):
        heading, _ = direction_of(POINTS, np.tile(camera, (len(POINTS), 1)))
        bearing = wrap_angle(camera[2] - heading - off[:, frame])
        known = np.full(len(POINTS), SIGMA_RAD)
        frames.append(Edges.from_columns(bearing, known, np.zeros(len(POINTS)), known))
    sightings = Sightings.from_edges(frames, CAMERA)
    sigma = np.full(len(sightings), SIGMA_RAD)
    return sightings, fit_landmarks(sightings, np.tile(np.arange(len(POINTS)), len(cameras)), cameras, sigma), sigma


def test_it_is_the_double_sum_over_all_pairs_of_bearings() -> None:
    cameras = arc(np.deg2rad(50))[np.random.default_rng(0).permutation(30)]
    sightings, made, sigma = built(cameras, np.random.default_rng(1))
    found = place_cov(sightings, made, cameras, sigma, PLACE_M)
    for landmark in range(len(POINTS)):
        own = made.of == landmark
        seen_from = cameras[sightings.frame[own]]
        at = np.tile(made.fit.points[landmark], (own.sum(), 1))
        heading, range_m = direction_of(at, seen_from)
        pull = per_point(at, seen_from) * (made.fit.weight[own] / sigma[own] ** 2 * PLACE_M / range_m)[:, None]
        apart = np.abs(wrap_angle(heading[:, None] - heading[None]))
        cov = made.fit.cov[landmark]
        expected = cov @ pull.T @ np.exp(-apart / CORRELATED_RAD) @ pull @ cov
        np.testing.assert_allclose(found[landmark], expected, rtol=1e-6)


@pytest.mark.parametrize("reach_deg", [10.0, 90.0])
def test_landmarks_whose_edges_wander_err_as_it_says(reach_deg: float) -> None:
    cameras, nees = arc(np.deg2rad(reach_deg)), []
    rng = np.random.default_rng(2)
    for _ in range(60):
        sightings, made, sigma = built(cameras, rng)
        cov = place_cov(sightings, made, cameras, sigma, PLACE_M) + made.fit.cov
        off = made.fit.points - POINTS
        nees.append(np.einsum("li,lij,lj->l", off, np.linalg.inv(cov), off))
    assert 1.4 < np.mean(nees) < 2.8


def test_a_landmark_is_not_less_certain_for_poses_that_are_unknown() -> None:
    """What the poses add to a landmark's covariance says nothing of how its bearings weigh against each other."""
    cameras = arc(np.deg2rad(60))
    sightings, made, sigma = built(cameras, None)
    drifted = replace(made, fit=replace(made.fit, information=np.linalg.inv(made.fit.cov + 0.01 * np.eye(2))))
    found, expected = (place_cov(sightings, one, cameras, sigma, PLACE_M) for one in (drifted, made))
    np.testing.assert_array_equal(found, expected)
    assert np.sqrt(np.linalg.eigvalsh(found).max()) < 5 * PLACE_M


def some_blocks(size: int, count: int, most: int, seed: int) -> list[Block]:
    """Return measurements of `most` variables each, some of them fixed, that tell something of every variable."""
    rng = np.random.default_rng(seed)
    column = np.array([rng.permutation(np.arange(-1, size))[:most] for _ in range(count)], dtype=np.int64)
    several = Block(
        column.reshape(count, most),
        rng.standard_normal((count, most)),
        rng.standard_normal(count),
        rng.uniform(0.1, 1.0, count),
    )
    single = Block(np.arange(size)[:, None], rng.uniform(0.5, 2.0, (size, 1)), rng.standard_normal(size), np.ones(size))
    return [several, single]


def dense(blocks: list[Block], size: int) -> tuple[Array, Array]:
    """Return JᵀWJ (V, V) and JᵀWr (V,)."""
    rows = []
    for block in blocks:
        jacobian = np.zeros((len(block.residual), size + 1))
        jacobian[np.arange(len(jacobian))[:, None], block.column] = block.value  # what is fixed goes to the last column
        rows.append((jacobian[:, :size], block.residual, block.weight))
    jacobian, residual, weight = (np.concatenate(part) for part in zip(*rows, strict=True))
    return jacobian.T @ (weight[:, None] * jacobian), jacobian.T @ (weight * residual)


@pytest.mark.parametrize(("size", "count", "most"), [(1, 0, 1), (2, 3, 2), (40, 0, 1), (40, 30, 3), (40, 60, 40)])
def test_the_solution_is_that_of_dense_algebra(size: int, count: int, most: int) -> None:
    blocks, factor = some_blocks(size, count, most, seed=size), Factor()
    upper, right = Linearised(blocks, size).normal()
    matrix, gradient = dense(blocks, size)
    np.testing.assert_allclose(upper.toarray(), np.triu(matrix), atol=1e-12)
    np.testing.assert_allclose(right, gradient, atol=1e-12)
    factor.update(upper)
    np.testing.assert_allclose(factor.solve(right), np.linalg.solve(matrix, gradient), rtol=1e-6)
    factor.update(upper, damping=0.5)
    damped = matrix + 0.5 * np.diag(np.diagonal(matrix))
    np.testing.assert_allclose(factor.solve(right), np.linalg.solve(damped, gradient), rtol=1e-6)


@pytest.mark.parametrize("count", [50, 20])
def test_a_factor_serves_other_matrices_whether_or_not_values_are_at_the_same_places(count: int) -> None:
    first, other, factor = some_blocks(60, 50, 4, seed=3), some_blocks(60, count, 4, seed=3 + (count < 50)), Factor()
    other[0].value[:] = 2 * other[0].value + 0.1
    factor.update(Linearised(first, 60).normal()[0])
    upper, right = Linearised(other, 60).normal()
    factor.update(upper)
    np.testing.assert_allclose(factor.solve(right), np.linalg.solve(*dense(other, 60)), rtol=1e-6)


@pytest.mark.parametrize("pairs", [0, 1, 600])
def test_the_inverse_between_sparse_columns_is_that_of_dense_algebra(pairs: int) -> None:
    blocks, rng, factor = some_blocks(50, 40, 4, seed=7), np.random.default_rng(8), Factor()
    columns = np.where(rng.random((50, 2 * pairs)) < 0.1, rng.standard_normal((50, 2 * pairs)), 0.0)
    factor.update(Linearised(blocks, 50).normal()[0])
    of_pair = columns.T.reshape(pairs, 2, 50)
    expected = of_pair @ np.linalg.inv(dense(blocks, 50)[0]) @ of_pair.transpose(0, 2, 1)
    np.testing.assert_allclose(factor.projected(csc_array(columns)), expected, rtol=1e-6, atol=1e-9)
    whole = columns.T @ np.linalg.inv(dense(blocks, 50)[0]) @ columns
    np.testing.assert_allclose(factor.joint(csc_array(columns)), whole, rtol=1e-6, atol=1e-9)
