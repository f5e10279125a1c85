"""Identical runs count once; learnt constants as texts."""

from __future__ import annotations

from localiser.evaluate import learnt_constants, without_twins


def test_the_same_figures_are_the_same_run_whatever_it_took() -> None:
    one = {"log": "l", "seed": 0, "position_rmse_m": 0.1, "frame_ms_median": 20.0, "stage_ms": {"load": 1.0}}
    again = one | {"frame_ms_median": 25.0, "stage_ms": {"load": 2.0}}
    runs = {"l/1": one, "l/2": one | {"seed": 1}, "l/latest": again}
    different, twins = without_twins(runs)
    assert list(different) == ["l/1", "l/2"]
    assert twins == {"l/latest": "l/1"}


def test_constants_are_told_with_unit_and_sigma() -> None:
    figures = {
        "biases": {
            "distance_scale": {"value": -0.0205, "sigma": 0.0073, "least_squares": -0.026},
            "veer": {"value": 0.01, "sigma": 0.005},
            "own_thing": {"value": 1.0, "sigma": 0.5},
        },
        "tilt_found_deg": 19.99, "tilt_found_sigma_deg": 0.0065,
    }  # fmt: skip
    assert learnt_constants(figures) == [
        "distance -2.05 ± 0.73 %", "veer +0.57 ± 0.29°/m", "own thing +1.00 ± 0.50", "tilt 19.990 ± 0.006°",
    ]  # fmt: skip
    assert learnt_constants({"biases": {}}) == []
