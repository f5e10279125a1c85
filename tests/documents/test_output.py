"""Drafts leave alone who writes beside us and what lies there; names of others are text wherever they are shown."""

import os
from dataclasses import replace
from pathlib import Path

import pytest
from folders import ROOT
from hypothesis import given
from hypothesis import strategies as st

from localiser.commands.map.pictures import draw_map
from localiser.commands.options import show
from localiser.documents import drafted, dump, load, parse, plain_name, write_text
from localiser.errors import InputError, OutputError
from localiser.evaluate import new_table
from localiser.storage import csv_text, open_log, read_map, read_runs, write_log, write_map
from localiser.storage.cameras import camera_from_document


def test_two_that_write_one_path_at_once_do_not_meet(tmp_path: Path) -> None:
    path = tmp_path / "log"
    with pytest.raises(OutputError, match="log: cannot be written"), drafted(path) as other, drafted(path) as one:
        for number, folder in enumerate((one, other)):
            folder.mkdir()
            (folder / "whose").write_text(str(number))
    assert (path / "whose").read_text() == "0", "the first to end"
    assert [file.name for file in tmp_path.iterdir()] == ["log"]


def test_what_is_new_is_not_written_over_what_came_in_between(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    with pytest.raises(OutputError, match="expected a path where nothing is"), drafted(path, is_new=True) as draft:
        draft.write_text("second")
        path.write_text("first")
    assert path.read_text() == "first"
    assert [file.name for file in tmp_path.iterdir()] == ["a.mcap"]


def test_a_folder_of_the_users_is_not_taken_for_a_draft(tmp_path: Path) -> None:
    (tmp_path / ".text.part").mkdir()
    (tmp_path / ".text.part" / "mine").write_text("mine")
    write_text(tmp_path / "text", "\udcff ü")
    assert (tmp_path / ".text.part" / "mine").read_text() == "mine"
    assert (tmp_path / "text").read_text() == "\\udcff ü"


def test_a_name_as_long_as_the_system_allows_can_be_written(tmp_path: Path) -> None:
    write_text(tmp_path / ("x" * 255), "content")
    assert (tmp_path / ("x" * 255)).read_text() == "content"


def test_a_name_that_is_no_text_is_written_as_its_escape() -> None:
    name = os.fsdecode(b"b\xff")
    assert parse(dump({"path": name, "parts": [name]}), "").value == {"path": "b\\udcff", "parts": ["b\\udcff"]}


def test_an_error_is_one_paragraph_that_a_terminal_does_not_act_on() -> None:
    said = str(InputError("expected x,\n  found \x1b[2J", path="a\u202eb", line=3))
    assert said == "a\\u202eb:3: expected x, found \\x1b[2J"
    assert len(str(InputError("a" * 10**6))) < 3000


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="pipes with names")
def test_a_pipe_or_a_device_is_not_written_over(tmp_path: Path) -> None:
    """Root could put a file in the place of /dev/null."""
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "link").symlink_to(tmp_path / "pipe")
    (tmp_path / "null").symlink_to(os.devnull)
    for name in ("pipe", "link", "null"):
        with pytest.raises(OutputError, match=f"{name}: expected a file, or a path where nothing is, found a device"):
            write_text(tmp_path / name, "text")
    assert (tmp_path / "pipe").is_fifo() and Path(os.devnull).is_char_device()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["link", "null", "pipe"]


HOSTILE = "=1+1 \x1b]0;owned\a\u202e[red]$\\frac{<script>|`x`"
CLEAN = r"_1+1 \x1b]0;owned\x07\u202e[red]$\frac{_script___x_"


@given(st.text())
def test_a_cleaned_name_stays_as_it_is(name: str) -> None:
    clean = plain_name(name)
    assert plain_name(clean) == clean and clean.isprintable() and len(clean) <= 200
    assert not set("<>|`\n") & set(clean) and clean[:1] not in ("=", "+", "-", "@")


def test_names_of_maps_cameras_landmarks_and_logs_are_cleaned_where_they_are_read(tmp_path: Path) -> None:
    corridor = open_log(ROOT / "logs" / "corridor")
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
    assert read[0]["error"] == r"\x1b[2J" and not any("\x1b" in str(value) for value in read[0].values())
