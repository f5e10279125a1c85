"""How many examples a fuzzing test takes; ten times as many, and new ones, when they are asked for:

LOCALISER_EXAMPLES=1000 pytest tests/storage/bags/test_damage.py tests/live/test_fuzz.py
"""

from hypothesis import settings

_FULL = 100  # of the profile in tests/conftest.py


def examples(full: int) -> int:
    """Return how many examples to take by the profile in force, of which `full` are the usual number."""
    return max(full * settings.default.max_examples // _FULL, 1)
