"""Metrics as one row."""

from __future__ import annotations

from localiser.evaluate import flat_figures, is_time


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
