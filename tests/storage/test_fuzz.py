"""Whatever a file holds, a reader gives a value or an InputError, never another exception."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from map_texts import NEWER
from small_log import CAMERA, write_edge_log, write_small_log

from localiser.config import Config, read_config, to_yaml
from localiser.errors import InputError
from localiser.storage import ImageEvent, open_log, read_camera, read_json, read_map, read_poses, read_track
from localiser.storage.edge_tables import read_edges
from localiser.storage.images import read_image

FUZZ = settings(max_examples=150, suppress_health_check=[HealthCheck.function_scoped_fixture])

# What a file may come to hold by accident: numbers at the edges, names of numbers, the marks of the formats.
PIECES = [b"nan", b"-inf", b"1e400", b"-1", b"0", b"", b"9" * 30, b"9" * 5000, b"1_0", b"\xff\xfe", b"\0", b"\r", b"\n"]
PIECES += [
    b",",
    b'"',
    b":",
    b"[" * 300,
    b"{",
    b"&a",
    b"*a",
    b"!!int x",
    b"- ",
    b"  ",
    b"# ",
    b"---\n",
    "é١".encode(),
    b"\xff\xd9",
    b"yes",
]

TRACK = (
    b"t_ns,x,z,heading,cov_xx,cov_xz,cov_xh,cov_zz,cov_zh,cov_hh,ess\n0,1,2,3,1,0,0,1,0,1,5\n9,1,2,3,1,0,0,1,0,1,5\n"
)


@st.composite
def mutated(draw: st.DrawFn, valid: bytes) -> bytes:
    """Return a valid file with up to three pieces put in, taken out or written over."""
    data = valid
    for _ in range(draw(st.integers(1, 3))):
        start = draw(st.integers(0, len(data)))
        length = draw(st.integers(0, 12))
        data = data[:start] + draw(st.sampled_from(PIECES) | st.binary(max_size=4)) + data[start + length :]
    return data


@pytest.fixture(scope="module")
def logs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("fuzz")
    write_small_log(folder / "images")
    write_edge_log(folder / "edges")
    return folder


READERS: dict[str, tuple[Callable[[Path], Any], str | bytes]] = {
    "map": (read_map, NEWER),
    "camera": (read_camera, "images/camera.yaml"),
    "poses": (read_poses, "images/odometry.csv"),
    "edges": (lambda path: read_edges(path, CAMERA), "edges/edges.csv"),
    "image": (lambda path: read_image(path, (CAMERA.width, CAMERA.height)), "images/images/000000.jpg"),
    "tum": (read_poses, b"# t\n0.5 1 2 0 0 0 0 1\n1e9 1 2 0 0 0 0 1\n"),
    "track": (read_track, TRACK),
    "json": (read_json, b'{"frames": 3, "rmse": [0.1, null]}'),
    "config": (read_config, to_yaml(Config())),
}


def content(logs: Path, valid: str | bytes) -> bytes:
    if isinstance(valid, bytes):
        return valid
    return valid.encode() if "\n" in valid else (logs / valid).read_bytes()


def gives_a_value_or_an_input_error(read: Callable[[Path], Any], path: Path) -> None:
    try:
        read(path)
    except InputError as error:
        assert "\n" not in str(error)
        assert len(str(error)) < 1000


@pytest.mark.parametrize("name", READERS)
@FUZZ
@given(data=st.data())
def test_changed_files(logs: Path, tmp_path: Path, name: str, data: st.DataObject) -> None:
    read, valid = READERS[name]
    (tmp_path / "file").write_bytes(data.draw(mutated(content(logs, valid))))
    gives_a_value_or_an_input_error(read, tmp_path / "file")


@pytest.mark.parametrize("name", READERS)
@FUZZ
@given(data=st.binary(max_size=200))
def test_arbitrary_bytes(tmp_path: Path, name: str, data: bytes) -> None:
    (tmp_path / "file").write_bytes(data)
    gives_a_value_or_an_input_error(READERS[name][0], tmp_path / "file")


@pytest.mark.parametrize("name", READERS)
def test_valid_files_are_read(logs: Path, tmp_path: Path, name: str) -> None:
    read, valid = READERS[name]
    (tmp_path / "file").write_bytes(content(logs, valid))
    assert read(tmp_path / "file") is not None


def replay(path: Path | str) -> None:
    for event in open_log(path).events():
        if isinstance(event, ImageEvent):
            event.load()


@pytest.mark.parametrize("log", [pytest.param("images", marks=pytest.mark.slow), "edges"])
@FUZZ
@given(data=st.data())
def test_changed_logs(logs: Path, tmp_path: Path, log: str, data: st.DataObject) -> None:
    """Any one file of a log is changed; the log is opened and all its images are loaded."""
    names = sorted(str(path.relative_to(logs / log)) for path in (logs / log).rglob("*") if path.is_file())
    name = data.draw(st.sampled_from(names))
    copy = tmp_path / "log"
    shutil.rmtree(copy, ignore_errors=True)
    shutil.copytree(logs / log, copy)
    (copy / name).write_bytes(data.draw(mutated((copy / name).read_bytes())))
    gives_a_value_or_an_input_error(replay, copy)


@FUZZ
@given(st.text(max_size=40))
def test_any_option(text: str) -> None:
    for option in (text, f"mcl.particles={text}", f"{text}=3"):
        try:
            read_config(None, [option])
        except InputError:
            continue
