"""Give edges to landmarks or tracks, each to at most one, so that the sum of scores is largest."""

from __future__ import annotations

import numpy as np

from localiser.geometry import Array
from localiser.mapping.sightings import Index


def assign(score: Array) -> tuple[Index, Index]:
    """Return rows and columns (M,) of the matches with positive scores (A, B) whose sum is largest.

    -inf forbids a pair. A global nearest neighbour, solved as a linear assignment [Bar-Shalom, Li 1995].
    """
    row, column = np.nonzero(score > 0)
    if len(row) == 0:
        return row, column
    # Pairs that compete with no other need no solver.
    alone = (np.bincount(row, minlength=score.shape[0])[row] == 1) & (
        np.bincount(column, minlength=score.shape[1])[column] == 1
    )
    if alone.all():
        return row, column
    from scipy.optimize import linear_sum_assignment

    rows, columns = np.unique(row[~alone]), np.unique(column[~alone])
    gain = np.maximum(score[np.ix_(rows, columns)], 0.0)
    chosen_row, chosen_column = linear_sum_assignment(gain, maximize=True)
    real = gain[chosen_row, chosen_column] > 0
    return (
        np.concatenate([row[alone], rows[chosen_row[real]]]),
        np.concatenate([column[alone], columns[chosen_column[real]]]),
    )
