"""`python -m paper`: the paper's own figures come out, and its motions are measured as exactly as is claimed."""

from collections.abc import Callable

import numpy as np
import pytest
from folders import ROOT

from localiser import geometry
from localiser.edges import Edges
from paper.__main__ import main
from paper.equations import TILT_2_DEG, explanations, one_pixel, steepest_slope, table_1
from paper.motions import DRIVE_M, VIEWS, Measured, Place, Seen, turn_rad
from paper.reproduce import Reproduction, reproduce
from paper.results import METHODS, Method, drive_errors, turn_errors
from paper.room import SIZES
from paper.sheet import Sheet

TILT_RAD = np.deg2rad(TILT_2_DEG)
SMALL, LARGE = SIZES


@pytest.fixture(scope="module")
def reproduced() -> Reproduction:
    return reproduce(2, 0)


def test_help_makes_nothing_anew(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("paper.__main__.reproduce", None)
    monkeypatch.setattr("sys.argv", ["paper", "--help"])
    with pytest.raises(SystemExit):
        main()


# -- what follows from the equations ----------------------------------------------------------------------------------


def numbers(cell: str) -> list[float]:
    return [float(part) for part in cell.replace("±", "").split("–")]


def test_table_1_is_the_papers() -> None:
    for row in table_1().rows:
        printed, psi = float(row[2]), float(row[3])
        assert round(psi, 1) == printed
        assert float(row[4]) == pytest.approx(psi - 20, abs=0.01)


def test_the_steepest_slope_is_66_degrees() -> None:
    row = steepest_slope().rows[0]
    assert row[1:4] == ("60", "30.00", "66.0")
    # In the bottom corner of a 4:3 image 60° across: a = tan 30°, e = -3/4 tan 30°, m = (cot θ + e) / a.
    a = np.tan(np.pi / 6)
    assert float(row[3]) == pytest.approx(np.rad2deg(np.arctan((1 / np.tan(np.pi / 6) - 0.75 * a) / a)), abs=0.05)
    assert float(row[4].rstrip("%")) > 90


def test_one_pixel_moves_psi_by_half_to_two_degrees() -> None:
    rows = {(row[0], row[1]): row for row in one_pixel().rows}
    for end in ("one end", "both ends"):
        low, high = numbers(rows["176×144", end][3])
        assert 0.5 <= low <= high <= 2.0
        assert numbers(rows["176×144", end][4])[1] < low / 2  # by line much less
    # Straight ahead at θ = 30°, J = 1 / s = 2: two pixels over the image's height turn ψ by J · 2 / L.
    largest = np.rad2deg(2 * 2 / 143)
    assert numbers(rows["176×144", "both ends"][3])[1] == pytest.approx(largest, rel=0.15)
    assert numbers(rows["640×480", "both ends"][3])[1] == pytest.approx(largest * 143 / 479, rel=0.15)


def test_what_else_moves_psi() -> None:
    rows = {row[0]: row[1:] for row in explanations().rows}
    exact = rows["nothing else"]
    assert exact[:3] == exact[3:] == rows["paper, by extrinsic parameters"][:3] == ("10.96", "10.33", "10.39")
    assert rows["paper, by eq. 13"][:3] == ("10.72", "8.09", "14.92")
    # Ten centimetres to the left of a jamb two metres away turn it by about atan(0.1 / 2) to the right, at the end.
    drifted = rows["drift by 10 cm to the left, in the last turn"]
    assert drifted[:2] == exact[:2]
    assert 10.39 - float(drifted[2]) == pytest.approx(np.rad2deg(np.arctan(0.1 / 2)), abs=0.3)
    # Design equation 8: by slope a tilt error turns a bearing b by sin 2b cot θ / 2 of itself, by line far less.
    tilted = np.array(rows["tilt is 1° more than stated"], dtype=float) - np.array(exact, dtype=float)
    bearing = np.deg2rad([10.0, -0.96])
    moved = np.diff(np.sin(2 * bearing) / np.tan(TILT_RAD) / 2)
    assert tilted[0] == pytest.approx(-moved[0], abs=0.05)
    assert np.abs(tilted[3:]).max() < np.abs(tilted[:3]).min() / 2
    pixel = [numbers(cell)[0] for cell in rows["one pixel at each end, in both views"]]
    assert pixel[2] > 14.92 - 10.39
    assert max(pixel[3:]) < min(pixel[:3]) / 3


@pytest.mark.parametrize("make", [table_1, steepest_slope, one_pixel, explanations])
def test_the_docs_have_these_tables(make: Callable[[], Sheet]) -> None:
    page = (ROOT / "docs" / "paper.md").read_text()
    assert "\n".join(make().markdown().rstrip().splitlines()[1:]) in page


# -- motions of edges that are measured exactly -----------------------------------------------------------------------


def exact_view(points: np.ndarray, motion: np.ndarray) -> Seen:
    """Return edges at points (L, 2) as a camera sees them without any error after a motion (3,)."""
    seen = geometry.robot_from_map(motion, points)
    bearing = np.arctan2(seen[:, 0], -seen[:, 1])
    sigma = np.full(len(points), 1e-3)
    edges = Edges.from_columns(bearing, sigma, geometry.lean_from_bearing(bearing, TILT_RAD), sigma,
                               polarity=np.ones(len(points), dtype=np.int8))  # fmt: skip
    return Seen(np.arange(len(points)), edges)


@pytest.fixture(scope="module")
def exact() -> Measured:
    points = np.random.default_rng(0).uniform([-0.8, -4.0], [0.8, -2.0], (20, 2))
    turned = tuple(exact_view(points, np.array([0.0, 0.0, -turn_rad(0, view)])) for view in range(VIEWS))
    place = Place(turned, exact_view(points, np.array([0.0, -DRIVE_M, 0.0])), points, ())
    return {(size, detector): [place] for size in SIZES for detector in ("hough", "columns")}


@pytest.mark.parametrize("method", METHODS, ids=lambda method: f"{method.detector} {method.kind}")
def test_exact_edges_give_exact_motions(exact: Measured, method: Method) -> None:
    for by in (1, 2):
        error, sigma = turn_errors(exact, SMALL, method, by)
        assert len(error) == 20 * (VIEWS - by)
        assert error == pytest.approx(np.zeros(len(error)), abs=1e-12)
        assert (sigma > 1e-3).all()
    errors = drive_errors(exact, SMALL, method)
    for key in ("forward_m", "backward_m", "depth"):
        assert errors[key] == pytest.approx(np.zeros(20), abs=1e-9)


# -- rendered images --------------------------------------------------------------------------------------------------


@pytest.mark.slow  # quick: the measured turns of exact edges in this file
def test_rendered_turns_are_measured_as_the_docs_say(reproduced: Reproduction) -> None:
    for by in (1, 2):
        median = {}
        for size in SIZES:
            for method in METHODS:
                error, sigma = turn_errors(reproduced.found, size, method, by)
                assert len(error) >= 8
                assert (sigma > 0).all()
                median[size, method] = np.rad2deg(np.median(np.abs(error)))
        hough, slope, line = METHODS
        assert median[SMALL, hough] > 0.5  # the paper's own: 2.24
        for size in SIZES:
            assert median[size, slope] < median[size, hough]
            assert median[size, line] < median[size, slope] / 3
        assert median[SMALL, line] < 0.05
        assert median[LARGE, line] < 0.02
