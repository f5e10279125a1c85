"""Numbers that a caller gives: checked once where they come in."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from localiser.errors import InputError
from localiser.geometry.angles import Array


def finite_numbers(name: str, values: ArrayLike, *shapes: tuple[int | str, ...]) -> Array:
    """Return finite numbers as a new array of one of the shapes, in which a name such as "E" stands for any length.

    Raises InputError, which names the field `name`.
    """
    try:
        found = np.array(values, dtype=np.float64)
    except (TypeError, ValueError):
        found = np.array(np.nan)
    fits = any(len(shape) == found.ndim and all(map(_same, shape, found.shape)) for shape in shapes)
    if not fits or not np.isfinite(found).all():
        expected = " or ".join(str(shape).replace("'", "") if shape else "one" for shape in shapes)
        raise InputError(f"expected {expected} finite numbers, found {values!r}", field=name)
    return found


def _same(expected: int | str, found: int) -> bool:
    return isinstance(expected, str) or expected == found
