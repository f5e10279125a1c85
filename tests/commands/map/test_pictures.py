"""The pictures of maps: in the style of the report, whatever the user's own."""

from __future__ import annotations

from pathlib import Path

import matplotlib as mpl
import pytest
from folders import ROOT
from matplotlib.figure import Figure

from localiser.commands.map import pictures
from localiser.storage import read_map


def test_a_map_is_drawn_in_the_style_of_the_report(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    drawn: list[Figure] = []
    monkeypatch.setattr(pictures, "save_figure", lambda figure, path: drawn.append(figure))
    with mpl.rc_context({"axes.facecolor": "black"}):
        pictures.draw_map(read_map(ROOT / "maps" / "corridor.yaml"), tmp_path / "map.png")
    (axes,) = drawn[0].axes
    assert not axes.spines["top"].get_visible() and axes.get_facecolor() == (1.0, 1.0, 1.0, 1.0)
    assert (axes.get_title(loc="left"), axes.get_xlabel()) == ("corridor", "x (m)")
