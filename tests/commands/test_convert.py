"""`localiser convert`, and `localiser replay` of what it wrote; `localiser odometry fit`."""

import json
from itertools import pairwise
from pathlib import Path

import pytest
from short_log import CORRIDOR, FEW_PARTICLES, FRAMES, Localiser, cut_log
from small_bag import Recorder, bag
from small_log import write_small_log

from localiser.config import read_config
from localiser.motion import MotionParameters
from localiser.storage import open_log


def files(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


@pytest.mark.parametrize("suffix", [".jpg", ".png"])
def test_a_chain_of_conversions_changes_nothing_after_the_first_step(localiser, tmp_path, suffix):
    source = write_small_log(tmp_path / "log", suffix)
    with (source / "log.yaml").open("a") as file:
        file.write("motion: {alpha1: 0.02}\n")
    first = tmp_path / "first"
    chain = (source, tmp_path / "a.mcap", first, tmp_path / "b.db3", tmp_path / "c.bag", tmp_path / "e")
    for start, end in pairwise(chain):
        assert localiser("convert", start, end).exit_code == 0
    last = files(tmp_path / "e")
    last["log.yaml"] = last["log.yaml"].replace(b"name: e\n", b"name: first\n")
    assert last == files(first)
    before = files(source)
    for name, data in files(first).items():
        if name.startswith("images"):
            assert data == before[name]
    assert set(files(first)) == set(before)


def test_a_bag_replays_as_the_folder_does(localiser: Localiser, tmp_path: Path) -> None:
    log = cut_log(CORRIDOR, tmp_path / "corridor", FRAMES)
    localiser("convert", log, tmp_path / "corridor.bag")
    tracks, figures = [], []
    for index, path in enumerate((log, tmp_path / "corridor.bag")):
        run = localiser.replay(path, tmp_path / str(index))
        tracks.append((run / "trajectory.csv").read_text())
        figures.append(json.loads((run / "metrics.json").read_text())["position_rmse_m"])
    assert tracks[0] == tracks[1]
    assert figures[0] == figures[1]


@pytest.mark.parametrize(
    ("name", "option", "problem"),
    [
        ("x", ("--topic", "odometry"), "--topic: expected KIND=NAME, such as odometry=/odom, found 'odometry'"),
        ("x", ("--topic", "odometry=/odom"), "--topic is for ROS bags"),
        ("log", (), "expected a new or empty folder"),
        *(
            ("x", (f"--every={every}",), "--every: expected seconds above 0, such as 0.2s")
            for every in ("0", "0s", "-1", "fast", "nan", "1e3", "")
        ),
    ],
)
def test_what_cannot_be_done(localiser, tmp_path, name, option, problem):
    source = write_small_log(tmp_path / "log")
    before = files(tmp_path)
    result = localiser("convert", source, tmp_path / name, *option, "--quiet")
    assert result.exit_code == 2 and problem in " ".join(result.err.split())
    assert files(tmp_path) == before


@pytest.mark.data
@pytest.mark.slow
def test_the_bag_of_house_has_the_figures_of_its_first_20_s(localiser, tmp_path, data_dir):
    """Same images, and poses to 1e-7: digits that the folder lacks change no more than another seed does, 2 mm."""
    house = cut_log(data_dir / "house", tmp_path / "house", 101)
    figures = []
    for index, path in enumerate((house, data_dir / "house_bag")):
        run = localiser.replay(
            path, tmp_path / str(index), "--map", data_dir / "house" / "map.yaml", "--start", "truth", few=False
        )
        figures.append(json.loads((run / "metrics.json").read_text()))
    assert figures[0]["frames"] == figures[1]["frames"] == 101
    assert figures[1]["position_rmse_m"] == pytest.approx(figures[0]["position_rmse_m"], abs=2e-3)


@pytest.mark.parametrize("name", ["kitchen", "kitchen.mcap"])
def test_a_log_gets_the_name_of_what_it_is_converted_to(localiser: Localiser, tmp_path: Path, name: str) -> None:
    source = write_small_log(tmp_path / "log")
    assert localiser("convert", source, tmp_path / name).exit_code == 0
    assert open_log(tmp_path / name).name == "kitchen"


@pytest.mark.parametrize(
    ("every", "kept_s"), [("0.1s", [0.0, 0.1]), ("0.05", [0.0, 0.1, 0.17]), (".17s", [0.0, 0.17]), ("10s", [0.0])]
)
def test_images_are_kept_at_intervals(localiser: Localiser, tmp_path: Path, every: str, kept_s: list[float]) -> None:
    source = write_small_log(tmp_path / "log")
    assert localiser("convert", source, tmp_path / "out", "--every", every).exit_code == 0
    assert [frame.t_ns / 1e9 for frame in open_log(tmp_path / "out").frames] == kept_s


def test_topics_are_chosen_by_option_and_told_unless_quiet(localiser: Localiser, tmp_path: Path) -> None:
    def record(recorder: Recorder) -> None:
        recorder.images()
        recorder.images(topic="/other/image")

    path = bag(tmp_path / "bag", record)
    result = localiser("convert", path, tmp_path / "out", "--quiet")
    assert result.exit_code == 2 and "choose with --topic image=/cam/image" in result.err
    result = localiser("convert", path, tmp_path / "out", "--topic", "image=/other/image")
    assert result.exit_code == 0 and "taken: image /other/image, odometry /odom" in result.err
    result = localiser("convert", path, tmp_path / "quiet", "--quiet", "--topic", "image=/other/image")
    assert (result.exit_code, result.out, result.err) == (0, "", "")


def test_fit_tells_what_it_would_change_and_writes_a_configuration(localiser: Localiser, tmp_path: Path) -> None:
    out = tmp_path / "robot.yaml"
    result = localiser("odometry", "fit", CORRIDOR, "-o", out)
    assert result.exit_code == 0, result.err
    row = next(line.split() for line in result.out.splitlines() if "alpha2" in line)
    found, before = read_config(out).motion, MotionParameters()
    assert float(row[1]) == before.alpha2 and float(row[2]) == pytest.approx(found.alpha2, rel=0.01)
    assert found.alpha2 < before.alpha2, "these wheels are better than most"
    assert found.bias.delay_sigma_s == before.bias.delay_sigma_s
    assert "corridor (truth)" in out.read_text()
    again = localiser("odometry", "fit", CORRIDOR, "-o", out)
    assert again.exit_code == 2 and "expected a new file" in again.err and "alpha2" not in again.out


@pytest.mark.parametrize(("images", "within"), [(120, 0.25), (205, 0.1)])
@pytest.mark.slow  # quick: tests/calibration/test_clock.py fits the filter's path of simulated wheels
def test_without_a_truth_the_filter_s_path_tells_nearly_the_same(localiser, tmp_path, images, within):
    log, paths = cut_log(CORRIDOR, tmp_path / "log", images), {}
    for name in ("truth", "filter"):
        paths[name] = tmp_path / f"{name}.yaml"
        assert localiser("odometry", "fit", log, "-q", "-o", paths[name], *FEW_PARTICLES).exit_code == 0
        description = (log / "log.yaml").read_text()
        (log / "log.yaml").write_text(description.replace("groundtruth: groundtruth.csv\n", ""))
    true, found = (read_config(path).motion for path in paths.values())
    assert found.bias.distance_sigma == pytest.approx(true.bias.distance_sigma, rel=within)
    assert found.bias.turn_sigma == pytest.approx(true.bias.turn_sigma, rel=within)
    for name in ("alpha2", "alpha3"):
        assert 1 / 3 < getattr(found, name) / getattr(true, name) < 3


def test_a_log_that_is_too_short_is_told(localiser: Localiser, tmp_path: Path) -> None:
    result = localiser("odometry", "fit", write_small_log(tmp_path / "log"))
    assert result.exit_code == 2 and "ten metres" in result.err and "Traceback" not in result.err
