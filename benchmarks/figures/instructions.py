"""Millions of instructions that an image takes: `benchmarks/instructions.py`.

Each repetition has other hashes of Python's, and with them other memory. Another folder changes them by 0.3 %.
"""

from __future__ import annotations

from functools import partial

from figures.measures import Measure
from figures.tasks import Task, Values

MEASURES = {f"{what}, millions": Measure("up", least=0.01) for what in ("edges", "whole")}


def tasks(repetitions: int) -> list[Task]:
    """Return what is measured."""
    return [
        Task("instructions", name, seed, partial(counted, name, seed))
        for seed in range(repetitions)
        for name in ("default", "small")
    ]


def counted(configuration: str, seed: int) -> Values:
    """Return the figures of one configuration."""
    from instructions import millions

    return {f"{what}, millions": value for what, value in millions(configuration, seed).items()}
