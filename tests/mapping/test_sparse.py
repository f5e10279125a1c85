"""Sparse least squares of one pattern, against dense algebra; and the order of elimination, by how little fills in."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from localiser.geometry import Array
from localiser.mapping.dissection import dissected
from localiser.mapping.sightings import Index
from localiser.mapping.sparse import Pattern, Rows


def some_rows(size: int, count: int, most: int, seed: int) -> Rows:
    """Return rows of up to `most` variables each, some of them fixed, that tell something of every variable."""
    rng = np.random.default_rng(seed)
    columns = [rng.permutation(np.arange(-1, size))[: rng.integers(1, most + 1)] for _ in range(count)]
    columns += [np.array([index]) for index in range(size)]
    start = np.concatenate([[0], np.cumsum([len(column) for column in columns])])
    value, residual = rng.standard_normal(start[-1]), rng.standard_normal(len(columns))
    return Rows(start, np.concatenate(columns), value, residual, rng.uniform(0.1, 1.0, len(columns)))


def dense(rows: Rows, size: int) -> tuple[Array, Array]:
    """Return JᵀWJ (V, V) and JᵀWr (V,)."""
    jacobian = np.zeros((len(rows.residual), size + 1))
    row = np.repeat(np.arange(len(rows.residual)), np.diff(rows.start))
    jacobian[row, rows.column] = rows.value  # what is fixed goes to the last column
    jacobian = jacobian[:, :size]
    return jacobian.T @ (rows.weight[:, None] * jacobian), jacobian.T @ (rows.weight * rows.residual)


@pytest.mark.parametrize(("size", "count", "most"), [(1, 0, 1), (2, 3, 2), (40, 0, 1), (40, 30, 3), (40, 60, 40)])
def test_the_solution_is_that_of_dense_algebra(size: int, count: int, most: int) -> None:
    rows = some_rows(size, count, most, seed=size)
    pattern = Pattern.of(rows, np.random.default_rng(1).permutation(size))
    values, right = pattern.normal(rows)
    matrix, gradient = dense(rows, size)
    np.testing.assert_allclose(right, gradient[pattern.order])
    np.testing.assert_allclose(values[pattern.diagonal], np.diagonal(matrix)[pattern.order])
    np.testing.assert_allclose(pattern.factor(values).solve(right), np.linalg.solve(matrix, gradient), rtol=1e-7)


def test_a_pattern_serves_other_values_at_the_same_places() -> None:
    rows = some_rows(60, 50, 4, seed=3)
    pattern = Pattern.of(rows, np.arange(60))
    other = replace(rows, value=2 * rows.value + 0.1, weight=rows.weight**2)
    values, right = pattern.normal(other)
    np.testing.assert_allclose(pattern.factor(values).solve(right), np.linalg.solve(*dense(other, 60)), rtol=1e-7)


def test_a_matrix_that_is_not_definite_has_no_solution() -> None:
    rows = some_rows(20, 15, 3, seed=5)
    pattern = Pattern.of(rows, np.arange(20))
    values, right = pattern.normal(rows)
    values[pattern.diagonal] -= 50.0
    assert np.isnan(pattern.factor(values).solve(right)).all()


@pytest.mark.parametrize("pairs", [0, 1, 90])
def test_what_the_inverse_takes_up_of_sparse_columns_is_that_of_dense_algebra(pairs: int) -> None:
    rows, rng = some_rows(50, 40, 4, seed=7), np.random.default_rng(8)
    pattern = Pattern.of(rows, rng.permutation(50))
    start = np.concatenate([[0], np.cumsum(rng.integers(1, 6, pairs))])
    variable, value = rng.integers(-1, 50, start[-1]), rng.standard_normal((start[-1], 2))
    columns = np.zeros((pairs, 51, 2))
    np.add.at(columns, (np.repeat(np.arange(pairs), np.diff(start)), variable), value)
    columns = columns[:, :50]
    expected = columns.transpose(0, 2, 1) @ np.linalg.inv(dense(rows, 50)[0]) @ columns
    taken = pattern.factor(pattern.normal(rows)[0]).taken_up(start, variable, value)
    np.testing.assert_allclose(taken, expected, rtol=1e-6, atol=1e-9)


def drive(frames: int, visits: int) -> tuple[Index, Index, int]:
    """Return when (K,) which landmark (K,) is seen: each for ten frames, in as many visits, and how many there are."""
    lap = frames // visits
    landmark, seen = np.meshgrid(np.arange(lap), np.arange(10), indexing="ij")
    frame = (landmark + seen)[None] + lap * np.arange(visits)[:, None, None]
    kept = frame < frames
    return frame[kept], np.broadcast_to(landmark, frame.shape)[kept], lap


def filled(frames: int, frame: Index, landmark: Index, landmarks: int, order: Index) -> int:
    """Return how many values the factor has when poses and landmarks are one variable each."""
    chain = [np.array([t, t + 1]) for t in range(1, frames - 1)]
    pairs = [np.array([t, frames + mark]) for t, mark in zip(frame, landmark, strict=True) if t > 0]
    start = 2 * np.arange(len(chain) + len(pairs) + 1)
    nothing = np.zeros(len(start) - 1)
    rows = Rows(start, np.concatenate(chain + pairs) - 1, np.zeros(start[-1]), nothing, nothing)
    return int(Pattern.of(rows, order - 1).column[-1])


def test_dissection_eliminates_everything_once_and_fills_less_than_landmarks_first() -> None:
    frame, landmark, landmarks = drive(240, 3)
    order = dissected(240, frame, landmark, landmarks)
    assert np.sort(order).tolist() == list(range(1, 240 + landmarks))
    in_time = np.concatenate([240 + np.arange(landmarks), np.arange(1, 240)])
    assert filled(240, frame, landmark, landmarks, order) < 0.5 * filled(240, frame, landmark, landmarks, in_time)


def test_a_log_twice_as_long_fills_about_twice_as_much() -> None:
    short, long = drive(240, 1), drive(480, 1)
    once, twice = (filled(n, *seen, dissected(n, *seen)) for n, seen in ((240, short), (480, long)))
    assert twice < 2.5 * once


def test_landmarks_that_nobody_sees_are_eliminated_too() -> None:
    order = dissected(3, np.array([0, 2]), np.array([1, 3]), 5)
    assert np.sort(order).tolist() == [1, 2, 3, 4, 5, 6, 7]
