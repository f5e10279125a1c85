"""A name that somebody else chose is text, and nothing else, wherever it is shown."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from folders import ROOT
from hypothesis import given
from hypothesis import strategies as st

from localiser.batch.compare import summary_markdown
from localiser.commands.map.pictures import draw_map
from localiser.commands.options import show
from localiser.documents import load, plain_name
from localiser.evaluate import new_table
from localiser.storage import csv_text, open_log, read_map, read_runs, write_log, write_map
from localiser.storage.cameras import camera_from_document

HOSTILE = "=1+1 \x1b]0;owned\a\u202e[red]$\\frac{<script>|`x`"
CLEAN = r"_1+1 \x1b]0;owned\x07\u202e[red]$\frac{_script___x_"


@given(st.text())
def test_a_cleaned_name_stays_as_it_is(name: str) -> None:
    clean = plain_name(name)
    assert plain_name(clean) == clean and clean.isprintable() and len(clean) <= 200
    assert not set("<>|`\n") & set(clean) and clean[:1] not in ("=", "+", "-", "@")


def test_names_of_maps_cameras_landmarks_and_logs_are_cleaned_where_they_are_read(tmp_path: Path) -> None:
    corridor = open_log(ROOT / "logs" / "corridor")
    assert corridor.landmark_map is not None
    named = replace(corridor.landmark_map, name=HOSTILE, ids=(HOSTILE, *corridor.landmark_map.ids[1:]))
    write_map(named, tmp_path / "map.yaml")
    found = read_map(tmp_path / "map.yaml")
    assert (found.name, found.ids[0]) == (CLEAN, CLEAN)
    camera = load(ROOT / "logs" / "corridor" / "camera.yaml")
    assert camera_from_document(replace(camera, value=camera.value | {"camera_name": HOSTILE})).name == CLEAN
    write_log(tmp_path / "log", name=HOSTILE, camera=corridor.camera, odometry=corridor.odometry, images=[
        (frame.t_ns, frame.encoded()) for frame in corridor.images[:1]
    ])  # fmt: skip
    assert open_log(tmp_path / "log").name == CLEAN


def test_a_name_of_a_million_characters_is_cut(tmp_path: Path) -> None:
    write_map(replace(read_map(ROOT / "maps" / "corridor.yaml"), name="n" * 10**6), tmp_path / "map.yaml")
    assert len(read_map(tmp_path / "map.yaml").name) == 200


@pytest.mark.parametrize("name", ["$", "$x", r"$\frac{$", r"a $\undefined$ b"])
def test_dollars_in_a_name_are_drawn(tmp_path: Path, name: str) -> None:
    drawn = []
    for text in (name, "x"):
        draw_map(replace(read_map(ROOT / "maps" / "corridor.yaml"), name=text), tmp_path / "map.png")
        drawn.append((tmp_path / "map.png").read_bytes())
    assert drawn[0] != drawn[1]


def test_markup_in_a_table_is_shown_as_it_is(capsys: pytest.CaptureFixture[str]) -> None:
    table = new_table("[bold]title[/]", "log")
    table.add_row("[red]name[/red]")
    show(table)
    printed = capsys.readouterr().out
    assert "[bold]title[/]" in printed and "[red]name[/red]" in printed


def test_a_table_of_runs_that_somebody_sent_has_no_escapes(tmp_path: Path) -> None:
    row = {"log": HOSTILE, "log_id": "1", "seed": 1, "error": "\x1b[2J", "log_path": "a", "position_rmse_m": 1.0}
    (tmp_path / "runs.csv").write_text(csv_text([row]))
    read = read_runs(tmp_path / "runs.csv")
    assert read[0]["error"] == r"\x1b[2J" and "\x1b" not in summary_markdown(read)
