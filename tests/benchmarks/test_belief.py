"""The judge of the belief: drives that are cut and joined, maps that fit nothing, and what is counted."""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from folders import ROOT

from localiser import Edges, LandmarkMap, Trajectory, compose
from localiser.geometry import between

BENCHMARKS = ROOT / "benchmarks"


@pytest.fixture(scope="module")
def judge() -> Iterator[SimpleNamespace]:
    """Return the modules of the benchmark, which is not a package."""
    sys.path.insert(0, str(BENCHMARKS))
    import belief_drives
    import belief_maps
    import belief_run
    import belief_scenarios
    import belief_score
    import belief_table

    yield SimpleNamespace(
        drives=belief_drives,
        maps=belief_maps,
        run=belief_run,
        scenarios=belief_scenarios,
        score=belief_score,
        table=belief_table,
    )
    sys.path.remove(str(BENCHMARKS))


def record(judge: SimpleNamespace, error_m: list[float], p_correct: list[float], **known: Any) -> Any:
    """Return a record of T images at 5 Hz with errors in x."""
    count = len(error_m)
    columns = {
        "warned": np.zeros(count, dtype=bool),
        "nees": np.full(count, 3.0),
        "expects": np.full(count, 5),
        "shows": np.full(count, 10),
        "ms": np.ones(count),
    }
    error = np.column_stack([error_m, np.zeros((count, 2))])
    return judge.run.Record(0.2 * np.arange(count), error, np.array(p_correct), **(columns | known))


# -- drives ------------------------------------------------------------------------------------------------------------


def circle(judge: SimpleNamespace, images: int = 300) -> Any:
    """A drive in a wide circle with exact wheels at four times the rate of images."""
    t_ns = np.arange(4 * images) * 50_000_000
    poses = [np.zeros(3)]
    for _ in t_ns[1:]:
        poses.append(compose(poses[-1], np.array([0.0, -0.03, np.deg2rad(0.9)])))
    truth = np.array(poses)
    wheels = Trajectory(t_ns, compose(np.array([5.0, -2.0, 2.0]), truth))
    points = LandmarkMap.from_points(np.zeros((1, 2)))
    return judge.run.Drive("circle", points, None, wheels, t_ns[::4], [Edges.none()] * images, truth[::4])


def test_wheels_miss_how_the_robot_is_carried(judge: SimpleNamespace) -> None:
    drive = judge.drives.carried(circle(judge), seed=3)
    first = drive.carried
    assert first == 60
    assert len(drive.t_ns) == len(drive.edges) == len(drive.truth) == 160
    assert (np.diff(drive.t_ns) == judge.drives.STEP_NS).all() and (np.diff(drive.odometry.t_ns) > 0).all()
    wheels = drive.odometry.sampled(drive.t_ns).poses
    driven, moved = (between(poses[:-1], poses[1:]) for poses in (wheels, drive.truth))
    np.testing.assert_allclose(np.delete(driven, first - 1, axis=0), np.delete(moved, first - 1, axis=0), atol=1e-9)
    np.testing.assert_allclose(driven[first - 1], 0.0, atol=1e-9)
    assert np.hypot(*moved[first - 1, :2]) >= 2.0 and abs(moved[first - 1, 2]) > np.deg2rad(20)


def test_wrong_start_is_far_from_the_true_one(judge: SimpleNamespace) -> None:
    drive = circle(judge)
    for seed in range(5):
        start = judge.drives.elsewhere(drive, seed)
        assert np.hypot(*(start - drive.truth[0])[:2]) >= 2.0
        assert np.hypot(*(drive.truth - start)[:, :2].T).min() < 1e-9  # inside the building


# -- maps --------------------------------------------------------------------------------------------------------------


def distances(points: np.ndarray) -> np.ndarray:
    return np.hypot(*(points[:, None] - points[None]).transpose(2, 0, 1))


def town() -> LandmarkMap:
    return LandmarkMap.from_points(np.random.default_rng(0).uniform(0, 9, (200, 2)))


def test_mirrored_map_is_no_rigid_motion(judge: SimpleNamespace) -> None:
    before, after = town().points, judge.maps.mirrored(town()).points
    np.testing.assert_allclose(distances(after), distances(before), atol=1e-9)
    sides = [(p[1] - p[0])[0] * (p[2] - p[0])[1] - (p[1] - p[0])[1] * (p[2] - p[0])[0] for p in (before, after)]
    assert sides[0] == pytest.approx(-sides[1]) and abs(sides[0]) > 0.1


def test_shuffled_map_keeps_what_stands_in_a_block_and_nothing_else(judge: SimpleNamespace) -> None:
    before, after = (distances(one.points) for one in (town(), judge.maps.shuffled(town(), 0)))
    kept = np.isclose(before, after, rtol=0, atol=1e-9) & ~np.eye(len(before), dtype=bool)
    assert 0 < before[kept].max() <= judge.maps.BLOCK_M * math.sqrt(2)
    # Of 36 to 49 blocks: about that share of all pairs stands in the same one.
    assert 1 / 60 < kept.mean() < 1 / 25
    other = judge.maps.shuffled(town(), 1)
    assert not np.allclose(other.points, judge.maps.shuffled(town(), 0).points)


def test_worn_maps_lose_or_move_three_in_ten(judge: SimpleNamespace) -> None:
    assert len(judge.maps.thinned(town(), 0)) == 140
    moved = np.hypot(*(judge.maps.rearranged(town(), 0).points - town().points).T)
    assert np.count_nonzero(moved) == 60
    np.testing.assert_allclose(moved[moved > 0], 0.3)


# -- what is counted ---------------------------------------------------------------------------------------------------


def test_settled_is_the_first_of_five(judge: SimpleNamespace) -> None:
    right = np.array([0, 1, 1, 1, 1, 0, 1, 1, 1, 1, 1, 0], dtype=bool)
    assert judge.run.settled_at(right) == 6
    assert judge.run.settled_at(right, 4) == 2
    assert judge.run.settled_at(right[:10]) == -1


def test_tracking_counts_what_is_lost_after_it_was_found(judge: SimpleNamespace) -> None:
    error_m = [5.0] * 10 + [0.1] * 20 + [3.0] * 4 + [0.1] * 6
    values = judge.scenarios.tracked(record(judge, error_m, [0.2] * 10 + [0.95] * 30))
    assert values["found_s"] == pytest.approx(2.0)
    assert values["lost_images"] == 4
    assert values["sure"] == 0.75 and values["sure_found"] == 1.0
    assert values["sure_wrong"] == 0.1
    assert values["rmse_found_m"] == pytest.approx(math.sqrt((26 * 0.01 + 4 * 9) / 30))
    assert values["nees / 3"] == 1.0


def test_kidnapping_counts_from_where_the_robot_is_set_down(judge: SimpleNamespace) -> None:
    drive = circle(judge, 40)
    object.__setattr__(drive, "carried", 10)
    error_m = [0.1] * 10 + [4.0] * 8 + [0.1] * 22
    told = record(judge, error_m, [0.99] * 13 + [0.3] * 5 + [0.95] * 22)
    values = judge.scenarios.carried_off(told, drive)
    assert values["back_images"] == 8 and values["back_s"] == pytest.approx(1.6)
    assert values["sure_images"] == values["noticed_images"] == 3
    assert values["for_good"] == 1.0
    again = record(judge, [*error_m[:-1], 2.0], told.p_correct.tolist())
    assert judge.scenarios.carried_off(again, drive)["for_good"] == 0.0


def test_images_that_tell_nothing_do_not_count_against_a_wrong_start(judge: SimpleNamespace) -> None:
    expects = np.array([5, 2, 5, 5, 5, 5])
    shows = np.array([9, 9, 4, 9, 9, 9])
    told = record(judge, [3.0] * 6, [0.99, 0.98, 0.97, 0.9, 0.4, 0.3], expects=expects, shows=shows)
    values = judge.scenarios.found_out(told)
    assert values["telling_images"] == 3 and values["images"] == 4
    assert values["sure_images"] == 3 and values["back_s"] == math.inf


def test_nothing_is_right_on_a_wrong_map(judge: SimpleNamespace) -> None:
    told = record(judge, [np.nan] * 20, [0.95] * 18 + [0.1] * 2, warned=np.arange(20) == 19)
    assert not told.right.any()
    values = judge.scenarios.warned(told)
    assert values["sure_later"] == 0.5  # two of the four images after 3 s
    assert values["warned_s"] == pytest.approx(3.8)


def test_a_simulated_building_may_have_the_map_of_another_of_its_kind(
    judge: SimpleNamespace, monkeypatch: pytest.MonkeyPatch
) -> None:
    names = [case.name for case in judge.scenarios.SCENARIOS["wrong"].asked("wrong", ["line"])]
    assert "floor another own line" in names and len(names) == len(set(names))
    monkeypatch.setattr(judge.scenarios, "SHOP_MINUTES", 0.1)
    _, told = judge.scenarios.wrong("floor", "another", "own", "line", seed=0)
    assert len(told.right) == 30 and not told.right.any() and told.expects.mean() > 3


# -- calibration -------------------------------------------------------------------------------------------------------


def test_calibration_of_claims_by_hand(judge: SimpleNamespace) -> None:
    claims = judge.score.Claims.of(np.array([0.95, 0.95, 0.95, 1.0, 0.25]), np.array([True, True, False, True, False]))
    found = judge.score.calibration({"one": [claims]})
    assert found.images == 5
    assert found.ece[0] == pytest.approx((abs(3.85 - 3) + abs(0.25 - 0)) / 5)
    assert found.log_score[0] == pytest.approx((2 * math.log(0.95) + math.log(0.05) + math.log(0.75)) / 5)
    np.testing.assert_allclose(found.rows[:, :4], [[2, 1, 0.25, 0.0], [9, 4, 0.9625, 0.75]])


def test_every_scenario_has_the_same_weight_however_many_images_it_has(judge: SimpleNamespace) -> None:
    few = judge.score.Claims.of(np.full(10, 0.5), np.zeros(10, dtype=bool))
    many = judge.score.Claims.of(np.full(1000, 0.5), np.arange(1000) % 2 == 0)
    assert judge.score.calibration({"few": [few], "many": [many]}).ece[0] == pytest.approx(0.25)


def test_interval_is_over_runs(judge: SimpleNamespace) -> None:
    """Ten runs, one of them wrong throughout: draws have none to a few of it."""
    right = [judge.score.Claims.of(np.ones(100), np.full(100, k > 0)) for k in range(10)]
    value, low, high = judge.score.calibration({"all": right}).ece
    assert (value, low) == (pytest.approx(0.1), pytest.approx(0.0, abs=1e-12))
    assert 0.25 <= high <= 0.35


# -- tables ------------------------------------------------------------------------------------------------------------


def test_never_is_worse_than_any_bar(judge: SimpleNamespace) -> None:
    case = judge.scenarios.Case("misplaced", ("house", "line"))
    outcomes = [
        judge.scenarios.Outcome(case, seed, {"telling_images": value}, None, 1.0)
        for seed, value in enumerate([3.0, 4.0, math.inf])
    ]
    median, worst = judge.table.COLUMNS["misplaced"][:2]
    assert median.figure(outcomes) == 4.0 and worst.figure(outcomes) == math.inf
    assert worst.missed(case, math.inf) and not worst.missed(case, 10.0)
    assert judge.table.finite(math.inf) == "never" and judge.table.finite(math.nan) is None


def test_every_case_has_columns_and_a_judge(judge: SimpleNamespace) -> None:
    for name, scenario in judge.scenarios.SCENARIOS.items():
        cases = scenario.cases(scenario.kinds)
        assert cases and len(set(cases)) == len(cases)
        assert judge.table.COLUMNS[name]
    (case, *_) = judge.scenarios.SCENARIOS["recovery"].asked("recovery", ["slope"], 2.5)
    assert case.name == "shelves 2.5 min slope"


# -- program -----------------------------------------------------------------------------------------------------------


def test_program_writes_figures_and_compares_with_those_of_before(
    judge: SimpleNamespace, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """With the runs replaced by made-up ones: kidnapped robots that are back after as many images as the seed says."""
    import belief

    def made_up(case: Any, seed: int) -> Any:
        right = np.arange(100) >= seed
        values = {"back_images": float(seed), "back_s": 0.2 * seed, "sure_images": 1.0, "noticed_images": 1.0}
        claims = judge.score.Claims.of(np.where(right, 0.99, 0.2), right)
        return judge.scenarios.Outcome(
            case, seed, values | {"for_good": 1.0, "log_score": claims.log_score / 100}, claims, 1.0
        )

    monkeypatch.setattr(belief, "outcome", made_up)
    figures, diagram = tmp_path / "figures.json", tmp_path / "reliability.png"
    asked = ["belief.py", "--scenario", "kidnapped", "--only", "office", "--seeds", "11", "--jobs", "1"]
    monkeypatch.setattr(sys, "argv", [*asked, "--json", str(figures), "--diagram", str(diagram)])
    belief.main()
    assert diagram.read_bytes().startswith(b"\x89PNG")
    found = json.loads(figures.read_text())
    (row,) = found["figures"]
    assert row["case"] == "office line" and row["seeds"] == 11
    assert row["back_images, median"] == 5 and row["back_images, worst"] == 10 and row["missed"] == []
    assert [run["seed"] for run in found["runs"]] == list(range(11))
    assert "10 !" not in capsys.readouterr().out
    monkeypatch.setattr(sys, "argv", [*asked, "--first-seed", "1", "--against", str(figures)])
    belief.main()
    said = capsys.readouterr().out
    assert "6 !" in said  # the median is above its bar now
    score = found["calibration"]["all"]["log_score"][0]
    assert f"{score:.4f}" in said
