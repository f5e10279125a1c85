"""Rows of edges, and their picture with the lines that the mount alone predicts."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from edge_images import camera_of
from hypothesis import given
from hypothesis import strategies as st

from localiser.camera import Camera
from localiser.commands.edge_picture import bearings_shown, draw_picture, horizon, meridian
from localiser.commands.edge_search import COLUMNS, csv_text, rows_of, stems_of
from localiser.edges import Edges

CAMERA = camera_of(640, 480, tilt_deg=20.0)


def edges_of(ends_px: list[list[list[float]]], camera: Camera = CAMERA) -> Edges:
    ends = np.array(ends_px, dtype=np.float64).reshape(-1, 2, 2)
    sigma = np.full(len(ends), 1e-3)
    lean = camera.lean_of_segments(ends)
    return Edges.from_columns(camera.bearing_of_segments(ends), sigma, lean, sigma, ends_px=ends)


# -- rows -------------------------------------------------------------------------------------------------------------


def test_unknown_values_are_empty_cells() -> None:
    edges = edges_of([[[319.5, 400], [319.5, 100]]])
    (row,) = rows_of(edges)
    text = csv_text(COLUMNS, [row]).splitlines()
    cells = dict(zip(text[0].split(","), text[1].split(","), strict=True))
    assert cells["foot_range_m"] == cells["foot_right_m"] == cells["length_px"] == ""
    assert (cells["slope"], cells["slope_deg"], cells["polarity"]) == ("inf", "90.0", "0")


# -- names of outputs -------------------------------------------------------------------------------------------------


@given(st.lists(st.sampled_from(["a/1.png", "b/1.png", "b/1.jpg", "c/b/1.png", "A/1.png", "ü.png", "ö.png", "..x"]),
                min_size=1, unique=True))  # fmt: skip
def test_outputs_never_share_a_name(names: list[str]) -> None:
    stems = stems_of([Path(name) for name in names])
    assert len({stem.lower() for stem in stems}) == len(names)
    assert all("/" not in stem and not stem.startswith(".") for stem in stems)


# -- what the mount predicts ------------------------------------------------------------------------------------------

CAMERAS = [
    camera_of(640, 480, tilt_deg=20.0, roll_deg=5.0),
    camera_of(320, 240, tilt_deg=-10.0, k1=-0.2),
    camera_of(176, 144, tilt_deg=45.0),
    camera_of(640, 480, tilt_deg=0.0),
]


@pytest.mark.parametrize("camera", CAMERAS, ids=["rolled", "up, bent", "steep", "level"])
def test_meridians_are_images_of_plumb_lines(camera: Camera) -> None:
    shown = bearings_shown(camera)
    assert 3 <= len(shown) <= 12
    drawn = 0
    for bearing in np.deg2rad(shown):
        line = meridian(camera, float(bearing))
        assert camera.bearing_of_segments(np.stack([line, line], axis=1)) == pytest.approx(
            np.full(len(line), bearing), abs=1e-6
        )
        drawn += len(line) > 1
    assert drawn >= len(shown) - 2


@pytest.mark.parametrize("camera", CAMERAS[:2] + CAMERAS[3:], ids=["rolled", "up, bent", "level"])
def test_the_horizon_is_at_the_cameras_height(camera: Camera) -> None:
    rays = camera.level_rays(horizon(camera))
    assert len(rays) > 50
    assert rays[:, 1] == pytest.approx(np.zeros(len(rays)), abs=1e-6)


def test_a_steep_camera_sees_no_horizon() -> None:
    assert len(horizon(CAMERAS[2])) == 0


# -- the picture ------------------------------------------------------------------------------------------------------


def test_every_edge_has_its_number_at_its_top() -> None:
    edges = edges_of([[[300.0 + 40 * i, 300], [300.0 + 40 * i, 100]] for i in range(5)])
    figure = draw_picture(np.full((480, 640), 90, np.uint8), CAMERA, edges, title="row")
    (panel,) = (axes for axes in figure.axes if len(axes.images))
    numbers = {text.get_text(): text.xy for text in panel.texts if text.get_text().isdigit()}
    assert numbers == {str(i + 1): (300.0 + 40 * i, 100.0) for i in range(5)}


def test_a_lower_end_outside_and_one_that_can_be_a_foot_have_each_a_sign() -> None:
    edges = edges_of([[[100, 479], [100, 100]], [[500, 400], [500, 100]]])
    feet = replace(edges, foot_range_m=np.array([np.nan, 2.0]), foot_range_sigma_m=np.array([np.nan, 0.1]))
    figure = draw_picture(np.full((480, 640), 90, np.uint8), CAMERA, feet, title="feet")
    (panel,) = (axes for axes in figure.axes if len(axes.images))
    signs = {}
    for line in panel.lines:
        for u in line.get_xdata():
            if line.get_marker() in {"x", "o"}:
                signs.setdefault(round(float(u)), set()).add((line.get_marker(), line.get_markersize() > 5))
    assert signs == {100: {("x", True)}, 500: {("o", True)}}
    legend = [text.get_text() for text in figure.legends[0].get_texts()]
    assert sum("lower end" in text for text in legend) == 2
