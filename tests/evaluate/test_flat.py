"""Metrics as one row, and learnt constants as texts."""

from __future__ import annotations

from localiser.evaluate import flat_figures, is_time, learnt_constants


def test_groups_become_names_and_lists_become_cells() -> None:
    figures = {
        "log": "house", "confidence": {"sure": 0.5, "reasons": {"few edges": 3, "lost": 1}},
        "pauses": [{"start_s": 1.0}, {"start_s": 9.0}], "warnings": ["Tilt.", "Map."], "nees_mean": None,
    }  # fmt: skip
    assert flat_figures(figures) == {
        "log": "house", "confidence.sure": 0.5, "confidence.reasons": "few edges (3); lost (1)", "pauses": 2,
        "warnings": "Tilt. Map.", "nees_mean": None,
    }  # fmt: skip
    assert flat_figures({"warnings": [], "pauses": []}) == {"warnings": None, "pauses": 0}


def test_times_are_told_apart() -> None:
    assert is_time("stage_ms.filter") and is_time("frame_ms_p95") and not is_time("frames")


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
