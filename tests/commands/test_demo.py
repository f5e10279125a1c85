"""`localiser demo` and `view`, and completion by the shell: all in a folder that holds nothing."""

import filecmp
import os
import re
import subprocess
import sys
from contextlib import closing
from pathlib import Path
from unittest.mock import patch
from urllib.request import urlopen

import pytest
from folders import ROOT
from short_log import CORRIDOR, FRAMES, Localiser, cut_log

from localiser.commands import demo
from localiser.errors import OutputError

NO_DISPLAY = {"DISPLAY": "", "WAYLAND_DISPLAY": ""}


@pytest.fixture
def empty(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return an empty folder, which is the current one."""
    folder = tmp_path / "empty"
    folder.mkdir()
    monkeypatch.chdir(folder)
    return folder


@pytest.fixture
def installed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return the example's folder of a package that is installed, with the first images of the log."""
    package = tmp_path / "site-packages" / "localiser"
    shipped = package / "example"
    for folder in ("configs", "logs", "maps"):
        (shipped / folder).mkdir(parents=True)
    cut_log(CORRIDOR, shipped / demo.LOG, FRAMES)
    (shipped / demo.PARTS[2]).write_bytes((ROOT / demo.PARTS[2]).read_bytes())
    monkeypatch.setattr(demo, "PACKAGE", package)
    return shipped


def files(folder: Path) -> list[str]:
    return sorted(str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file())


def test_what_is_kept_is_what_a_clone_has(empty: Path) -> None:
    demo.copy_to(empty / "here")
    written = files(empty / "here")
    assert set(written) >= {"logs/corridor/log.yaml", "configs/worlds/office.yaml"}
    assert filecmp.cmpfiles(ROOT, empty / "here", written, shallow=False) == (written, [], [])


def test_an_example_that_cannot_be_copied_whole_is_told_and_leaves_nothing(empty: Path, installed: Path) -> None:
    (installed / demo.LOG / "images.link").symlink_to("nowhere")
    with pytest.raises(OutputError, match="No such file or directory") as told:
        demo.copy_to(empty / "here")
    assert "[(" not in str(told.value) and "corridor" in str(told.value)
    assert files(empty / "here") == []


def test_the_demo_keeps_the_files_of_an_installed_package(localiser: Localiser, empty: Path, installed: Path) -> None:
    (installed / "logs" / "corridor" / "log.yaml").chmod(0o444)
    with patch("localiser.replay.folder.write_report"):
        result = localiser("demo", "--keep", "kept")
    assert result.exit_code == 0 and "files to try are in `kept`." in result.out
    assert files(empty / "kept") == files(installed)
    assert os.access(empty / "kept" / "logs" / "corridor" / "log.yaml", os.W_OK)
    assert (empty / "results" / "corridor" / "1" / "metrics.json").is_file()


def test_what_is_kept_overwrites_nothing(localiser: Localiser, empty: Path, installed: Path) -> None:
    mine = empty / "maps" / "corridor.yaml"
    mine.parent.mkdir()
    mine.write_text("mine")
    result = localiser("demo", "--keep", ".")
    assert (result.exit_code, result.out) == (2, "")
    assert result.err == "Error: maps/corridor.yaml: expected nothing there, found a file or a folder\n"
    assert files(empty) == ["maps/corridor.yaml"] and mine.read_text() == "mine"


def test_a_package_without_the_example_says_so(localiser, empty, monkeypatch):
    monkeypatch.setattr(demo, "PACKAGE", empty / "localiser")
    result = localiser("demo")
    assert result.exit_code == 2 and "not part of this installation" in result.err


def test_the_demo_replays_the_example_and_says_what_next(localiser: Localiser, empty: Path, installed: Path) -> None:
    with patch("localiser.replay.folder.write_report"):
        result = localiser("demo")
    assert result.exit_code == 0 and "--keep FOLDER" in result.out
    run = empty / "results" / "corridor" / "1"
    assert {"run.rrd", "metrics.json"} <= {file.name for file in run.iterdir()}
    assert "`localiser view results/corridor/latest`" in result.out
    assert "seed 0" in result.out


def test_a_run_without_a_recording_cannot_be_viewed(localiser: Localiser, empty: Path) -> None:
    run = localiser.replay(cut_log(CORRIDOR, empty / "log", 3), empty / "results", rrd=False)
    for given in (run, run.parent):
        result = localiser("view", given)
        assert (result.exit_code, result.out) == (2, "")
        assert "expected a recording, run.rrd" in result.err and "--no-rrd" in result.err
    (run / "run.rrd").write_bytes(b"RRF")
    assert "run.rrd: expected a recording, which begins with b'RRF2', found b'RRF'" in localiser("view", run).err
    nowhere = localiser("view", empty / "nowhere")
    assert nowhere.exit_code == 2 and "expected the folder of a run" in nowhere.err


@pytest.mark.skipif(sys.platform != "linux", reason="a display as Linux has it")
def test_a_viewer_without_a_display_says_what_to_do(empty: Path) -> None:
    (empty / "empty.rrd").write_bytes(b"RRF2")
    command = [sys.executable, "-m", "localiser", "view", "empty.rrd"]
    environment = {**os.environ, **NO_DISPLAY, "PYTHONPATH": str(ROOT)}
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert done.stderr.endswith(
        "Error: the viewer could not start (is there a display?); --web shows the run in a browser\n"
    )


@pytest.mark.skipif(sys.platform != "linux", reason="a signal as Linux has it")
def test_a_recording_is_served_until_the_end(localiser: Localiser, empty: Path) -> None:
    run = localiser.replay(cut_log(CORRIDOR, empty / "log", 3), empty / "results", rrd=True)
    command = [sys.executable, "-m", "localiser", "view", str(run), "--web"]
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "PYTHONUNBUFFERED": "1"}
    with subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, text=True) as viewer:
        (address,) = re.findall(r"Watch at (\S+),", viewer.stdout.readline())
        page = _page(address, viewer)
        viewer.terminate()
        assert viewer.wait() == 143
    assert b"<html" in page


def _page(address: str, viewer: subprocess.Popen[str]) -> bytes:
    """Return a page that is served soon."""
    while True:
        assert viewer.poll() is None
        try:
            with closing(urlopen(address)) as response:
                return bytes(response.read())
        except OSError:
            continue


@pytest.mark.parametrize(("typed", "expected"), [("localiser de", "demo"), ("localiser replay --obs", "--observation")])
def test_the_shell_completes_commands_and_options(typed: str, expected: str) -> None:
    asked = {"_LOCALISER_COMPLETE": "complete_bash", "COMP_WORDS": typed, "COMP_CWORD": str(typed.count(" "))}
    command = [sys.executable, "-m", "localiser"]
    environment = {**os.environ, **asked, "PYTHONPATH": str(ROOT)}
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    assert done.stdout.split() == [expected]
