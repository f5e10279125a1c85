"""How loops over particles are compiled by numba, the same everywhere, so that a loop may be inlined into another.

Sums may be contracted to fused operations, but never be put into another order: results do not depend on what stands
beside a particle.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar, cast

from numba import njit

F = TypeVar("F", bound=Callable[..., Any])

_RULES: dict[str, Any] = {"error_model": "numpy", "fastmath": {"contract", "arcp", "nsz"}}


def entry(function: F) -> F:
    """Compile what Python calls; kept on disk, so that only the first run ever waits for it."""
    return cast(F, njit(cache=True, nogil=True, **_RULES)(function))


def inlined(function: F) -> F:
    """Inline into the caller, where shapes are constant."""
    return cast(F, njit(forceinline=True, **_RULES)(function))
