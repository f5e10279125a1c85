"""YAML with the place of every value; drafts that leave alone what lies there; names of others, which are text."""

import math
import os
import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import pytest
from folders import ROOT
from hypothesis import example, given
from hypothesis import strategies as st
from pydantic import BaseModel, ConfigDict, Field

from localiser import documents
from localiser.commands.map.pictures import draw_map
from localiser.commands.options import show
from localiser.documents import drafted, dump, load, parse, plain_name, write_text
from localiser.errors import InputError, OutputError
from localiser.evaluate import new_table
from localiser.storage import csv_text, open_log, read_map, read_runs, write_log, write_map
from localiser.storage.cameras import camera_from_document


@dataclass(frozen=True, slots=True)
class Wheel:
    radius_m: Annotated[float, Field(gt=0)] = 0.1
    spokes: int = 5


class Cart(BaseModel):
    model_config = ConfigDict(extra="forbid", allow_inf_nan=False)

    name: str
    wheels: list[Wheel] = []
    axle: Wheel = Wheel()
    brakes: bool = False


def problem(text: str) -> str:
    with pytest.raises(InputError) as caught:
        documents.validate(documents.parse(text, "cart.yaml"), Cart)
    return str(caught.value)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("name: a\naxle:\n  radius: 3\n", "cart.yaml:3:3: axle.radius: unknown key; the nearest known is 'radius_m'"),
        ("name: a\naxle: {radius_m: -1}", "cart.yaml:2:8: axle.radius_m: expected greater than 0, found -1"),
        ("name: a\nwheels:\n- {}\n- {spokes: x}", "cart.yaml:4:4: wheels[1].spokes: expected a valid integer"),
        ("name: a\naxle: {radius_m: .nan}", "cart.yaml:2:8: axle.radius_m: expected a finite number, found nan"),
        ("name: a\naxle: {spokes: yes}", "cart.yaml:2:8: axle.spokes: expected a number, found true"),
        ("name: a\naxle: 3", "cart.yaml:2:1: axle: expected keys and values, found 3"),
        ("brakes: yes", "cart.yaml:1:1: name: expected a value, found nothing"),
        ("name: a\nname: b", "cart.yaml:2:1: name: given twice"),
        ("- 1", "cart.yaml:1:1: expected keys and values, found [1]"),
        ("", "cart.yaml: expected keys and values, found nothing"),
        ("name: [a", "not valid YAML: "),
        ("name: &n a\naxle: *n", "cart.yaml:2:7: axle: expected a value, found an alias"),
        ("name: !!python/object:os.system a", "cart.yaml:1:7: name: expected plain data, found the tag"),
        ("name: a\n---\nname: b", "cart.yaml:2:1: expected one YAML document, found a second one"),
        ("? [a]\n: b", "cart.yaml:1:3: expected a name as key"),
        ("name: 2024-13-77", "cart.yaml:1:7: name: cannot be read as a value: '2024-13-77'"),
        ("name: 0x" + "f" * 9999, "cart.yaml:1:7: name: expected a number of at most 100 characters"),
        ("name: a\n? " + "b" * 999 + "\n: 1", "…': unknown key"),
        ('name: a\n"b\\nc": 1', r"'b\nc': unknown key"),
        ("name: \x07", "cart.yaml: not valid YAML"),
        ("name: " + "[" * 100_000, "nested more than 40 deep"),
    ],
)
def test_errors_name_file_line_column_and_field(text: str, expected: str) -> None:
    assert expected in problem(text)
    assert "\n" not in problem(text)


def test_a_document_of_too_many_values_is_told_before_it_fills_the_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys.modules["localiser.documents.document"], "MOST_VALUES", 10)
    assert problem("name: a\nwheels:\n" + "- {spokes: 1}\n" * 9).startswith("cart.yaml:6:")
    assert "expected at most 10 values, found more" in problem("name: a\nwheels:\n" + "- {spokes: 1}\n" * 9)


@pytest.mark.parametrize("key", ["1", "2305843009213693951", "1.5", "0x10", ".inf"])
def test_keys_are_names(key: str) -> None:
    """Numbers can be chosen so that thousands of them collide in a table of keys, which then takes hours."""
    with pytest.raises(InputError, match="which needs quotes"):
        documents.parse(f"{key}: 1", "file")
    assert documents.parse(f"'{key}': 1", "file").value == {key: 1}


def test_whole_numbers_have_64_bits() -> None:
    assert documents.parse(f"[{2**63 - 1}, -{2**63 - 1}]", "file").value == [2**63 - 1, 1 - 2**63]
    with pytest.raises(InputError, match=r"file:1:5: \[1\]: expected a whole number of at most 64 bits"):
        documents.parse(f"[1, {2**63}]", "file")


def test_several_problems_are_counted_and_the_first_is_named() -> None:
    # What is misspelt is also missing, which would be the less helpful thing to say.
    assert problem("nam: a") == "cart.yaml:1:1: nam: unknown key; the nearest known is 'name' (and 1 more)"


def test_numbers_with_an_exponent_need_no_point() -> None:
    document = documents.parse("a: 1e-3\nb: -2E+4\nc: '1e-3'\nd: 1e3x", "f")
    assert document.value == {"a": 1e-3, "b": -2e4, "c": "1e-3", "d": "1e3x"}


def test_place_of_what_was_not_written_is_that_of_the_part_around_it() -> None:
    document = documents.parse("a:\n  b: [1, 2]\n", "f")
    assert document.place(("a", "b", 1)) == documents.Place("f", 2, 10)
    assert document.place(("a", "c", "d")) == documents.Place("f", 1, 1)


def test_upper_document_replaces_values_and_lists_but_not_mappings() -> None:
    lower = documents.parse("a: {x: 1, y: [1, 2]}\nb: 2", "lower")
    upper = documents.parse("a: {y: [3]}", "upper")
    both = lower.overlaid(upper)
    assert both.value == {"a": {"x": 1, "y": [3]}, "b": 2}
    assert both.place(("a", "x")).source == "lower"
    assert both.place(("a", "y", 0)).source == "upper"
    assert both.place(("a", "y", 1)).source == "upper"


plain_data = st.recursive(
    st.none() | st.booleans() | st.integers(1 - 2**63, 2**63 - 1) | st.floats(allow_nan=False) | st.text(max_size=20),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=8), inner, max_size=4),
    max_leaves=12,
)


@given(plain_data)
@example({"0E0": None})
@example(["1e-3", "1.e5", "-.5E+3"])
def test_what_is_dumped_is_parsed_back(value: object) -> None:
    assert documents.parse(documents.dump(value), "f").value == value


def test_dumped_mapping_has_a_line_for_each_key_and_one_for_each_innermost_part() -> None:
    text = documents.dump({"a": 1, "b": {"c": [1.0, 2.0], "d": {"e": math.inf}}, "f": [{"x": 1}, {"x": 2}]})
    assert text == "a: 1\nb:\n  c: [1.0, 2.0]\n  d: {e: .inf}\nf:\n- {x: 1}\n- {x: 2}\n"


def test_files_that_are_no_files(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")  # reading one would wait for ever
    (tmp_path / "latin").write_bytes(b"a: 1\nb: \xe9\n")
    (tmp_path / "large").write_bytes(b"a" * 100)
    for name, expected in (
        ("missing", "missing: no such file"),
        (".", "expected a file, found a folder"),
        ("pipe", "expected a file, found a device or pipe"),
        ("latin", "latin:2: expected UTF-8 text, found byte 0xe9"),
        ("a\0b", "cannot be read"),
        ("x" * 1000, "cannot be read"),
    ):
        with pytest.raises(InputError, match=expected):
            documents.load(tmp_path / name)
    with pytest.raises(InputError, match="expected at most 99 bytes, found 100"):
        documents.read_text(tmp_path / "large", 99)


def test_byte_order_mark_is_no_part_of_the_text(tmp_path: Path) -> None:
    (tmp_path / "f.yaml").write_bytes(b"\xef\xbb\xbfa: 1\r\n")
    assert documents.load(tmp_path / "f.yaml").value == {"a": 1}


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
