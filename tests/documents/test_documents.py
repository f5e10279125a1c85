"""YAML with the place of every value: what is wrong is named with file, line, column and field."""

import math
import os
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from pydantic import BaseModel, ConfigDict, Field

from localiser import documents
from localiser.errors import InputError


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
