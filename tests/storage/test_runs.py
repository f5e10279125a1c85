"""Folders of runs, and files that are complete after every image."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from batches import row

from localiser.edges import Edges
from localiser.errors import InputError, OutputError
from localiser.filter import Located, LocatedFrame
from localiser.geometry import Array, Increment
from localiser.observation import Matches
from localiser.particles import Estimate, Particles
from localiser.storage import (
    RunFolder,
    TrackWriter,
    csv_text,
    find_run,
    json_text,
    read_figures,
    read_json,
    read_poses,
    read_runs,
    read_track,
    write_text,
)

COV = np.array([[0.04, 0.01, 0.0], [0.01, 0.09, -0.001], [0.0, -0.001, 0.0025]])


def located(t_ns: int, names: tuple[str, ...] = ("x", "z", "heading")) -> Located:
    count = len(names)
    cov = np.diag(np.full(count, 0.25))
    cov[:3, :3] = COV
    mean = np.array([1.0, -2.0, 2.5, 0.5, 0.25])[:count] + t_ns / 1e9
    return Located(
        t_ns=t_ns,
        estimate=Estimate(names, mean, cov),
        particles=Particles(names, np.zeros((count, 1)), np.zeros(1)),
        ess=12.5,
        edges=Edges.from_columns(*np.full((4, 3), 0.1)),
        increment=Increment.from_mean(np.zeros(3)),
        odometry=np.array([0.1, 0.2, 0.3]),
        matches=Matches.none(1, 0),
    )


def frame(result: Located, truth: Array | None = None) -> LocatedFrame:
    return LocatedFrame(result, None, truth, {})


def test_runs_are_numbered_and_latest_points_to_the_last(tmp_path: Path) -> None:
    folders = [RunFolder.create(tmp_path, "my log").path for _ in range(3)]
    assert [folder.name for folder in folders] == ["1", "2", "3"]
    assert {folder.parent.name for folder in folders} == {"my_log"}
    assert (tmp_path / "my_log/latest").readlink() == Path("3")
    (tmp_path / "my_log/10").mkdir()
    assert RunFolder.create(tmp_path, "my log").path.name == "11"


def test_there_is_no_latest_where_links_cannot_be_made(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object, **__: object) -> None:
        raise OSError("not supported")

    monkeypatch.setattr(Path, "symlink_to", refuse)
    run = RunFolder.create(tmp_path, "log")
    (run.path / "trajectory.csv").touch()
    assert [entry.name for entry in (tmp_path / "log").iterdir()] == ["1"]
    assert find_run(tmp_path / "log/1") == run.path


def test_number_that_another_run_takes_is_skipped(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "log/1").mkdir(parents=True)
    monkeypatch.setattr(Path, "iterdir", lambda _: iter(()))  # as if it were made after looking
    assert RunFolder.create(tmp_path, "log").path.name == "2"


@pytest.mark.parametrize("name", ["../../etc", "a/b", ".", "..", "...", "", "con:1", "ü" * 5])
def test_name_of_a_log_cannot_leave_the_folder(tmp_path: Path, name: str) -> None:
    run = RunFolder.create(tmp_path / "results", name)
    assert run.path.resolve().parent.parent == (tmp_path / "results").resolve()


def test_folder_that_cannot_be_written_says_so(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(OutputError, match="file/log: cannot be written: Not a directory"):
        RunFolder.create(tmp_path / "file", "log")


def test_what_is_no_run(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"expected the folder of a run, with a trajectory\.csv"):
        find_run(tmp_path)


def test_track_is_read_back(tmp_path: Path) -> None:
    writer = TrackWriter(tmp_path)
    for t_ns in (0, 100_000_000, 250_000_000):
        writer.frame(frame(located(t_ns), np.array([1.0, 2.0, 3.0])))
    writer.close(True)
    track = read_track(tmp_path / "trajectory.csv")
    np.testing.assert_array_equal(track.t_ns, [0, 100_000_000, 250_000_000])
    np.testing.assert_allclose(track.poses[1], [1.1, -1.9, 2.6])
    np.testing.assert_allclose(track.covs[2], COV)
    np.testing.assert_allclose(track.odometry, np.tile([0.1, 0.2, 0.3], (3, 1)))
    np.testing.assert_array_equal(track.edges, [3, 3, 3])
    np.testing.assert_allclose(read_poses(tmp_path / "trajectory.tum").poses, track.poses, atol=2e-9)
    np.testing.assert_allclose(read_poses(tmp_path / "groundtruth.tum").poses[0], [1, 2, 3], atol=2e-9)


def test_first_columns_are_those_that_were_promised(tmp_path: Path) -> None:
    TrackWriter(tmp_path).close(True)
    header = (tmp_path / "trajectory.csv").read_text()
    assert header.startswith("t_ns,x,z,heading,cov_xx,cov_xz,cov_xh,cov_zz,cov_zh,cov_hh,ess,")


def test_files_are_whole_after_every_image_without_being_closed(tmp_path: Path) -> None:
    writer = TrackWriter(tmp_path)
    for frames, t_ns in enumerate((0, 1, 2), start=1):
        writer.frame(frame(located(t_ns)))
        assert len(read_track(tmp_path / "trajectory.csv")) == frames
        assert len(read_poses(tmp_path / "trajectory.tum")) == frames
    assert not (tmp_path / "groundtruth.tum").exists()
    writer.close(False)


def test_biases_follow_as_further_columns(tmp_path: Path) -> None:
    writer = TrackWriter(tmp_path)
    writer.frame(frame(located(0, ("x", "z", "heading", "scale", "veer"))))
    header, row = (line.split(",") for line in (tmp_path / "trajectory.csv").read_text().splitlines())
    assert header[-4:] == ["scale", "scale_sigma", "veer", "veer_sigma"]
    assert [float(cell) for cell in row[-4:]] == [0.5, 0.5, 0.25, 0.5]
    assert len(read_track(tmp_path / "trajectory.csv")) == 1
    writer.close(True)


def test_poses_on_several_maps_are_no_track(tmp_path: Path) -> None:
    """Each map has a frame of its own: a pose on the wrong floor would be compared with the truth of another."""
    writer = TrackWriter(tmp_path)
    for t_ns, floor in enumerate(("ground", "ground", "first")):
        writer.frame(replace(frame(located(t_ns)), map_name=floor))
        if floor == "ground":
            assert len(read_track(tmp_path / "trajectory.csv")) == t_ns + 1
    with pytest.raises(InputError, match=r"csv:4: map: expected poses on one map.*'ground', found 'first'"):
        read_track(tmp_path / "trajectory.csv")
    writer.close(True)


def test_odometry_that_is_not_known_is_an_empty_cell(tmp_path: Path) -> None:
    writer = TrackWriter(tmp_path)
    event = located(0)
    event.odometry[:] = np.nan
    writer.frame(frame(event))
    assert np.isnan(read_track(tmp_path / "trajectory.csv").odometry).all()
    writer.close(True)


def test_folder_that_vanishes_is_an_output_error(tmp_path: Path) -> None:
    with pytest.raises(OutputError, match=r"trajectory\.tum: cannot be written"):
        TrackWriter(tmp_path / "missing")


def test_json_is_sorted_plain_and_has_no_nan() -> None:
    data = {"b": np.float64(0.5), "a": [np.nan, np.inf, np.int64(3)], "c": {"y": np.array([1.0, np.nan]), "x": None}}
    text = json_text(data)
    assert json.loads(text) == {"a": [None, None, 3], "b": 0.5, "c": {"x": None, "y": [1.0, None]}}
    assert list(json.loads(text)) == ["a", "b", "c"]
    assert text == json_text(dict(reversed(data.items())))


def test_json_is_read_back_and_errors_have_a_place(tmp_path: Path) -> None:
    write_text(tmp_path / "metrics.json", json_text({"frames": 3}))
    assert read_json(tmp_path / "metrics.json") == {"frames": 3}
    for text, expected in (
        ('{"a": 1,\n}', r"metrics\.json:2:1: not valid JSON"),
        ("[1]", "expected keys and values"),
        ("[" * 100_000, "not valid JSON"),
    ):
        (tmp_path / "metrics.json").write_text(text)
        with pytest.raises(InputError, match=expected):
            read_json(tmp_path / "metrics.json")


# -- tables of many runs ----------------------------------------------------------------------------------------------


ROWS = [
    row("a, b", 0, 0.125, frames=205, **{"set.mcl.particles": "500", "nees_mean": 3}),
    row("c", 1, None, **{"set.mcl.particles": "600"}),
]


def test_a_table_gives_the_rows_back(tmp_path: Path) -> None:
    (tmp_path / "runs.csv").write_text(csv_text(ROWS))
    expected = [one | {"frames": one.get("frames"), "nees_mean": one.get("nees_mean")} for one in ROWS]
    assert read_runs(tmp_path / "runs.csv") == expected


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("log,log_id,seed,nees_mean\nhouse,x,0,good\n", r"runs\.csv:2: nees_mean: expected a number .* found 'good'"),
        ("log,log_id,seed\nhouse,x,first\n", r"runs\.csv:2: seed: expected a number .* found 'first'"),
        ("log,seed\nhouse,0\n", "expected a column 'log_id'"),
        ("log,log_id,seed\n", "expected at least one run, found none"),
    ],
)
def test_a_bad_table_is_refused_by_line_and_column(tmp_path: Path, text: str, said: str) -> None:
    (tmp_path / "runs.csv").write_text(text)
    with pytest.raises(InputError, match=said):
        read_runs(tmp_path / "runs.csv")


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ('{"frames": "many"}', "frames: expected a whole number, found 'many'"),
        ('{"frames": 1.5}', "frames: expected a whole number, found 1.5"),
        ('{"nees_mean": [1]}', r"nees_mean: expected a number, found \[1\]"),
        ('{"nees_mean": 1e400}', "nees_mean: expected a number, found inf"),
        ('{"map": 3}', "map: expected a text, found 3"),
    ],
)
def test_figures_of_another_type_are_told(tmp_path: Path, text: str, said: str) -> None:
    (tmp_path / "row.json").write_text(text)
    with pytest.raises(InputError, match=said):
        read_figures(tmp_path / "row.json")


def test_a_name_that_is_no_text_fits_into_the_table(tmp_path: Path) -> None:
    rows = [row("a", 0, 0.1, log_path="b\udcff")]
    write_text(tmp_path / "runs.csv", csv_text(rows))
    assert read_runs(tmp_path / "runs.csv")[0]["log_path"] == "b\\udcff"
