"""Whatever a file holds, a reader gives a value or an InputError, never another exception."""

import random
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from attack_inputs import mutated
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from small_log import CAMERA, NEWER, write_edge_log, write_small_log

from localiser.config import Config, read_config, to_yaml
from localiser.errors import InputError
from localiser.storage import ImageEvent, open_log, read_camera, read_json, read_map, read_poses, read_track
from localiser.storage.edge_tables import read_edges
from localiser.storage.images import read_image

SEEDS = st.integers(0, 2**32 - 1)
FUZZ = settings(suppress_health_check=[HealthCheck.function_scoped_fixture])

TRACK = (
    b"t_ns,x,z,heading,cov_xx,cov_xz,cov_xh,cov_zz,cov_zh,cov_hh,ess\n0,1,2,3,1,0,0,1,0,1,5\n9,1,2,3,1,0,0,1,0,1,5\n"
)


@pytest.fixture(scope="module")
def logs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("fuzz")
    write_small_log(folder / "images")
    write_edge_log(folder / "edges")
    return folder


READERS: dict[str, tuple[Callable[[Path], Any], str | bytes]] = {
    "map.yaml": (read_map, NEWER),
    "camera.yaml": (read_camera, "images/camera.yaml"),
    "odometry.csv": (read_poses, "images/odometry.csv"),
    "edges.csv": (lambda path: read_edges(path, CAMERA), "edges/edges.csv"),
    "image.jpg": (lambda path: read_image(path, (CAMERA.width, CAMERA.height)), "images/images/000000.jpg"),
    "poses.tum": (read_poses, b"# t\n0.5 1 2 0 0 0 0 1\n1e9 1 2 0 0 0 0 1\n"),
    "track.csv": (read_track, TRACK),
    "metrics.json": (read_json, b'{"frames": 3, "rmse": [0.1, null]}'),
    "config.yaml": (read_config, to_yaml(Config())),
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
@given(seed=SEEDS)
def test_changed_files(logs: Path, tmp_path: Path, name: str, seed: int) -> None:
    read, valid = READERS[name]
    whole = content(logs, valid)
    (tmp_path / "whole").write_bytes(whole)
    assert read(tmp_path / "whole") is not None
    (tmp_path / name).write_bytes(mutated(whole, Path(name).suffix, random.Random(seed)))
    gives_a_value_or_an_input_error(read, tmp_path / name)


@pytest.mark.parametrize("name", READERS)
@FUZZ
@given(data=st.binary(max_size=200))
def test_arbitrary_bytes(tmp_path: Path, name: str, data: bytes) -> None:
    (tmp_path / name).write_bytes(data)
    gives_a_value_or_an_input_error(READERS[name][0], tmp_path / name)


def replay(path: Path | str) -> None:
    for event in open_log(path).events():
        if isinstance(event, ImageEvent):
            event.load()


@pytest.mark.parametrize("log", [pytest.param("images", marks=pytest.mark.slow), "edges"])
@FUZZ
@given(seed=SEEDS)
def test_changed_logs(logs: Path, tmp_path: Path, log: str, seed: int) -> None:
    """Any one file of a log is changed; the log is opened and all its images are loaded."""
    rng, copy = random.Random(seed), tmp_path / "log"
    shutil.rmtree(copy, ignore_errors=True)
    shutil.copytree(logs / log, copy)
    file = rng.choice(sorted(path for path in copy.rglob("*") if path.is_file()))
    file.write_bytes(mutated(file.read_bytes(), file.suffix, rng))
    gives_a_value_or_an_input_error(replay, copy)


@FUZZ
@given(st.text(max_size=40))
def test_any_option(text: str) -> None:
    for option in (text, f"mcl.particles={text}", f"{text}=3"):
        try:
            read_config(None, [option])
        except InputError:
            continue
