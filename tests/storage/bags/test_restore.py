"""Bags that are being written, or were: nothing that is read is changed, and nothing that was committed is lost."""

import shutil
import sqlite3
import subprocess
import sys
import tempfile
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from hot_journal import lay_journal
from small_bag import MAKE, Recorder, bag, text, texts
from small_log import CAMERA, MAP, image

from localiser.errors import InputError, OutputError
from localiser.storage import open_log
from localiser.storage.bags import live_label_text
from localiser.storage.bags.database import BagRecorder
from localiser.storage.bags.write import image_decision, odometry_decision
from localiser.storage.images import encode_image

PATIENCE_S = 60.0
TEXT = "std_msgs/msg/String"
KILLED = """
import os, sqlite3, sys
database = sqlite3.connect(sys.argv[1], isolation_level=None)
database.execute("PRAGMA journal_mode=" + sys.argv[2])
database.execute("PRAGMA cache_size=5")
add = "INSERT INTO messages(topic_id, timestamp, data) SELECT 1, ?, data FROM messages LIMIT 1"
database.execute(add, (10,))
database.execute("BEGIN")
for k in range(20000):
    database.execute(add, (20 + k,))
os._exit(9)
"""


def states(folder: Path) -> dict[str, tuple[bytes, int]]:
    """Return what each file of a folder holds, and when that was written."""
    files = [file for file in sorted(folder.rglob("*")) if file.is_file()]
    return {str(file.relative_to(folder)): (file.read_bytes(), file.stat().st_mtime_ns) for file in files}


@pytest.fixture
def private(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return the folder for temporary files."""
    (tmp_path / "private").mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "private"))
    return tmp_path / "private"


@pytest.fixture
def hostile(tmp_path: Path) -> Path:
    """Return a folder with a bag whose journal names a file beside it."""
    bag(tmp_path / "hostile" / "bag", Recorder.images, "sqlite3")
    (tmp_path / "hostile" / "victim").write_text("mine")
    lay_journal(tmp_path / "hostile" / "bag" / "bag.db3", tmp_path / "hostile" / "victim")
    return tmp_path / "hostile"


@pytest.mark.parametrize("name", ["bag", "bag/bag.db3", "link.db3"])
def test_a_journal_that_names_another_file_is_refused(hostile: Path, private: Path, name: str) -> None:
    (hostile / "link.db3").symlink_to("bag/bag.db3")
    before = states(hostile)
    with pytest.raises(InputError, match=r"bag.db3-journal: expected the journal of a bag, found one that has SQLite"):
        open_log(hostile / name)
    assert states(hostile) == before and not list(private.iterdir())


@pytest.mark.parametrize(("mode", "ending"), [("DELETE", "-journal"), ("WAL", "-wal")])
def test_a_killed_recording_is_restored_in_a_copy(tmp_path: Path, private: Path, mode: str, ending: str) -> None:
    """With what was committed at last, and without what was half written."""
    folder = tmp_path / "drive"
    folder.mkdir()
    recorder = BagRecorder(folder / "a.db3")
    for k in range(5):
        recorder.write("/a", TEXT, k, text("kept"))
    recorder.close()
    subprocess.run([sys.executable, "-c", KILLED, folder / "a.db3", mode], check=False, timeout=PATIENCE_S)
    assert (folder / f"a.db3{ending}").stat().st_size > 0, "the case that is meant"
    before = states(folder)
    for _ in range(2):
        assert texts(folder / "a.db3") == ["kept"] * 6
    assert states(folder) == before and not list(private.iterdir())


def test_a_journal_that_is_done_with_needs_no_copy(tmp_path, private, monkeypatch):
    """Recorders may leave an empty one, or one whose head is zero."""
    path = bag(tmp_path / "bag", Recorder.images, "sqlite3") / "bag.db3"
    path.with_name("bag.db3-journal").write_bytes(bytes(600))
    path.with_name("bag.db3-wal").touch()
    monkeypatch.setattr(shutil, "copyfile", None)
    assert len(open_log(path).frames) == 4


def test_a_journal_may_vanish_while_a_bag_is_opened(tmp_path, monkeypatch):
    gone = bag(tmp_path / "bag", Recorder.images, "sqlite3") / "bag.db3-journal"
    monkeypatch.setattr(Path, "is_file", lambda path: path == gone or path.exists())
    assert len(open_log(gone.with_name("bag.db3")).frames) == 4


def test_where_there_is_no_space_what_to_do_is_told(tmp_path, private, monkeypatch):
    path = bag(tmp_path / "bag", Recorder.images, "sqlite3") / "bag.db3"
    path.with_name("bag.db3-wal").write_bytes(b"x")
    monkeypatch.setattr(shutil, "disk_usage", lambda _: SimpleNamespace(free=100))
    with pytest.raises(InputError, match=r"expected \d+ bytes of space to restore .* found 100 in .*; set TMPDIR to"):
        open_log(path)
    assert not list(private.iterdir())


def test_a_bag_that_is_being_written_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = bag(tmp_path / "bag", Recorder.images, "sqlite3") / "bag.db3"
    with closing(sqlite3.connect(path)) as recorder:
        recorder.execute("PRAGMA journal_mode=WAL")
        recorder.execute("CREATE TABLE more(a)")
        recorder.commit()
        copy = shutil.copyfile

        def meanwhile(source: Path, target: Path) -> None:
            copy(source, target)
            recorder.execute("INSERT INTO more VALUES (1)")
            recorder.commit()

        monkeypatch.setattr(shutil, "copyfile", meanwhile)
        with pytest.raises(InputError, match="is being written; read it when its recorder has ended"):
            open_log(path)


@pytest.mark.parametrize("ending", ["", "-journal", "-wal"])
def test_a_recording_takes_no_place_where_or_beside_which_something_lies(tmp_path: Path, ending: str) -> None:
    (tmp_path / f"a.db3{ending}").write_text("mine")
    with pytest.raises(OutputError, match=f"a.db3{ending}: expected a path where nothing is, found something there"):
        BagRecorder(tmp_path / "a.db3")
    assert (tmp_path / f"a.db3{ending}").read_text() == "mine"


def test_a_bag_reads_no_file_outside_its_folder(tmp_path: Path) -> None:
    file = bag(tmp_path / "bag", Recorder.images, "sqlite3") / "bag.db3"
    file.rename(tmp_path / "other.db3")
    file.symlink_to("../other.db3")
    with pytest.raises(InputError, match=r"relative_file_paths\[0\]: expected a path inside the log's folder, found a"):
        open_log(tmp_path / "bag")


def test_messages_come_back_in_the_order_of_calls(tmp_path: Path) -> None:
    """Also when the calendar is set back in between."""
    recorder = BagRecorder(tmp_path / "a.db3")
    for k, t_ns in enumerate((100, 100, 50, 101, 3)):
        recorder.write("/a" if k % 2 else "/b", TEXT, t_ns, text(str(k)))
    recorder.close()
    assert texts(tmp_path / "a.db3") == list("01234")


def test_a_recording_of_another_kind_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"ends in \.db3"):
        BagRecorder(tmp_path / "a.mcap")


def recorder_of(path: Path) -> tuple[BagRecorder, Callable[[str, Any], None]]:
    """Return a recorder, and what has it write a message on a topic."""
    recorder = BagRecorder(path)
    return recorder, lambda topic, message: recorder.write(topic, message.__msgtype__, 1, MAKE.encode(message))


def test_decisions_leave_out_what_a_live_run_left_out(tmp_path: Path) -> None:
    recorder, send = recorder_of(tmp_path / "a.db3")
    send("/tf_static", MAKE.mount(0, CAMERA))
    send("/camera/camera_info", MAKE.camera_info(0, CAMERA))
    file = encode_image(image(0), ".jpg", 90)
    for k in range(6):
        pose = MAP.points[0][0] * k * 0.001, -0.1 * k, 0.0
        send("/odom", MAKE.odometry(k * 100, "odom", pose))
        send("/odom", MAKE.odometry(k * 100, "odom", (9.0, 9.0, 0.0)))
        send("/localiser/decisions", MAKE.text(odometry_decision(2 * k + 1, k * 100, "came twice")))
        send("/camera/image_raw/compressed", MAKE.compressed(k * 100, file))
        send("/localiser/decisions", MAKE.text(image_decision(k, k * 100, "" if k % 2 else "newer", by_wheels=k != 3)))
    recorder.close()
    log = open_log(tmp_path / "a.db3")
    assert [frame.t_ns for frame in log.frames] == [100, 300, 500]
    assert [frame.by_wheels for frame in log.frames] == [True, False, True]
    assert log.odometry.t_ns.tolist() == [k * 100 for k in range(6)] and abs(log.odometry.poses[:, 1]).max() < 1


def test_a_recording_says_which_topic_is_what(tmp_path: Path) -> None:
    """Also where names tell nothing, and where there are images that went out."""
    recorder, send = recorder_of(tmp_path / "a.db3")
    stated = {"image": "/front/compressed", "odometry": "/wheels", "groundtruth": "/mocap", "transforms": "/fixed"}
    send("/localiser/log", MAKE.text(live_label_text("a", {}, stated | {"camera_info": "/front/camera_info"})))
    send("/fixed", MAKE.mount(0, CAMERA))
    send("/front/camera_info", MAKE.camera_info(0, CAMERA))
    file = encode_image(image(0), ".jpg", 90)
    for k in range(3):
        send("/mocap", MAKE.odometry(k * 100, "map", (1.0, -0.1 * k, 0.0)))
        send("/wheels", MAKE.odometry(k * 100, "odom", (0.0, -0.1 * k, 0.0)))
        for topic in ("/front/compressed", "/shown/compressed", "/localiser/image/compressed"):
            send(topic, MAKE.compressed(k * 100, file))
        send("/localiser/decisions", MAKE.text(image_decision(k, k * 100)))
    recorder.close()
    log = open_log(tmp_path / "a.db3")
    assert len(log.frames) == 3 and log.odometry.poses[0, 0] == 0.0 and log.groundtruth.poses[0, 0] == 1.0
    assert open_log(tmp_path / "a.db3", topics={"odometry": "/mocap"}).odometry.poses[0, 0] == 1.0
