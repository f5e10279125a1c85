"""Tables fit the terminal and break no word; the tables of runs: figures, medians."""

from typing import Any

import pytest
from rich.console import Console

from localiser.evaluate.tables import fit_width, flat_figures, learnt_constants, run_tables


def run(log: str, observation: str, seed: int, rmse: float | None, edges: float = 10.0) -> dict[str, Any]:
    return {
        "log": log, "observation": observation, "seed": seed, "position_rmse_m": rmse, "position_median_m": 0.03,
        "nees_mean": 2.96, "odometry_position_rmse_m": None, "edges_per_frame": edges,
    }  # fmt: skip


def print_tables(runs: dict[str, dict[str, Any]], console: Console) -> None:
    for part in run_tables(runs):
        for piece in [part] if isinstance(part, str) else fit_width(part, console):
            console.print(piece)


def rendered(runs: dict[str, dict[str, Any]], width: int = 160) -> list[str]:
    console = Console(width=width, color_system=None)
    with console.capture() as capture:
        print_tables(runs, console)
    return [" ".join(line.split()) for line in capture.get().splitlines() if line.strip()]


def test_what_is_the_same_stands_above_the_table() -> None:
    lines = rendered({"results/house/1": run("house", "line", 0, 0.0416)})
    assert lines[0] == "log house, observation line, seed 0"
    assert lines[-2:] == ["results/house/1 0.042 0.030 3.0", "NEES: 3 is right, below: cautious"]


OWN: dict[str, Any] = {
    "edges_per_frame": 13.2, "edges_matched": 0.664, "distance_m": 123.5, "speed_mean_m_s": 0.5,
    "confidence": {"found_s": 120.5, "sure": 0.98, "sure_and_wrong": None}, "residuals": {"consistency": 0.55},
    "position_3sigma_median_m": 0.03, "position_3sigma_max_m": 9.1, "heading_3sigma_median_deg": 10.25,
    "pauses": [{"start_s": 3.0}, {"start_s": 9.0}], "frame_ms_median": 121.2,
}  # fmt: skip
FULL: dict[str, Any] = {
    "log": "corridor", "association": "unknown", "odometry": "wheel", "start": "stated", "map": "corridor e1f5ad",
    "inputs": "854caa", "particles": 2000, "seed": 0, "observation": "line", "position_rmse_m": 0.02,
    "position_median_m": 0.02, "position_max_m": 10.5, "position_end_m": 10.5, "heading_rmse_deg": 10.5,
    "odometry_position_rmse_m": 10.5, "nees_mean": 100.5, **OWN,
    "confidence": {"found_s": 120.5, "sure": 0.98, "sure_and_wrong": 0.001},
}  # fmt: skip


def test_with_truth_it_tells_the_same_and_the_errors() -> None:
    lines = [line for line in rendered({"1": FULL}, width=80) if "cautious" not in line]
    assert "resid. χ²: 1 is right, below: cautious" in rendered({"1": FULL}, width=40)
    assert "1 120.5 98.0 66 0.55 0.030 9.100 10.25 123.5 0.50 2 121" in lines
    assert lines[-1] == "1 0.020 0.020 10.500 10.500 10.50 10.500 0.1 100.5"


@pytest.mark.parametrize("width", [80, 120, 160])
@pytest.mark.parametrize("count", [1, 2, 6])
def test_tables_fit_the_terminal_and_break_no_word(width: int, count: int) -> None:
    kinds = [
        {"observation": kind, "map": name}
        for name in ("corridor e1f5ad", "office abcdef")
        for kind in ("line", "slope")
    ]
    runs = {
        f"results/of/a/long/experiment/{n}/corridor/latest": FULL | kinds[n % 4] | {"seed": n // 4}
        for n in range(count)
    }
    console = Console(width=width, color_system=None)
    with console.capture() as capture:
        print_tables(runs, console)
    assert max(map(len, capture.get().splitlines())) <= width
    words = set(capture.get().split())
    assert not any("…" in word for word in words)
    assert {"match", "found", "heading", "median", "0.55", "9.100", "100.5"} <= words
    if count > 1:
        parts = {part for word in words for part in word.split("/")}
        assert {"slope", "corridor", "experiment", "latest"} <= parts, "names and settings are whole words"


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
