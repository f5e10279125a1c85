"""A replay that is held back to be watched."""

from __future__ import annotations

from itertools import pairwise
from unittest.mock import patch

from localiser.commands.options import paced


def test_images_pass_at_the_speed_they_were_taken_times_a_factor() -> None:
    """By a clock of our own: work takes 10 ms an image, waiting takes the rest."""
    now = [100.0]
    passed = []

    def sleep(seconds: float) -> None:
        now[0] += seconds

    def advance() -> None:
        now[0] += 0.01
        passed.append(now[0])

    times_ns = [7_000_000_000 + k * 200_000_000 for k in range(5)]
    with patch("time.monotonic", lambda: now[0]), patch("time.sleep", sleep):
        step = paced(advance, times_ns, speed=2.0)
        for _ in times_ns:
            step()
    gaps = [round(later - sooner, 6) for sooner, later in pairwise(passed)]
    assert gaps == [0.11, 0.1, 0.1, 0.1]
