"""How many examples a fuzzing test takes: few when all tests run, ten times as many when they are what is run.

pytest --hypothesis-profile=thorough tests/test_storage_bags_damage.py tests/test_live_fuzz.py
"""

from __future__ import annotations

from hypothesis import settings

_USUAL = 100  # of Hypothesis's own profile


def examples(usually: int) -> int:
    """Return how many examples to take by the profile in force."""
    return max(usually * settings.default.max_examples // _USUAL, 1)
