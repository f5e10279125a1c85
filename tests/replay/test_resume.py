"""A run in two halves is the run in one."""

from __future__ import annotations

import json
import signal
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from short_log import CORRIDOR, FRAMES, Localiser, cut_log
from small_log import write_edge_log

from localiser import documents
from localiser.filter.mcl import FilterState
from localiser.replay import run as replay_module
from localiser.storage.checkpoint import save_checkpoint

SAME = ("trajectory.csv", "trajectory.tum", "groundtruth.tum", "config.yaml", "run.yaml")
TIMES = {"frame_ms_median", "frame_ms_p95", "stage_ms"}
SETTINGS = ("--set", "mcl.particles=300", "--set", "mcl.start_particles=2000")


@pytest.fixture
def log(tmp_path: Path) -> Path:
    return cut_log(CORRIDOR, tmp_path / "log", FRAMES)


def figures(run: Path) -> dict[str, Any]:
    found = json.loads((run / "metrics.json").read_text())
    return {name: value for name, value in found.items() if name not in TIMES}


def assert_same(one: Path, two: Path) -> None:
    for name in SAME:
        assert (one / name).read_bytes() == (two / name).read_bytes(), name
    assert figures(one) == figures(two)
    frames = [len((run / "trajectory.tum").read_text().splitlines()) for run in (one, two)]
    assert frames == [FRAMES, FRAMES]


def stop_after(monkeypatch: pytest.MonkeyPatch, frames: int) -> None:
    """Let Ctrl-C be pressed while this frame is handed over."""
    hand_over, done = replay_module.Replay._hand_over, []

    def handed_over(self: Any, *arguments: Any) -> None:
        hand_over(self, *arguments)
        done.append(None)
        if len(done) == frames:
            signal.raise_signal(signal.SIGINT)

    monkeypatch.setattr(replay_module.Replay, "_hand_over", handed_over)


def test_run_that_was_stopped_goes_on_as_if_it_had_not_been(
    localiser: Localiser, log: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = localiser.replay(log, tmp_path / "whole", *SETTINGS)
    checkpoint = tmp_path / "run.checkpoint"
    with monkeypatch.context() as patch:
        stop_after(patch, 5)
        stopped = localiser("replay", log, "--out", tmp_path / "half", "-q", "--checkpoint", checkpoint, *SETTINGS)
    assert stopped.exit_code == 130
    assert f"after 5 of {FRAMES} frames" in stopped.err
    assert f"go on with --resume {checkpoint}" in stopped.err
    with monkeypatch.context() as patch:  # stopped once more, into the same file
        stop_after(patch, 3)
        again = (*SETTINGS, "--resume", checkpoint, "--checkpoint", checkpoint)
        stopped = localiser("replay", log, "--out", tmp_path / "half", "-q", *again)
    assert f"after 8 of {FRAMES} frames" in stopped.err
    assert_same(whole, localiser.replay(log, tmp_path / "rest", "--resume", checkpoint, *SETTINGS))


def test_images_that_wait_for_odometry_are_not_lost(
    localiser: Localiser, log: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Odometry at a fifth of the images' rate: a run that stops has images in hand that it has not located yet."""
    rows = (log / "odometry.csv").read_text().splitlines()
    (log / "odometry.csv").write_text("\n".join([rows[0], *rows[1::20], rows[-1]]) + "\n")
    whole = localiser.replay(log, tmp_path / "whole", *SETTINGS)
    checkpoint = tmp_path / "run.checkpoint"
    with monkeypatch.context() as patch:
        stop_after(patch, 3)
        localiser("replay", log, "--out", tmp_path / "half", "-q", "--checkpoint", checkpoint, *SETTINGS)
    assert_same(whole, localiser.replay(log, tmp_path / "rest", "--resume", checkpoint, *SETTINGS, rrd=True))


def test_run_that_is_killed_goes_on_from_its_last_checkpoint(
    localiser: Localiser, log: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = localiser.replay(log, tmp_path / "whole", *SETTINGS)
    checkpoint = tmp_path / "run.checkpoint"
    written: list[bytes] = []
    save = replay_module.Replay._save_checkpoint

    def saved(self: Any) -> None:
        save(self)
        written.append(checkpoint.read_bytes())

    with monkeypatch.context() as patch:
        patch.setattr(replay_module.Replay, "_save_checkpoint", saved)
        often = ("--checkpoint", checkpoint, "--checkpoint-every", 5)
        localiser.replay(log, tmp_path / "half", *often, *SETTINGS)
    assert len(written) == FRAMES // 5 + 1  # and at the end
    for content in written:
        checkpoint.write_bytes(content)
        assert_same(whole, localiser.replay(log, tmp_path / "rest", "--resume", checkpoint, *SETTINGS))


def test_run_that_met_a_bad_frame_goes_on_once_it_is_mended(localiser: Localiser, log: Path, tmp_path: Path) -> None:
    whole = localiser.replay(log, tmp_path / "whole", *SETTINGS)
    bad, checkpoint = sorted((log / "images").iterdir())[7], tmp_path / "run.checkpoint"
    sound = bad.read_bytes()
    bad.write_bytes(sound[:-3000])
    ended = localiser("replay", log, "--out", tmp_path / "half", "-q", "--checkpoint", checkpoint, *SETTINGS)
    assert ended.exit_code == 2
    bad.write_bytes(sound)
    assert_same(whole, localiser.replay(log, tmp_path / "rest", "--resume", checkpoint, *SETTINGS))


# -- what is refused --------------------------------------------------------------------------------------------------


def refused(localiser: Localiser, log: Path, out: Path, checkpoint: Path, *options: object) -> str:
    result = localiser("replay", log, "--out", out, "-q", "--resume", checkpoint, *options)
    assert result.exit_code == 2 and not (out / "corridor").exists()
    assert "Traceback" not in result.err
    return " ".join(result.err.split())


def test_checkpoint_of_another_run_is_refused(localiser: Localiser, log: Path, tmp_path: Path) -> None:
    checkpoint, out = tmp_path / "run.checkpoint", tmp_path / "out"
    localiser.replay(log, tmp_path / "first", "--checkpoint", checkpoint, *SETTINGS)
    assert "mcl.particles: expected 300" in refused(localiser, log, out, checkpoint)
    assert "seed: expected 0, as" in refused(localiser, log, out, checkpoint, "--seed", 1, *SETTINGS)
    assert "start: expected" in refused(localiser, log, out, checkpoint, "--start", "0,0,0", *SETTINGS)
    other = cut_log(CORRIDOR, tmp_path / "other", FRAMES - 1)
    assert "log: expected" in refused(localiser, other, out, checkpoint, *SETTINGS)
    map_file = tmp_path / "map.yaml"
    map_file.write_text((log / "map.yaml").read_text().replace("x: -0.9", "x: -0.8", 1))
    assert "map: expected" in refused(localiser, log, out, checkpoint, "--map", map_file, *SETTINGS)
    checkpoint.write_bytes(checkpoint.read_bytes()[:-1])
    assert "damaged or cut off" in refused(localiser, log, out, checkpoint, *SETTINGS)
    save_checkpoint(checkpoint, FilterState(), np.random.default_rng(0), {})
    assert "expected nothing, as the checkpoint was made with" in refused(localiser, log, out, checkpoint, *SETTINGS)


def test_file_that_is_there_is_not_overwritten(localiser: Localiser, tmp_path: Path) -> None:
    log = write_edge_log(tmp_path / "log")
    (tmp_path / "precious").write_text("data")
    result = localiser("replay", log, "--out", tmp_path / "out", "-q", "--checkpoint", tmp_path / "precious")
    assert result.exit_code == 2 and "expected a new file" in result.err
    assert (tmp_path / "precious").read_text() == "data"


# -- what a result came from ------------------------------------------------------------------------------------------


def test_run_says_what_it_was_made_from(localiser: Localiser, log: Path, tmp_path: Path) -> None:
    map_file = tmp_path / "map.yaml"
    map_file.write_text((log / "map.yaml").read_text())
    run = localiser.replay(log, tmp_path / "out", "--map", map_file, "--start", "0.1,0.7,5", *SETTINGS)
    told = documents.load(run / "run.yaml").value
    assert told["log"]["path"] == str(log) and told["log"]["name"] == "corridor"
    assert told["map"]["path"] == str(map_file) and told["map"]["landmarks"] > 20
    assert [told["start"][key] for key in ("x", "z", "heading_deg", "sigma_x_m")] == pytest.approx([0.1, 0.7, 5, 0.1])
    own = documents.load(localiser.replay(log, tmp_path / "own", *SETTINGS) / "run.yaml").value
    assert own["map"]["path"] == str(log)
    assert own["map"]["fingerprint"] == told["map"]["fingerprint"]
    assert own["start"] != told["start"]
