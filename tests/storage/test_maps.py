"""Map files lose nothing, and refuse what would be read wrongly."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from small_log import NEWER

from localiser.documents import Document, Place, dump, parse, plain_name
from localiser.errors import InputError
from localiser.landmarks import LandmarkMap
from localiser.storage import read_map, write_map
from localiser.storage.maps import MOST_LANDMARKS, map_data, map_from_document

coordinate = st.floats(-1e6, 1e6)
key = st.text("abcdefgh_", min_size=2, max_size=6).map(lambda name: f"new_{name}")
extra = st.dictionaries(
    key, st.integers(-(2**62), 2**62) | coordinate | st.text(max_size=5) | st.lists(coordinate, max_size=2), max_size=2
)


NAMES = st.text(max_size=8).map(plain_name)


@st.composite
def maps(draw: st.DrawFn) -> LandmarkMap:
    ids = draw(st.lists(st.integers(-5, 10**6) | NAMES.filter(bool), min_size=1, max_size=5, unique_by=str))
    count = len(ids)

    def column(values: st.SearchStrategy[Any]) -> list[Any]:
        return draw(st.lists(values, min_size=count, max_size=count))

    deviations = column(st.none() | st.tuples(st.floats(0, 10), st.floats(0, 10), st.floats(-0.9, 0.9)))
    cov = [
        np.full((2, 2), np.nan)
        if d is None
        else np.array([[d[0] ** 2, d[0] * d[1] * d[2]], [d[0] * d[1] * d[2], d[1] ** 2]])
        for d in deviations
    ]
    return LandmarkMap(
        name=draw(NAMES),
        ids=tuple(ids),
        points=np.array(column(st.tuples(coordinate, coordinate))),
        cov=np.array(cov),
        bottom_m=np.array(column(st.floats(0, 2) | st.just(np.nan))),
        top_m=np.array(column(st.floats(2, 4) | st.just(np.nan))),
        polarity=np.array(column(st.sampled_from([-1, 0, 1])), dtype=np.int8),
        source=tuple(column(NAMES)),
        extra=tuple(column(extra)),
        header=draw(extra),
    )


def assert_same(first: LandmarkMap, second: LandmarkMap) -> None:
    for name in ("name", "ids", "source", "frame", "extra", "header"):
        assert getattr(first, name) == getattr(second, name), name
    for name in ("points", "cov", "bottom_m", "top_m", "polarity"):
        np.testing.assert_array_equal(getattr(first, name), getattr(second, name), err_msg=name)


@given(maps())
@settings(deadline=None)
def test_map_is_read_back_to_the_last_bit(landmark_map: LandmarkMap) -> None:
    assert_same(map_from_document(parse(dump(map_data(landmark_map)), "f")), landmark_map)


def test_saving_what_was_loaded_keeps_every_key_and_value(tmp_path: Path) -> None:
    (tmp_path / "map.yaml").write_text(NEWER)
    write_map(read_map(tmp_path / "map.yaml"), tmp_path / "saved.yaml")
    expected = yaml.safe_load(NEWER)
    expected["landmarks"][1]["cov"] = {"xx": 1e-4, "xz": 0.0, "zz": 4e-4}  # PyYAML reads 1e-4 as a text
    assert yaml.safe_load((tmp_path / "saved.yaml").read_text()) == expected


def test_landmarks_are_written_one_a_line(tmp_path: Path) -> None:
    write_map(LandmarkMap.from_points(np.zeros((100, 2)), name="many"), tmp_path / "map.yaml")
    lines = (tmp_path / "map.yaml").read_text().splitlines()
    assert sum(line.startswith("- {id: ") and line.endswith("}") for line in lines) == 100


def problem(change: str, to: str) -> str:
    assert change in NEWER
    with pytest.raises(InputError) as caught:
        map_from_document(parse(NEWER.replace(change, to), "map.yaml"))
    return str(caught.value)


@pytest.mark.parametrize(
    ("change", "to", "expected"),
    [
        ("id: jamb", "id: 3", "map.yaml:7:4: landmarks[1].id: expected an id of its own, found 3 as in line 6"),
        ("id: jamb", "id: '3'", "map.yaml:7:4: landmarks[1].id: expected an id of its own, found '3' as in line 6"),
        ("id: jamb", "id: 1.5", "map.yaml:7:4: landmarks[1].id: expected"),
        ("x: 1.25", "x: .nan", "map.yaml:6:11: landmarks[0].x: expected a finite number, found nan"),
        ("x: 1.25", "x: 1e9", "map.yaml:6:11: landmarks[0].x: expected less than or equal to 1000000"),
        ("x: 1.25, ", "", "map.yaml:6:3: landmarks[0].x: expected a value, found nothing"),
        ("top_m: 2.05", "top_m: -1", "landmarks[0].top_m: expected a top above the bottom at 0.0, found -1.0"),
        ("xx: 1e-4", "xx: -1", "landmarks[1].cov.xx: expected greater than or equal to 0"),
        ("xz: 0.0", "xz: 1", "landmarks[1].cov: expected a covariance with xz² ≤ xx·zz"),
        ("polarity: -1", "polarity: 2", "landmarks[1].polarity: expected -1 or 1, found 2"),
        ("units: m", "units: cm", "map.yaml:4:44: frame.units: expected 'm', found 'cm'"),
        ("map/1", "map/2", "map.yaml:1:1: format: expected 'localiser-map/1', found 'localiser-map/2'"),
        (NEWER[NEWER.index("landmarks") :], "landmarks: []", "landmarks: expected at least 1, found 0"),
        (NEWER[NEWER.index("landmarks") :], "", "map.yaml:1:1: landmarks: expected a value, found nothing"),
    ],
)
def test_errors_name_line_and_field(change: str, to: str, expected: str) -> None:
    assert expected in problem(change, to)


def test_a_map_of_too_many_landmarks_is_refused() -> None:
    marks = [{"id": 1, "x": 0.0, "z": 0.0}] * (MOST_LANDMARKS + 1)
    document = Document({"format": "localiser-map/1", "landmarks": marks}, {(): Place("map.yaml")})
    with pytest.raises(InputError, match=r"map.yaml: landmarks: expected at most 100000, found 100001"):
        map_from_document(document)
