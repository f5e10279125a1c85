"""Replay, end to end: a log in, files and figures out."""

import csv
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from rerun.chunk import RrdReader
from short_log import CORRIDOR, FEW_PARTICLES, FRAMES, Localiser, cut_log
from small_log import MAP, write_edge_log

from localiser import documents, storage
from localiser.evaluate.metrics import ABOUT
from localiser.replay import evaluate_run
from localiser.view import paths, viewer

COLUMNS = ["t_ns", "x", "z", "heading", "cov_xx", "cov_xz", "cov_xh", "cov_zz", "cov_zh", "cov_hh", "ess"]
TIMES = {"frame_ms_median", "frame_ms_p95", "stage_ms"}
METRICS = {
    "log", "observation", "seed", "particles", "frames", "position_rmse_m", "position_median_m", "position_max_m",
    "position_end_m", "heading_rmse_deg", "odometry_position_rmse_m", "nees_mean",
    "edges_per_frame", "map_sigma_factor",
}  # fmt: skip


@pytest.fixture
def log(tmp_path: Path) -> Path:
    return cut_log(CORRIDOR, tmp_path / "log", FRAMES)


def metrics_of(run: Path) -> dict[str, Any]:
    return dict(json.loads((run / "metrics.json").read_text()))


def rows_of(run: Path) -> list[dict[str, str]]:
    with (run / "trajectory.csv").open() as file:
        return list(csv.DictReader(file))


def logged_frames(run: Path) -> int:
    """Return how many frames the recording holds."""
    chunks = RrdReader(run / "run.rrd").stream()
    return sum(chunk.num_rows for chunk in chunks if chunk.entity_path == f"/{paths.ESTIMATE}")


# -- what a run leaves ------------------------------------------------------------------------------------------------


def test_every_output_is_there_and_can_be_read(localiser: Localiser, log: Path, tmp_path: Path) -> None:
    run = localiser.replay(log, tmp_path / "out", rrd=True, report=True, few=False)
    assert {file.name for file in run.iterdir()} == {
        "config.yaml", "groundtruth.tum", "metrics.json", "report.html", "report.png", "run.rrd", "run.yaml",
        "timing.json", "trajectory.csv", "trajectory.tum",
    }  # fmt: skip

    rows = rows_of(run)
    assert list(rows[0])[: len(COLUMNS)] == COLUMNS
    assert [row["t_ns"] for row in rows] == [line.split(",")[0] for line in image_rows(log)]

    located = storage.read_poses(run / "trajectory.tum")
    np.testing.assert_allclose(located.poses[:, 0], [float(row["x"]) for row in rows], atol=1e-8)
    np.testing.assert_allclose(located.poses[:, 1], [float(row["z"]) for row in rows], atol=1e-8)
    np.testing.assert_allclose(located.poses[:, 2], [float(row["heading"]) for row in rows], atol=1e-8)
    truth = storage.read_poses(run / "groundtruth.tum")
    np.testing.assert_array_equal(truth.t_ns, located.t_ns)
    recorded = storage.read_poses(log / "groundtruth.csv").sampled(located.t_ns)
    np.testing.assert_allclose(truth.poses, recorded.poses, atol=1e-8)

    report = cv2.imread(str(run / "report.png"))
    assert min(report.shape[:2]) > 500
    assert report.std() > 10  # not an empty page
    assert logged_frames(run) == FRAMES

    figures, timing = metrics_of(run), json.loads((run / "timing.json").read_text())
    assert set(figures) >= METRICS
    assert (figures["log"], figures["observation"], figures["seed"], figures["particles"]) == (
        "corridor", "line", 0, 2000,
    )  # fmt: skip
    assert figures["frames"] == FRAMES
    assert figures["complete"] is True
    assert not TIMES & set(figures), "they differ from run to run"
    assert set(timing) == TIMES
    assert evaluate_run(run) == figures | timing
    assert set(timing["stage_ms"]) == {"load", "edges", "filter", "sinks"}


def image_rows(log: Path) -> list[str]:
    return (log / "images.csv").read_text().splitlines()[1:]


def test_metrics_are_those_of_the_files_beside_them(localiser: Localiser, log: Path, tmp_path: Path) -> None:
    run = localiser.replay(log, tmp_path / "out")
    located, truth = storage.read_poses(run / "trajectory.tum"), storage.read_poses(run / "groundtruth.tum")
    error_m = np.hypot(*(located.poses - truth.poses)[:, :2].T)
    figures = metrics_of(run)
    assert figures["position_rmse_m"] == pytest.approx(np.sqrt(np.mean(error_m**2)), abs=1e-6)
    assert figures["position_max_m"] == pytest.approx(error_m.max(), abs=1e-6)
    assert figures["position_end_m"] == pytest.approx(error_m[-1], abs=1e-6)
    last = (run / "trajectory.csv").read_text().splitlines()
    final = dict(zip(last[0].split(","), last[-1].split(","), strict=True))
    for name in ("distance_scale", "turn_scale", "veer", "camera_yaw"):
        learnt = figures["biases"][name]
        assert (learnt["value"], learnt["sigma"]) == pytest.approx(
            (float(final[name]), float(final[f"{name}_sigma"])), abs=1e-6
        )
    assert "delay" not in figures["biases"], "a robot that cannot be late"
    for name, stated_sigma_deg in (("tilt", 0.5), ("roll", 0.3)):  # the mount of this log is exact
        stated_deg = getattr(storage.read_camera(log / "camera.yaml").mount, f"{name}_rad") * np.rad2deg(1.0)
        off_deg, sigma_deg = figures[f"{name}_found_deg"] - stated_deg, figures[f"{name}_found_sigma_deg"]
        assert abs(off_deg) < 4 * sigma_deg
        assert sigma_deg < stated_sigma_deg
        assert name not in figures["biases"], "stated once"


def test_same_seed_same_bytes_another_seed_differs(localiser: Localiser, log: Path, tmp_path: Path) -> None:
    one, two, other = (
        localiser.replay(log, tmp_path / name, "--seed", seed) for name, seed in (("a", 5), ("b", 5), ("c", 6))
    )
    for name in ("trajectory.csv", "trajectory.tum", "groundtruth.tum", "config.yaml", "metrics.json"):
        assert (one / name).read_bytes() == (two / name).read_bytes()
    for name in ("trajectory.csv", "trajectory.tum"):
        assert (one / name).read_bytes() != (other / name).read_bytes()


@pytest.mark.slow  # quick: the same seed gives the same bytes, above
def test_saved_configuration_repeats_the_run(localiser: Localiser, log: Path, tmp_path: Path) -> None:
    settings = ("--seed", 3, "--observation", "slope", "--set", "mcl.particles=300", "--set", "motion.alpha1=2e-3")
    first = localiser.replay(log, tmp_path / "a", *settings)
    again = localiser.replay(log, tmp_path / "b", "--config", first / "config.yaml")
    assert (first / "trajectory.csv").read_bytes() == (again / "trajectory.csv").read_bytes()
    assert (first / "config.yaml").read_bytes() == (again / "config.yaml").read_bytes()
    figures = metrics_of(again)
    assert (figures["seed"], figures["observation"], figures["particles"]) == (3, "slope", 300)


# -- where it starts --------------------------------------------------------------------------------------------------


def first_position(run: Path) -> np.ndarray:
    row = rows_of(run)[0]
    return np.array([float(row["x"]), float(row["z"])])


def test_start_can_be_given(localiser: Localiser, log: Path, tmp_path: Path) -> None:
    truth = storage.read_poses(log / "groundtruth.csv").poses[0]
    given = f"{truth[0]:.3f},{truth[1]:.3f},{np.rad2deg(truth[2]):.3f}"
    run = localiser.replay(log, tmp_path / "out", "--start", given)
    assert np.linalg.norm(first_position(run) - truth[:2]) < 0.15

    # A single image contradicts a start so far off; only a filter that never looks around stays there.
    far = localiser.replay(log, tmp_path / "out", "--start", "-0.5,-5,-90", "--set", "search.doubt=0.9999")
    assert "heading_deg: -90" in (far / "run.yaml").read_text()

    wrong = localiser.replay(log, tmp_path / "out", "--start", "0.5,-2,40", few=False)
    assert any("the pose jumped there" in text for text in json.loads((wrong / "metrics.json").read_text())["warnings"])


def test_log_without_a_start_is_looked_for_on_the_whole_map(localiser: Localiser, log: Path, tmp_path: Path) -> None:
    asked = localiser.replay(log, tmp_path / "asked", "--start", "global", few=False)
    drop_from(log / "log.yaml", "start")
    result = localiser("replay", log, "--out", tmp_path / "back", "--no-rrd")
    assert "looked for on the whole map" in result.err
    (fallen_back,) = (tmp_path / "back").glob("*/1")
    assert (asked / "trajectory.csv").read_bytes() == (fallen_back / "trajectory.csv").read_bytes()
    figures = metrics_of(asked)
    assert figures["position_rmse_m"] < 0.1 and figures["confidence"]["sure_and_wrong"] == 0
    last = rows_of(asked)[-1]
    assert float(last["p_correct"]) > 0.9 and last["places"] == "1"


def drop_from(log_file: Path, key: str) -> None:
    lines = log_file.read_text().splitlines(keepends=True)
    log_file.write_text("".join(line for line in lines if not line.startswith(f"{key}:")))


def test_a_start_near_the_truth_needs_the_truth(localiser: Localiser, log: Path, tmp_path: Path) -> None:
    drop_from(log / "log.yaml", "start")
    drop_from(log / "log.yaml", "groundtruth")
    result = localiser("replay", log, "--out", tmp_path / "out", "--start", "truth")
    assert result.exit_code == 2 and "start" in result.err
    assert "--start x,z,heading_deg" in result.err

    run = localiser.replay(log, tmp_path / "out", "--start", "0.1,0.7,3.7")
    assert not (run / "groundtruth.tum").exists()
    figures = metrics_of(run)
    assert figures["position_rmse_m"] is None
    assert figures["frames"] == FRAMES


# -- what can be chosen -----------------------------------------------------------------------------------------------


def test_another_map_can_be_given(localiser: Localiser, log: Path, tmp_path: Path) -> None:
    own = localiser.replay(log, tmp_path / "a")
    drop_from(log / "log.yaml", "map")
    missing = localiser("replay", log, "--out", tmp_path / "b")
    assert missing.exit_code == 2 and "--map" in missing.err
    assert f"`localiser map build {log} -o map.yaml`" in missing.err
    given = localiser.replay(log, tmp_path / "b", "--map", CORRIDOR.parent.parent / "maps" / "corridor.yaml")
    assert (own / "trajectory.csv").read_bytes() == (given / "trajectory.csv").read_bytes()


KNOWN = ("--start", "1,2,178", "--set", "observation.association=known")


def test_edges_belong_to_landmarks_by_id_whatever_the_order_of_the_map(localiser: Localiser, tmp_path: Path) -> None:
    log, other = write_edge_log(tmp_path / "log"), tmp_path / "other.yaml"
    storage.write_map(MAP.take(np.array([2, 0, 1])), other)
    own = localiser.replay(log, tmp_path / "own", *KNOWN)
    on_another = localiser.replay(log, tmp_path / "other", *KNOWN, "--map", other)
    assert (own / "trajectory.tum").read_bytes() == (on_another / "trajectory.tum").read_bytes()
    converted = tmp_path / "without_map"
    storage.write_map(MAP, tmp_path / "map.yaml")
    (log / "log.yaml").write_text((log / "log.yaml").read_text().replace("map: map.yaml\n", ""))
    assert localiser("convert", log, converted, "--quiet").exit_code == 0
    assert (converted / "edges.csv").read_bytes() == (log / "edges.csv").read_bytes()
    without = localiser.replay(converted, tmp_path / "again", *KNOWN, "--map", tmp_path / "map.yaml")
    assert (own / "trajectory.tum").read_bytes() == (without / "trajectory.tum").read_bytes()


@pytest.mark.parametrize("found", ["99", "2"])
def test_an_edge_of_a_landmark_that_the_map_does_not_have_is_told(localiser, tmp_path, found):
    table = write_edge_log(tmp_path / "log") / "edges.csv"
    table.write_text(table.read_text().replace("door", found))
    result = localiser("replay", tmp_path / "log", "--out", tmp_path / "out", *KNOWN)
    expected = f"edges.csv:2: landmark_id: expected the id of a landmark of the map 'small', found '{found}'"
    assert result.exit_code == 2 and expected in result.err
    assert not (tmp_path / "out").exists()


def test_a_run_says_how_it_was_made_and_is_judged_so_again(localiser: Localiser, log: Path, tmp_path: Path) -> None:
    settings = ("--set", "mcl.particles=300", "--set", "mcl.start_particles=300", "--seed", 1)
    by_wheels = metrics_of(localiser.replay(log, tmp_path / "wheel", *settings))
    run = localiser.replay(log, tmp_path / "seen", "--odometry", "vision", *settings)
    figures = metrics_of(run)
    about = {"observation": "line", "association": "unknown", "odometry": "vision", "start": "stated", "seed": 1}
    assert about.items() <= figures.items()
    assert {key for key in ABOUT if figures[key] != by_wheels[key]} == {"odometry"}
    other = metrics_of(localiser.replay(log, tmp_path / "other", *settings, "--set", "motion.alpha1=0.5"))
    assert {key for key in ABOUT if other[key] != by_wheels[key]} == {"inputs"}
    assert "odometry: vision" in (run / "run.yaml").read_text()
    again = evaluate_run(run, run / "groundtruth.tum")
    assert {key: again[key] for key in ABOUT} == {key: figures[key] for key in ABOUT}
    assert again["odometry_position_rmse_m"] == pytest.approx(figures["odometry_position_rmse_m"], rel=1e-3)


def test_odometry_alone_is_that_which_the_run_goes_by(localiser: Localiser, log: Path, tmp_path: Path) -> None:
    """Cameras do not know the wheels: by vision alone the odometry in the results is what the edges tell."""
    few = ("--set", "mcl.particles=300", "--set", "mcl.start_particles=300")
    before = storage.read_track(
        localiser.replay(log, tmp_path / "as_is", "--odometry", "vision", *few) / "trajectory.csv"
    )
    rows = (log / "odometry.csv").read_text().splitlines()
    still = [f"{row.split(',')[0]},0,0,0" for row in rows[1:]]
    (log / "odometry.csv").write_text("\n".join([rows[0], *still]) + "\n")
    run = localiser.replay(log, tmp_path / "still", "--odometry", "vision", *few)
    np.testing.assert_array_equal(storage.read_track(run / "trajectory.csv").odometry, before.odometry)
    assert np.hypot(*(before.odometry[-1] - before.odometry[0])[:2]) > 0.3


def test_run_says_what_it_was_made_from(localiser: Localiser, log: Path, tmp_path: Path) -> None:
    map_file = tmp_path / "map.yaml"
    map_file.write_text((log / "map.yaml").read_text())
    run = localiser.replay(log, tmp_path / "out", "--map", map_file, "--start", "0.1,0.7,5")
    told = documents.load(run / "run.yaml").value
    assert told["log"]["path"] == str(log) and told["log"]["name"] == "corridor"
    assert told["map"]["path"] == str(map_file) and told["map"]["landmarks"] > 20
    assert [told["start"][key] for key in ("x", "z", "heading_deg", "sigma_x_m")] == pytest.approx([0.1, 0.7, 5, 0.1])
    own = documents.load(localiser.replay(log, tmp_path / "own") / "run.yaml").value
    assert own["map"]["path"] == str(log)
    assert own["map"]["fingerprint"] == told["map"]["fingerprint"]
    assert own["start"] != told["start"]


# -- how good it is ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("observation", "rmse_m"), [("line", 0.04), ("slope", 0.12)])
@pytest.mark.slow  # quick: the code of the README replays the same log
def test_corridor_is_located(localiser: Localiser, tmp_path: Path, observation: str, rmse_m: float) -> None:
    figures = metrics_of(localiser.replay(CORRIDOR, tmp_path, "--observation", observation, few=False))
    assert figures["position_rmse_m"] <= rmse_m
    assert figures["odometry_position_rmse_m"] > 4 * figures["position_rmse_m"]


@pytest.mark.data
def test_beginning_of_house_is_located(localiser: Localiser, data_dir: Path, tmp_path: Path) -> None:
    log = cut_log(data_dir / "house", tmp_path / "log", 60)
    figures = metrics_of(localiser.replay(log, tmp_path / "out", few=False))
    assert figures["frames"] == 60
    assert figures["confidence"]["found_s"] < 5.0 and figures["position_rmse_m"] < 0.1


# -- runs that break off ----------------------------------------------------------------------------------------------


def assert_valid_until(run: Path, frames: int, log: Path) -> None:
    """Check that every output holds exactly the first frames, and says that it is not complete."""
    assert [row["t_ns"] for row in rows_of(run)] == [line.split(",")[0] for line in image_rows(log)[:frames]]
    for name in ("trajectory.tum", "groundtruth.tum"):
        assert len(storage.read_poses(run / name).t_ns) == frames
    assert len(storage.read_track(run / "trajectory.csv")) == frames
    figures = metrics_of(run)
    assert figures["complete"] is False and figures["frames"] == frames
    assert logged_frames(run) == frames
    assert (run / "report.png").is_file()


def test_bad_frame_half_way_leaves_what_was_done(localiser: Localiser, log: Path, tmp_path: Path) -> None:
    bad = log / image_rows(log)[7].split(",")[1]
    bad.write_bytes(bad.read_bytes()[:-3000])  # its head, which is checked beforehand, is sound
    result = localiser("replay", log, "--out", tmp_path / "out", "--quiet")
    run = tmp_path / "out" / "corridor" / "1"
    assert result.exit_code == 2 and str(bad) in result.err
    assert f"after 7 of {FRAMES} frames" in result.err and str(run) in result.err
    assert "Traceback" not in result.err
    assert_valid_until(run, 7, log)


def test_a_run_that_comes_to_nothing_leaves_the_latest_as_it_was(localiser, log, tmp_path):
    first = localiser.replay(log, tmp_path / "out")
    bad = log / image_rows(log)[0].split(",")[1]
    bad.write_bytes(bad.read_bytes()[:-3000])
    result = localiser("replay", log, "--out", tmp_path / "out", "--quiet")
    assert result.exit_code == 2 and f"after 0 of {FRAMES} frames; nothing is left of it" in result.err
    assert (tmp_path / "out" / "corridor" / "latest").resolve() == first
    assert sorted(part.name for part in (tmp_path / "out" / "corridor").iterdir()) == ["1", "latest"]


LIMITED = """
import resource, sys
resource.setrlimit(resource.RLIMIT_FSIZE, (int(sys.argv.pop(1)), resource.RLIM_INFINITY))
from localiser.__main__ import main
main()
"""


def replayed_with_limit(log: Path, out: Path, most_bytes: int, *arguments: str) -> subprocess.CompletedProcess[str]:
    """Replay where files that grow beyond a size cannot be written, as on a full disk."""
    command = [sys.executable, "-c", LIMITED, str(most_bytes), "replay", log, "--out", out, "--quiet", *FEW_PARTICLES]
    return subprocess.run([*command, *arguments], capture_output=True, text=True, check=False, timeout=120)


@pytest.mark.skipif(os.name == "nt", reason="Windows has no limit of the size of files")
def test_a_recording_that_cannot_be_written_takes_nothing_else_away(log: Path, tmp_path: Path) -> None:
    done, run = replayed_with_limit(log, tmp_path / "out", 200_000), tmp_path / "out" / "corridor" / "1"
    assert done.returncode == 2
    assert done.stderr.startswith(f"Error: {run / 'run.rrd'}: cannot be written: File too large. All else")
    assert done.stderr.count("\n") == 1, "one paragraph"
    assert metrics_of(run)["complete"] is True and metrics_of(run)["frames"] == FRAMES
    assert (run / "timing.json").exists() and (run / "report.png").exists()


@pytest.mark.skipif(os.name == "nt", reason="Windows has no limit of the size of files")
def test_a_disk_that_is_full_half_way_ends_the_run_with_whole_lines(tmp_path: Path) -> None:
    log = cut_log(CORRIDOR, tmp_path / "longer", 24)
    done, run = replayed_with_limit(log, tmp_path / "out", 7000, "--no-rrd"), tmp_path / "out" / "corridor" / "1"
    assert done.returncode == 2 and "Traceback" not in done.stderr
    rows = (run / "trajectory.csv").read_text().splitlines()
    assert len({row.count(",") for row in rows}) == 1 and 12 < len(rows) < 25
    assert f"after {len(rows)} of" in done.stderr, "one more was located than written"


@pytest.mark.parametrize("kind", ["native", pytest.param("web", marks=pytest.mark.slow)])
def test_run_without_a_display_says_so_and_goes_on(localiser, log, tmp_path, monkeypatch, kind):
    monkeypatch.setattr(viewer, "viewer_command", lambda kind: ([sys.executable, "-c", "pass"], None))
    result = localiser("replay", log, "--out", tmp_path / "out", "--no-rrd", "--quiet", "--view", kind)
    assert (result.exit_code, result.out) == (0, "")
    assert "could not start" in result.err
    assert len(rows_of(tmp_path / "out" / "corridor" / "1")) == FRAMES


HEARING = """
import signal
signal.signal(signal.SIGINT, signal.default_int_handler)  # ignored by what a shell runs in the background
from localiser.__main__ import main
main()
"""


@pytest.mark.skipif(os.name == "nt", reason="Windows has no SIGINT for one process")
@pytest.mark.parametrize(
    "number", [signal.SIGINT, *(pytest.param(one, marks=pytest.mark.slow) for one in (signal.SIGHUP, signal.SIGTERM))]
)
def test_ctrl_c_leaves_what_was_done(tmp_path: Path, number: signal.Signals) -> None:
    # Slower than it could be, so that it is not done before the signal comes.
    command = [sys.executable, "-c", HEARING, "replay", CORRIDOR, "--out", tmp_path, "--speed", "1", *FEW_PARTICLES]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    run = tmp_path / "corridor" / "1"
    try:
        while process.poll() is None and lines_in(run / "trajectory.tum") < 5:
            time.sleep(0.005)
        process.send_signal(number)
        _, err = process.communicate(timeout=60)
    finally:
        process.kill()
    assert process.returncode == 128 + number
    frames = lines_in(run / "trajectory.tum")
    assert 5 <= frames < len(image_rows(CORRIDOR))
    told = " ".join(err.split())  # lines are as long as the terminal wants
    assert f"after {frames} of {len(image_rows(CORRIDOR))} frames" in told
    assert str(run) in told
    assert "Traceback" not in err
    assert_valid_until(run, frames, CORRIDOR)


INTERRUPTED = """
import signal
signal.signal(signal.SIGINT, signal.default_int_handler)
from localiser.__main__ import main
from localiser.replay import folder
draw = folder.write_report
def interrupted(*arguments, **further):
    print("interrupted")
    signal.raise_signal(signal.SIGINT)
    draw(*arguments, **further)
folder.write_report = interrupted
main()
"""


@pytest.mark.skipif(os.name == "nt", reason="Windows has no SIGINT for one process")
def test_ctrl_c_while_the_report_is_drawn_takes_nothing_away(log: Path, tmp_path: Path) -> None:
    """In a process of its own: signals go to the main thread, which is not always that of a test."""
    command = [sys.executable, "-c", INTERRUPTED, "replay", log, "--out", tmp_path / "out", "--no-rrd", "--quiet"]
    done = subprocess.run([*command, *FEW_PARTICLES], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (0, "interrupted\n"), done.stderr
    run = tmp_path / "out" / "corridor" / "1"
    assert (run / "report.png").stat().st_size > 10_000
    assert metrics_of(run)["complete"]


def lines_in(path: Path) -> int:
    return path.read_bytes().count(b"\n") if path.exists() else 0


def test_a_log_without_odometry_is_replayed_by_vision(localiser: Localiser, log: Path, tmp_path: Path) -> None:
    kept = [line for line in (log / "log.yaml").read_text().splitlines() if not line.startswith("odometry")]
    (log / "log.yaml").write_text("\n".join(kept) + "\n")
    run = localiser.replay(log, tmp_path / "out")
    figures = metrics_of(run)
    assert (figures["odometry"], figures["frames"]) == ("vision", FRAMES)
    assert figures["position_rmse_m"] < 0.1
    result = localiser("replay", log, "--odometry", "wheel", "--out", tmp_path / "out")
    assert result.exit_code == 2 and "`increments.source: wheel` needs odometry, which this log has not" in result.err
