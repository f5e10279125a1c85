"""The table of marks: its times, what may be left out, and what is wrong with it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from localiser.calibration import MARK_SIGMA_M, MARK_SIGMA_RAD
from localiser.errors import InputError
from localiser.storage import read_marks


def written(path: Path, text: str) -> Path:
    file = path / "marks.csv"
    file.write_text(text)
    return file


def test_times_count_from_the_first_odometry_and_the_rest_has_defaults(tmp_path: Path) -> None:
    text = "t_s,x,z,heading_deg,sigma_m\n0.5,1,2,90,0.02\n\n31.25,4,-3,,\n"
    table = read_marks(written(tmp_path, text), 1_000)
    first, second = table.marks
    assert (first.t_ns, first.x_m, first.z_m, first.sigma_m) == (500_001_000, 1.0, 2.0, 0.02)
    assert first.heading_rad == pytest.approx(np.pi / 2)
    assert (second.t_ns, second.sigma_m) == (31_250_001_000, MARK_SIGMA_M)
    assert second.sigma_rad == pytest.approx(MARK_SIGMA_RAD)
    assert np.isnan(second.heading_rad)
    assert (table.lines, table.time) == ([2, 4], "t_s")
    assert read_marks(written(tmp_path, "t_ns,x,z\n7,0,0\n9,1,1\n"), 1_000).marks[0].t_ns == 7


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("x,z\n0,0\n1,1\n", r"marks.csv:1: expected one column of times, t_s or t_ns, found none"),
        ("t_s,t_ns,x,z\n0,0,0,0\n1,1,1,1\n", r"found t_s and t_ns"),
        ("t_s,x,z\n0,0,0\n1,east,1\n", r"marks.csv:3: x: expected a number, found 'east'"),
        ("t_s,x,z,sigma_m\n0,0,0,-1\n1,1,1,\n", r"marks.csv:2: sigma_m: expected a number above 0"),
        ("t_s,x,z\n0,0,0\n", r"expected at least 2 rows"),
        ("t_s,x,z\n0,0,0\n9.5e9,1,1\n", r"marks.csv:3: t_s: expected a time below 2\^62 ns"),
    ],
)
def test_what_is_wrong_is_named(tmp_path: Path, text: str, told: str) -> None:
    with pytest.raises(InputError, match=told):
        read_marks(written(tmp_path, text), 0)


def test_a_time_long_after_the_odometry_does_not_wrap(tmp_path: Path) -> None:
    first_ns = 1_700_000_000 * 10**9
    assert (
        read_marks(written(tmp_path, "t_s,x,z\n0,0,0\n4.6e9,1,1\n"), first_ns).marks[1].t_ns == first_ns + 46 * 10**17
    )
