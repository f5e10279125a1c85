"""How many examples a fuzzing test takes: half as many when all tests run, ten times as many when only they do.

pytest --hypothesis-profile=thorough tests/storage/bags/test_damage.py tests/live/test_fuzz.py
"""

from __future__ import annotations

from hypothesis import settings

_FULL = 100  # of Hypothesis's own profile


def examples(full: int) -> int:
    """Return how many examples to take by the profile in force."""
    return max(full * settings.default.max_examples // _FULL, 1)
