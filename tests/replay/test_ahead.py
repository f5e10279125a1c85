"""Edges found ahead by another thread: the same events, results and errors in the same order."""

import threading
from collections.abc import Iterator

import numpy as np
import pytest
from short_log import CORRIDOR, cut_log

from localiser import Localiser, read_config
from localiser.errors import InputError
from localiser.replay import replay_log
from localiser.replay.frames import in_order


def squared(event: int) -> int:
    if event == 7:
        raise InputError("seven")
    return event**2


def is_image(event: int) -> bool:
    return event % 2 == 1


def taken(threads: int, events: Iterator[int]) -> list[object]:
    """What is yielded, until something is raised, and that."""
    result: list[object] = []
    try:
        for event, found in in_order(events, squared, is_image, threads):
            result.append((event, None if found is None else found()))
    except (InputError, ValueError) as error:
        result.append(str(error))
    return result


def broken() -> Iterator[int]:
    yield from (1, 2, 3)
    raise ValueError("no more")


@pytest.mark.parametrize("threads", [1, 2])
def test_order_results_and_errors_are_those_of_one_thread(threads):
    assert taken(threads, iter([0, 1, 3, 2, 5])) == [(0, None), (1, 1), (3, 9), (2, None), (5, 25)]
    assert taken(threads, iter([1, 7, 3])) == [(1, 1), "seven"]
    assert taken(threads, broken()) == [(1, 1), (2, None), (3, 9), "no more"]


def test_no_thread_is_left_when_a_run_is_given_up():
    before = threading.active_count()
    steps = in_order(iter(range(100)), squared, is_image, 2)
    next(steps)
    steps.close()
    assert threading.active_count() == before


def test_a_replay_with_two_threads_has_the_same_bytes(tmp_path, monkeypatch):
    log = cut_log(CORRIDOR, tmp_path / "log", 6)
    measured_by = set()
    measure = Localiser.measure

    def noted(self, *arguments):
        measured_by.add(threading.current_thread().name.split("_")[0])
        return measure(self, *arguments)

    monkeypatch.setattr(Localiser, "measure", noted)
    config = ["mcl.particles=300", "mcl.start_particles=600"]
    one, two = (replay_log(log, read_config(None, [*config, f"observation.threads={threads}"])) for threads in (1, 2))
    assert measured_by == {"MainThread", "edges"}
    assert len(one.frames) == len(two.frames) == 6
    for first, second in zip(one.frames, two.frames, strict=True):
        np.testing.assert_array_equal(first.located.estimate.mean, second.located.estimate.mean)
        np.testing.assert_array_equal(first.located.estimate.cov, second.located.estimate.cov)
