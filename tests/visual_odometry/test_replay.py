"""Increments in the filter and on the command line: wheels that slip, vision alone, logs without images."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from short_log import CORRIDOR, Localiser, cut_log
from small_log import write_edge_log
from two_views import CAMERA, POINTS, edges_from

from localiser.config import read_config
from localiser.errors import InputError
from localiser.filter import mcl
from localiser.geometry import compose
from localiser.landmarks import LandmarkMap
from localiser.observation import EdgeObservation, ObservationParameters
from localiser.visual_odometry import Odometer, VisualOdometryParameters

STEP, SLIP = np.array([0.0, -0.02, 0.0]), np.array([0.0, -0.1, np.radians(4.0)])


def worst_error_m(source: str) -> float:
    """Return how far off the filter is at worst after wheels slipped by 0.5 m and 20° in five steps."""
    odometer = Odometer(CAMERA, VisualOdometryParameters(source=source))
    observation = EdgeObservation(CAMERA, ObservationParameters())
    filter_ = mcl.Mcl(LandmarkMap.from_points(POINTS, name="points"), observation, odometer=odometer)
    state, rng, noise = mcl.FilterState(), np.random.default_rng(1), np.random.default_rng(2)
    list(mcl.step(filter_, state, mcl.Start(0, np.zeros(3), np.diag([0.05, 0.05, 0.02]) ** 2), rng))
    true, wheels, errors = np.zeros(3), np.zeros(3), []
    for index in range(9):
        t_ns = index * 200_000_000
        events = [mcl.Odometry(t_ns, wheels), mcl.Sighting(t_ns, edges_from(true, noise))]
        for event in events:
            errors += [np.hypot(*(out.estimate.pose - true)[:2]) for out in mcl.step(filter_, state, event, rng)]
        true = compose(true, STEP)
        wheels = compose(wheels, STEP + SLIP if 2 <= index < 7 else STEP)
    return float(max(errors[3:]))


@pytest.mark.parametrize("source", ["vision", "wheel"])
def test_a_slip_does_not_lose_the_robot(source: str) -> None:
    assert worst_error_m(source) < 0.05


def test_wheels_alone_the_default_never_follow_edges(monkeypatch: pytest.MonkeyPatch) -> None:
    def never(*_: object) -> None:
        raise AssertionError("edges were followed")

    assert VisualOdometryParameters().source == "wheel"
    monkeypatch.setattr(Odometer, "increment", never)
    assert worst_error_m("wheel") > 0.0
    with pytest.raises(AssertionError, match="followed"):
        worst_error_m("vision")


def test_both_is_told_to_be_gone() -> None:
    with pytest.raises(InputError, match=r"increments\.source: `both` is gone: edges check the wheels anyway"):
        read_config(None, ["increments.source=both"])


def test_replay_by_vision(tmp_path: Path, localiser: Localiser) -> None:
    log = cut_log(CORRIDOR, tmp_path / "log", 3)
    few = ("--set", "mcl.particles=200", "--set", "mcl.start_particles=200")
    run = localiser.replay(log, tmp_path / "out", "--odometry", "vision", *few)
    figures = json.loads((run / "metrics.json").read_text())
    assert figures["complete"]
    assert "source: vision" in (run / "config.yaml").read_text()


def test_a_log_without_images_cannot_be_followed(tmp_path: Path, localiser: Localiser) -> None:
    log = write_edge_log(tmp_path / "log")
    result = localiser(
        "replay", log, "--start", "1,2,170", "--odometry", "vision", "--out", tmp_path / "out", "--no-rrd"
    )
    assert result.exit_code == 2
    assert "follows edges from image to image" in result.err and "Traceback" not in result.err
