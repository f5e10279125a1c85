"""Damaged bags, and bags made to do harm: a value or an InputError, soon, and in little memory."""

import os
import resource
import shutil
import signal
import sqlite3
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from tempfile import mkdtemp
from types import FrameType
from typing import Any

import numpy as np
import pytest
from fuzzing import examples
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from rosbags import rosbag1, rosbag2
from small_bag import Recorder, bag, recording
from swelling_bags import SWELLING, clean, one_large_image

from localiser.errors import InputError, InputWarning
from localiser.storage import ImageEvent, open_log
from localiser.storage.bags import bag as bags_module
from localiser.storage.bags import records
from localiser.storage.bags.records import RosType

FUZZ = settings(suppress_health_check=list(HealthCheck))
FILES = {"mcap": "bag.mcap", "sqlite3": "bag.db3", "ros1": "bag.bag", "metadata": "bag/metadata.yaml"}


def record(recorder: Recorder) -> None:
    recorder.images()
    recorder.odometry(0, 5.0, topic="/ground_truth/odom")
    recorder.odometry(10**8, 6.0, topic="/ground_truth/odom")
    recorder.send("/localiser/log", RosType.TEXT, 0, data="format: localiser-bag/1\nname: x\n")


@pytest.fixture(scope="module")
def bags(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with a small bag of each kind."""
    folder = tmp_path_factory.mktemp("bags")
    for kind in ("mcap", "sqlite3", "ros1"):
        bag(folder / ("bag.bag" if kind == "ros1" else kind), record, kind)
    shutil.move(folder / "sqlite3" / "sqlite3.db3", folder / "bag.db3")
    shutil.copy(folder / "mcap" / "mcap.mcap", folder / "bag.mcap")
    shutil.move(folder / "mcap", folder / "bag")
    return folder


@contextmanager
def not_hanging(seconds: int = 20) -> Iterator[None]:
    """Fail when the work does not end; far beyond what it takes on any machine."""

    def stop(_signal: int, _frame: FrameType | None) -> None:
        raise AssertionError("it hangs")

    before = signal.signal(signal.SIGALRM, stop)
    signal.alarm(seconds)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)


def outcome(path: Path, topics: dict[str, str] | None = None) -> str:
    """Read a bag with all its images; return "read", or "refused" with a message that a person can read."""
    try:
        with not_hanging():
            for frame in open_log(path, topics=topics).frames:
                frame.load()
    except InputError as error:
        assert "\n" not in str(error) and len(str(error)) < 1500
        return "refused"
    return "read"


@pytest.mark.parametrize("kind", FILES)
def test_whole_bags_are_read(bags: Path, kind: str) -> None:
    path = bags / FILES[kind]
    assert outcome(path.parent if kind == "metadata" else path) == "read"


@pytest.mark.parametrize("kind", FILES)
@settings(FUZZ, max_examples=examples(150))
@given(data=st.data())
def test_bytes_that_changed(bags: Path, tmp_path: Path, kind: str, data: st.DataObject) -> None:
    content = bytearray((bags / FILES[kind]).read_bytes())
    for _ in range(data.draw(st.integers(1, 4))):
        place = data.draw(st.integers(0, len(content) - 1))
        content[place] = data.draw(st.integers(0, 255) | st.sampled_from([0, 255, 127, 128]))
    if data.draw(st.integers(0, 7)) == 0:
        del content[data.draw(st.integers(0, len(content))) :]
    outcome(written(tmp_path, bags, kind, bytes(content)))


@pytest.mark.parametrize("kind", FILES)
@settings(FUZZ, max_examples=examples(40))
@given(st.binary(max_size=200))
def test_arbitrary_bytes(bags: Path, tmp_path: Path, kind: str, content: bytes) -> None:
    assert outcome(written(tmp_path, bags, kind, content)) == "refused"


def written(tmp_path: Path, bags: Path, kind: str, content: bytes) -> Path:
    """Write a bag of these bytes; returns its path."""
    if kind != "metadata":
        (tmp_path / FILES[kind]).write_bytes(content)
        return tmp_path / FILES[kind]
    shutil.rmtree(tmp_path / "bag", ignore_errors=True)
    shutil.copytree(bags / "bag", tmp_path / "bag")
    (tmp_path / FILES[kind]).write_bytes(content)
    return tmp_path / "bag"


def drive(path: Path, kind: str, squeeze: str = "") -> tuple[Path, bytes]:
    """Make a bag of 40 images in chunks of some kB; returns its file, and what is in it."""
    writer: Any = rosbag1.Writer(path) if kind == "ros1" else rosbag2.Writer(path, version=9, **PLUGIN)
    if squeeze and kind == "ros1":
        writer.set_compression(getattr(rosbag1.Writer.CompressionFormat, squeeze.upper()))
    elif squeeze:
        writer.set_compression(rosbag2.CompressionMode.STORAGE, rosbag2.CompressionFormat[squeeze.upper()])
    with writer:
        writer.chunk_threshold = 3000  # of ROS 1
        recorder = Recorder(writer, ros1=kind == "ros1")
        recorder.setting()
        for step in range(40):
            recorder.image(step * 10**8)
            recorder.odometry(11 * 10**8 + step * 10**8)
            if kind != "ros1" and step % 5 == 0:
                writer.storage.close_chunk()
    file = path if kind == "ros1" else next(path.glob("*.mcap"))
    return file, file.read_bytes()


PLUGIN: dict[str, Any] = {"storage_plugin": rosbag2.StoragePlugin.MCAP}


def assert_read_to_where_it_ends(path: Path) -> None:
    with pytest.warns(InputWarning, match="cannot be read to its end: .*the log ends there"):
        log = open_log(path)
    assert 5 < len(log.frames) < 40
    assert all((frame.load() == frame.t_ns % 251).all() for frame in log.images)


@pytest.mark.parametrize("squeeze", ["", "lz4", "bz2"])
def test_a_ros1_bag_is_read_up_to_where_its_recorder_ended(tmp_path: Path, squeeze: str) -> None:
    """Without an index, and under the name that the recorder gives it while it records."""
    _, data = drive(tmp_path / "x.bag", "ros1", squeeze)
    begin = data.index(b"index_pos=") + len(b"index_pos=")
    path = tmp_path / "x.bag.active"
    path.write_bytes(data[:begin] + bytes(8) + data[begin + 8 : len(data) * 2 // 3])
    assert_read_to_where_it_ends(path)


@pytest.mark.parametrize("squeeze", ["", "zstd"])
def test_a_truncated_mcap_is_read_up_to_where_it_ends(tmp_path: Path, squeeze: str) -> None:
    """Also in a folder without metadata, which come last."""
    file, data = drive(tmp_path / "bag", "mcap", squeeze)
    file.write_bytes(data[: len(data) // 3])
    (tmp_path / "bag" / "metadata.yaml").unlink()
    file.rename(file.with_name("bag_0.mcap"))
    assert_read_to_where_it_ends(tmp_path / "bag")
    (tmp_path / "begun.mcap").write_bytes(data[:8])
    with pytest.raises(InputError, match="found no topic at all"):
        open_log(tmp_path / "begun.mcap")


@pytest.mark.parametrize(
    ("content", "found"),
    [(b"", "an empty file"), (b"version https://", "a pointer of Git LFS"), (b"#ROSBAG V1.2", "an older version")],
)
def test_what_is_no_bag_is_named(tmp_path: Path, content: bytes, found: str) -> None:
    (tmp_path / "x.mcap").write_bytes(content)
    with pytest.raises(InputError, match=f"expected a bag of ROS 1, MCAP or SQLite, found .*{found}"):
        open_log(tmp_path / "x.mcap")


# -- messages ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("ros1", [False, True], ids=["ros2", "ros1"])
@pytest.mark.parametrize(
    "msgtype",
    [RosType.IMAGE, RosType.COMPRESSED, RosType.CAMERA_INFO, RosType.ODOMETRY, RosType.TRANSFORMS, RosType.TEXT],
)
@settings(FUZZ, max_examples=examples(25))
@given(data=st.data())
def test_messages_that_changed(tmp_path: Path, msgtype: str, ros1: bool, data: st.DataObject) -> None:
    """One message of a good bag is changed; its bag is whole."""
    path = Path(mkdtemp(dir=tmp_path)) / ("x.bag" if ros1 else "x")
    with recording(path, "ros1" if ros1 else "mcap") as recorder:
        recorder.writer = Tampered(recorder.writer, msgtype, data)
        recorder.setting()
        record(recorder)
        recorder.compressed(0, b"\xff\xd8\xff\xc0", topic="/other/compressed")
    outcome(path, {"image": "/other/compressed" if msgtype == RosType.COMPRESSED else "/cam/image"})


class Tampered:
    """A writer that changes the first message of a type on its way."""

    def __init__(self, writer: Any, msgtype: str, data: st.DataObject) -> None:
        self._writer, self._msgtype, self._data, self._done = writer, msgtype, data, False

    def add_connection(self, *arguments: Any, **options: Any) -> Any:
        return self._writer.add_connection(*arguments, **options)

    def write(self, connection: Any, t_ns: int, content: bytes) -> None:
        if connection.msgtype == self._msgtype and not self._done:
            self._done = True
            changed = bytearray(content)
            for _ in range(self._data.draw(st.integers(1, 3))):
                changed[self._data.draw(st.integers(0, len(changed) - 1))] = self._data.draw(st.integers(0, 255))
            content = bytes(changed[: self._data.draw(st.integers(0, len(changed)) | st.just(len(changed)))])
        self._writer.write(connection, t_ns, content)


@pytest.mark.parametrize(
    ("change", "problem"),
    [
        (lambda r: r.odometry(5, 0.0, w=0.5), "/odom at 5 ns: expected a quaternion of length 1, found length 0.5"),
        (lambda r: r.odometry(5, float("inf")), "expected a position within 1e.09 m, found x = inf"),
        (lambda r: r.info(5, focal=11.0), "/cam/camera_info at 5 ns: expected one camera, found intrinsics that"),
        (lambda r: r.image(5, width=4, step=4, data=np.zeros(24, np.uint8)), "expected images of 8×6 pixels, as the"),
        (lambda r: r.info(5, width=9), "found intrinsics that change: image_width from 8 to 9$"),
        (lambda r: r.info(5, d=np.ones(5)), "found intrinsics that change: distortion_coefficients from"),
        (lambda r: r.info(5, binning_x=2), "found intrinsics that change: binning from"),
        (
            lambda r: r.send("/localiser/log", RosType.TEXT, 5, data="name: 3"),
            "/localiser/log:.*format: expected a value",
        ),
        (lambda r: r.send("/localiser/map", RosType.TEXT, 5, data="a: [1"), "/localiser/map:.*not valid YAML"),
    ],
)
def test_what_is_wrong_is_named(tmp_path: Path, change: Callable[[Recorder], None], problem: str) -> None:
    def with_change(recorder: Recorder) -> None:
        record(recorder)
        change(recorder)

    with pytest.raises(InputError, match=problem):
        open_log(bag(tmp_path / "bag", with_change))


# -- memory -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("mode", "plugin"), [("MESSAGE", "SQLITE3"), ("STORAGE", "MCAP"), ("FILE", "SQLITE3")])
def test_compressed_bags_are_read(tmp_path: Path, mode: str, plugin: str) -> None:
    writer = rosbag2.Writer(tmp_path / "bag", version=9, storage_plugin=rosbag2.StoragePlugin[plugin])
    writer.set_compression(rosbag2.CompressionMode[mode], rosbag2.CompressionFormat.ZSTD)
    with writer:
        recorder = Recorder(writer, ros1=False)
        recorder.setting()
        record(recorder)
    assert outcome(tmp_path / "bag") == "read"


@pytest.mark.parametrize("kind", FILES)
def test_a_bag_of_too_many_topics_is_refused(bags, tmp_path, kind, monkeypatch):
    monkeypatch.setattr(records, "MOST_TOPICS", 3)
    path = bags / FILES[kind]
    with pytest.raises(InputError, match="expected at most 3 topics, found more"):
        open_log(path.parent if kind == "metadata" else path)


def test_metadata_that_is_no_metadata_is_not_read(bags: Path, tmp_path: Path) -> None:
    path = written(tmp_path, bags, "metadata", b"#" * (bags_module.MAX_METADATA_BYTES + 1))
    with pytest.raises(InputError, match=r"metadata.yaml: expected at most 4194304 bytes, found 4194305"):
        open_log(path)


# -- databases that hold more than their file --------------------------------------------------------------------------

GROWN = "data BLOB GENERATED ALWAYS AS (zeroblob(800000000)) VIRTUAL"
HARMFUL = {
    "a generated column": ("", GROWN),
    "a view": ("CREATE VIEW more AS SELECT zeroblob(800000000);", "data BLOB"),
    "a trigger": ("CREATE TRIGGER t AFTER DELETE ON topics BEGIN SELECT zeroblob(800000000); END;", "data BLOB"),
    "a thousand tables": ("".join(f"CREATE TABLE t{k}(a);" for k in range(1000)), "data BLOB"),
}


@pytest.mark.parametrize("harm", HARMFUL)
def test_a_database_that_makes_gigabytes_of_nothing_is_refused(tmp_path: Path, harm: str) -> None:
    harmful_database(tmp_path / "x.db3", harm)
    with not_hanging(), pytest.raises(InputError, match=r"ROS bag that can be read: expected (at most|columns)"):
        open_log(tmp_path / "x.db3")


@pytest.mark.parametrize("name", ["what?.db3", "a#b.db3", "x%41.db3", "ümlaut ß.db3"])
def test_a_name_is_no_address(bags: Path, tmp_path: Path, name: str) -> None:
    shutil.copy(bags / "bag.db3", tmp_path / name)
    assert outcome(tmp_path / name) == "read"


def harmful_database(path: Path, harm: str) -> None:
    more, data = HARMFUL[harm]
    with closing(sqlite3.connect(path)) as database:
        database.executescript(
            "BEGIN;CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT, type TEXT, serialization_format TEXT, "
            "offered_qos_profiles TEXT);"
            f"CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER, {data});{more}"
            f"INSERT INTO topics VALUES(1, '/image', '{RosType.IMAGE}', 'cdr', ''), "
            f"(2, '/odom', '{RosType.ODOMETRY}', 'cdr', '');"
            "COMMIT"
        )
        database.executemany("INSERT INTO messages(topic_id, timestamp) VALUES(?, ?)", [(1, 1), (2, 2)])
        database.commit()


# -- what is no file ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["x.mcap", "x.db3", "x.bag", "bag/metadata.yaml", "bag/x.mcap", "bag/x.db3"])
def test_a_pipe_in_place_of_a_bag_is_told(tmp_path: Path, name: str) -> None:
    path = tmp_path / name
    path.parent.mkdir(exist_ok=True)
    os.mkfifo(path)
    if name.startswith("bag/") and path.suffix != ".yaml":
        (path.parent / "metadata.yaml").write_text(
            f"rosbag2_bagfile_information: {{relative_file_paths: [{path.name}]}}\n"
        )
    with not_hanging(), pytest.raises(InputError, match="expected a file, found a device or pipe"):
        open_log(path if path.parent == tmp_path else path.parent)


TIMES, MORE_MB = 5.0, 300.0  # what a bag may take of the processor and of memory, beside one that is as it should be
READ = """
import sys
from pathlib import Path
from localiser.errors import InputError
from localiser.storage import open_log
try:
    for frame in open_log(Path(sys.argv[1])).frames:
        frame.load()
    print("read")
except InputError as error:
    print(error)
"""


def read_alone(path: Path) -> tuple[str, float, float]:
    """Read a bag in a process of its own; returns what it said, its processor time (s) and its most memory (MB).

    It is ended by the system at 60 s of processor time, and gets no more than 6 GB of memory.
    """

    def limited() -> None:
        resource.setrlimit(resource.RLIMIT_CPU, (60, 60))
        resource.setrlimit(resource.RLIMIT_AS, (6 * 2**30, 6 * 2**30))

    with subprocess.Popen(
        [sys.executable, "-c", READ, path],
        stdout=subprocess.PIPE,
        text=True,
        preexec_fn=limited,  # noqa: PLW1509 - there are no threads
    ) as process:
        said = process.stdout.read().strip()
        _, status, used = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
    assert process.returncode == 0, f"ended by {signal.Signals(-process.returncode).name}"
    return said, used.ru_utime + used.ru_stime, used.ru_maxrss / 1024


@pytest.fixture(scope="module")
def usual(tmp_path_factory: pytest.TempPathFactory) -> tuple[float, float]:
    """Return processor time (s) and memory (MB) for a small bag that is as it should be."""
    said, seconds, memory_mb = read_alone(clean(tmp_path_factory.mktemp("clean") / "bag"))
    assert said == "read"
    return seconds, memory_mb


@pytest.mark.skipif(sys.platform != "linux", reason="limits of Linux")
@pytest.mark.parametrize("harm", SWELLING)
def test_a_small_bag_takes_little(tmp_path: Path, usual: tuple[float, float], harm: str) -> None:
    said, seconds, memory_mb = read_alone(SWELLING[harm](tmp_path / "bag"))
    assert "expected" in said or "cannot be read as a value" in said, said
    assert seconds < TIMES * usual[0] and memory_mb < usual[1] + MORE_MB


def test_one_large_image_is_read_however_small_it_is_compressed(tmp_path: Path) -> None:
    (frame,) = open_log(one_large_image(tmp_path / "bag")).frames
    assert isinstance(frame, ImageEvent) and frame.load().shape == (3000, 4000)
