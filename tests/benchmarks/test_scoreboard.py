"""The scoreboard: drives that are changed, maps that fit nothing, what is counted, and when a figure is worse."""

import math
import subprocess
import sys
from collections import Counter
from typing import Any

import numpy as np
import pytest
import scoreboard
from board import changes, page, rows
from board.rows import every_row
from board.run import FIGURES, NEVER, Drive, Record, figures
from folders import ROOT

from localiser import Edges, LandmarkMap, Trajectory, compose
from localiser.geometry import Array, between


def record(error_m: list[float], p_correct: list[float], **known: Any) -> Record:
    """Return a record of T images at 5 Hz with errors in x."""
    count = len(error_m)
    columns = {"warned": np.zeros(count, dtype=bool), "took_over": np.zeros(count, dtype=bool)}
    columns |= {"nees": np.full(count, 3.0), "ms": np.ones(count)}
    error = np.column_stack([error_m, np.zeros((count, 2))])
    return Record(0.2 * np.arange(count), error, np.array(p_correct), **(columns | known))


# -- drives ------------------------------------------------------------------------------------------------------------


def circle(images: int = 300) -> Drive:
    """A drive in a wide circle with exact wheels at four times the rate of images."""
    t_ns = np.arange(4 * images) * 50_000_000
    poses = [np.zeros(3)]
    for _ in t_ns[1:]:
        poses.append(compose(poses[-1], np.array([0.0, -0.03, np.deg2rad(0.9)])))
    truth = np.array(poses)
    wheels = Trajectory(t_ns, compose(np.array([5.0, -2.0, 2.0]), truth))
    points = LandmarkMap.from_points(np.zeros((1, 2)))
    return Drive("circle", points, None, wheels, t_ns[::4], [Edges.none()] * images, truth[::4])


def steps(poses: Array) -> Array:
    """Return the motions (T - 1, 3) from pose to pose."""
    return between(poses[:-1], poses[1:])


def test_wheels_miss_how_the_robot_is_carried() -> None:
    drive = changes.carried(circle(), seed=3)
    first = drive.carried
    assert first == 60
    assert len(drive.t_ns) == len(drive.edges) == len(drive.truth) == 160
    assert (np.diff(drive.t_ns) == changes.STEP_NS).all() and (np.diff(drive.odometry.t_ns) > 0).all()
    driven, moved = steps(drive.odometry.sampled(drive.t_ns).poses), steps(drive.truth)
    np.testing.assert_allclose(np.delete(driven, first - 1, axis=0), np.delete(moved, first - 1, axis=0), atol=1e-9)
    np.testing.assert_allclose(driven[first - 1], 0.0, atol=1e-9)
    assert np.hypot(*moved[first - 1, :2]) >= 2.0 and abs(moved[first - 1, 2]) > np.deg2rad(20)


@pytest.mark.parametrize(("fault", "factor"), [("frozen", 0.0), ("twice", 2.0)])
def test_wheels_that_err_count_wrong_for_three_seconds(fault: str, factor: float) -> None:
    drive = circle()
    wheels = changes.wheels_wrong(drive, fault, 4.0).odometry
    np.testing.assert_array_equal(wheels.t_ns, drive.odometry.t_ns)
    bad = (wheels.t_ns[1:] >= 4_000_000_000) & (wheels.t_ns[1:] < 7_000_000_000)
    said, true = steps(wheels.poses), steps(drive.odometry.poses)
    assert bad.sum() == 60
    np.testing.assert_allclose(said[bad], factor * true[bad], atol=1e-9)
    np.testing.assert_allclose(said[~bad], true[~bad], atol=1e-9)


# -- what is counted ---------------------------------------------------------------------------------------------------


def test_a_robot_that_is_looked_for_is_judged_from_the_first_of_five_right_images() -> None:
    error_m = [5.0] * 6 + [0.1] * 4 + [5.0] + [0.1] * 19 + [3.0] * 4 + [0.1] * 6
    nees = np.where(np.arange(40) < 11, 900.0, 6.0)
    values = figures(record(error_m, [0.2] * 11 + [0.95] * 29, nees=nees))
    assert values["found"] == 11
    assert values["rmse_m"] == pytest.approx(math.sqrt((25 * 0.01 + 4 * 9) / 29))
    assert values["median_m"] == pytest.approx(0.1)
    assert values["nees"] == 6.0
    assert values["sure"] == 29 / 40 and values["sure_wrong"] == 4 / 40  # of all images
    from_start = figures(record(error_m, [0.2] * 40), stated=True)
    assert from_start["rmse_m"] == pytest.approx(math.sqrt((29 * 0.01 + 7 * 25 + 4 * 9) / 40))


def test_a_robot_that_is_never_found_counts_as_worse_than_any() -> None:
    values = figures(record([0.1, 0.1, 0.1, 0.1, 4.0] * 6, [0.3] * 30))
    assert all(values[key] == NEVER for key in ("found", "rmse_m", "median_m", "heading_deg", "nees"))
    assert values["sure"] == 0.0


def test_a_warning_is_due_soon_on_a_wrong_map_and_never_on_a_right_one() -> None:
    warned = np.arange(40) >= 20
    right, wrong = record([0.1] * 40, [0.3] * 40, warned=warned), record([math.nan] * 40, [0.3] * 40, warned=warned)
    assert figures(right, first=10)["warned"] == 20 / 30 and "warned_s" not in figures(right)
    assert figures(wrong, first=10)["warned_s"] == pytest.approx(2.0) and "warned" not in figures(wrong)
    assert figures(record([math.nan] * 9, [0.3] * 9))["warned_s"] == NEVER


def test_a_carried_robot_is_judged_from_where_it_is_set_down() -> None:
    told = record([0.1] * 10 + [4.0] * 8 + [0.1] * 22, [0.99] * 13 + [0.3] * 5 + [0.95] * 22)
    values = figures(told, first=10)
    assert values["found"] == 8
    assert values["rmse_m"] == pytest.approx(0.1)
    assert values["sure_wrong"] == 3 / 30


def test_calibration_by_hand() -> None:
    values = figures(record([0.1, 0.1, 3.0, 0.1, 3.0], [0.95, 0.95, 0.95, 1.0, 0.25]))
    assert values["ece"] == pytest.approx((abs(3.85 - 3) + abs(0.25 - 0)) / 5)
    assert values["log_score"] == pytest.approx((2 * math.log(0.95) + math.log(0.05) + math.log(0.75)) / 5)
    # Claims in one of the ten bins are made up for by others there, and those in another are not.
    assert figures(record([0.1, 3.0], [0.51, 0.59]))["ece"] == pytest.approx(0.05)
    assert figures(record([0.1, 3.0], [0.49, 0.51]))["ece"] == pytest.approx(0.51)
    assert figures(record([3.0] * 2, [1.0] * 2))["log_score"] == pytest.approx(math.log(1e-6))


# -- what is worse -----------------------------------------------------------------------------------------------------


BEFORE = [0.10, 0.12, 0.09, 0.11, 0.10]
FOUND = [10.0, 12.0, 40.0, 9.0, 11.0]


@pytest.mark.parametrize(
    ("key", "before", "now", "expected"),
    [
        *((key, values, values, "") for key in FIGURES for values in (BEFORE, [0.0] * 5, [NEVER] * 5)),
        ("rmse_m", BEFORE, [1.05 * one for one in BEFORE], "worse"),
        ("rmse_m", [1.05 * one for one in BEFORE], BEFORE, "better"),
        ("rmse_m", BEFORE, [1.02 * one for one in BEFORE], ""),  # less than three per cent
        ("rmse_m", BEFORE, [0.11, 0.11, 0.10, 0.12, 0.10], ""),  # chance
        ("rmse_m", [0.003] * 5, [0.0033] * 5, ""),  # a third of a millimetre
        ("rmse_m", BEFORE, [0.115, 0.138, 0.103, 0.125, 0.500], "worse"),  # all five by a tenth, one by far more
        ("rmse_m", BEFORE, [0.108, 0.138, 0.103, 0.125, 0.500], ""),
        ("rmse_m", [0.1], [0.5], ""),  # one seed
        ("sure", [0.90, 0.91, 0.92, 0.90, 0.91], [0.88, 0.89, 0.90, 0.88, 0.89], "worse"),
        ("sure_wrong", [0.0] * 5, [0.009] * 5, ""),  # less than a point
        ("sure_wrong", [0.0] * 5, [0.02, 0.03, 0.02, 0.02, 0.03], "worse"),
        ("sure_wrong", [0.0] * 5, [0.0, 0.0, 0.0, 0.0, 0.5], ""),  # one seed is chance
        ("found", FOUND, [NEVER] * 5, "worse"),
        ("found", FOUND, [10.0, NEVER, NEVER, NEVER, NEVER], "worse"),
        ("found", FOUND, [10.0, 12.0, 40.0, 9.0, NEVER], ""),
        ("found", [NEVER] * 5, [NEVER] * 4 + [3.0], ""),
        ("nees", [3.0, 3.2, 2.9, 3.1, 3.0], [9.0, 9.5, 8.0, 9.1, 9.2], "worse"),
        ("nees", [0.4, 0.5, 0.45, 0.4, 0.42], [2.0, 2.4, 2.1, 2.2, 2.3], "better"),
        ("nees", [6.0, 6.2, 5.9, 6.1, 6.0], [1.5, 1.45, 1.52, 1.48, 1.5], ""),  # twice and half are as bad
    ],
)
def test_a_change_is_worse_where_it_is_more_than_chance_and_more_than_little(key, before, now, expected):
    assert page.verdict(key, np.column_stack([before, now])) == expected


@pytest.mark.parametrize(
    ("key", "spread", "least", "most"),
    [("rmse_m", 0.3, 0.015, 0.035), ("nees", 0.5, 0.015, 0.035), ("sure", 0.05, 0.015, 0.035), ("rmse_m", 0.01, 0, 0)],
)
def test_chance_alone_is_called_worse_once_in_forty(key: str, spread: float, least: float, most: float) -> None:
    """As an interval of 95 % does on either side; where chance changes less than 3 %, never."""
    rng = np.random.default_rng(8)
    level = {"rmse_m": 0.2, "nees": 4.0, "sure": 0.7}[key]
    drawn = level * (1 + spread * rng.uniform(-1.7, 1.7, (2000, 5, 2)))
    share = Counter(page.verdict(key, pairs) for pairs in drawn)
    assert least <= share["worse"] / 2000 <= most and least <= share["better"] / 2000 <= most


# -- the page ----------------------------------------------------------------------------------------------------------


def small_page(rmse_m: float = 0.1) -> page.Page:
    runs = {
        seed: figures(record([rmse_m + 0.01 * seed] * 20, [0.95] * 20), stated=True) | {"ms": 5.0} for seed in range(5)
    }
    wrong = {seed: figures(record([9.0] * 20, [0.95] * 20)) for seed in range(5)}
    found = {seed: runs[seed] if seed % 2 else wrong[seed] for seed in range(5)}
    whole = {"real: a, on b": runs, "real: start unknown": found, "wrong map: a on c": wrong}
    return {title: {seed: page.rounded(one) for seed, one in row.items()} for title, row in whole.items()}


def test_the_page_has_median_and_worst_and_counts_what_never_came() -> None:
    text = page.markdown(small_page())
    assert "| real | RMSE m | heading ° |" in text
    assert "| a, on b | 0.1200 (0.1400) | 0.00 |" in text, "the worst is left out where it does not differ"
    assert "| start unknown | never (3 never) |" in text
    assert "| wrong map | sure % | sure, wrong % |" in text, "what no run has is left out"
    for figure in ("rmse_m", "sure_wrong", "log_score"):
        assert text.count(FIGURES[figure].meaning) == 1
    assert FIGURES["recall"].meaning not in text


def test_pages_are_compared_by_the_rows_and_seeds_that_both_have() -> None:
    before, now = small_page(), small_page(0.2)
    now["real: new"] = now["real: a, on b"]
    del before["real: a, on b"][4]
    found = page.compared(before, now)
    assert {one.title for one in found} == set(before)
    worse = [(one.title, one.key) for one in found if one.verdict == "worse"]
    assert worse == [("real: a, on b", "rmse_m"), ("real: a, on b", "median_m")]
    assert {one.verdict for one in page.compared(now, now)} == {""}
    text = page.comparison(found, "HEAD~3")
    assert "worse: 2\n- real: a, on b: RMSE m 0.1150 → 0.2150, median m 0.1150 → 0.2150\n" in text
    assert "better: 0" in text


# -- rows and program --------------------------------------------------------------------------------------------------


def test_to_be_sure_is_no_merit_on_a_wrong_map(monkeypatch: pytest.MonkeyPatch) -> None:
    """A short drive on another floor of the building: what is judged there is what no filter should do."""
    monkeypatch.setattr(rows, "MINUTES", 0.1)
    (row,) = (one for one in every_row() if one.title == "wrong map: floor on another's")
    values = row.judged(1)
    assert set(values) == {"sure_wrong", "ece", "log_score", "warned_s", "ms"}
    assert 0.0 <= values["sure_wrong"] <= 1.0 and values["log_score"] < 0.0


def test_titles_are_unique_and_every_situation_has_a_row() -> None:
    every = every_row()
    assert len({row.title for row in every}) == len(every)
    groups = Counter(row.group for row in every)
    named = {
        "real",
        "edges",
        "rendered",
        "simulated",
        "trust",
        "wrong map",
        "worn map",
        "half a map",
        "floors",
        "markers",
        "faults",
    }
    assert set(groups) == named
    assert every[0].group == "real" and 15 < sum(row.quick for row in every) < 25


def test_the_committed_page_has_only_rows_that_there_are() -> None:
    """A row that goes has to go from there as well, and the changelog says why."""
    committed = ROOT / "benchmarks" / "scoreboard.json"
    kept = page.load(committed)
    assert list(kept) == [row.title for row in every_row()]
    assert (ROOT / "docs" / "scoreboard.md").read_text(encoding="utf-8") == page.markdown(kept)


@pytest.mark.slow  # quick: the tests above hold the parts
def test_program_writes_its_page_and_compares_with_it(tmp_path, monkeypatch, capfd):
    """The log that ships, twice: the same figures but for times, and for one that the page is told to be better."""
    title, saved = "rendered: corridor, line", tmp_path / "page.json"
    monkeypatch.setenv("LOCALISER_SCOREBOARD", str(tmp_path / "kept"))

    def ran(*options: str) -> tuple[int, str, str]:
        monkeypatch.setattr(sys, "argv", ["scoreboard.py", "--only", title, "--seeds", "0-1", *options])
        code = scoreboard.main()
        return code, *capfd.readouterr()

    code, out, err = ran("--save", str(saved), "--page", str(tmp_path / "page.md"))
    assert code == 0 and "1/1 rendered: corridor, line\n" in err
    assert out.splitlines()[2].startswith("| corridor, line | 0.0")
    assert (tmp_path / "page.md").read_text().endswith("\n".join(out.splitlines()[:3]) + "\n\n")
    before = page.load(saved)
    for values in before[title].values():
        values["heading_deg"] -= 0.02
    before["rendered: mine"] = before[title]
    page.save(saved, before)
    code, out, _ = ran("--against", str(saved))
    assert code == 1 and "worse: 1\n- rendered: corridor, line: heading ° " in out and "better: 0" in out
    assert "no longer among the rows: rendered: mine" in out


def test_every_mechanism_can_be_switched_off() -> None:
    """In a process of its own, as nothing is switched on again."""
    code = "from board.off import MECHANISMS, switch_off; switch_off(','.join(MECHANISMS))"
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT / "benchmarks", capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
