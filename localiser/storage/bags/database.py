"""Read and record a bag of SQLite, in the order of recording; one whose recorder was killed is restored in a copy.

What a stranger made is never opened for writing.
"""

from __future__ import annotations

import os
import shutil
import sqlite3
import tempfile
from collections import Counter
from collections.abc import Collection, Iterator
from contextlib import closing, contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

from localiser.documents import open_regular, output_errors
from localiser.errors import InputError, OutputError
from localiser.storage.bags.messages import typestore
from localiser.storage.bags.records import (
    MAX_CHUNK_BYTES,
    MOST_TOPICS,
    RECORD_BYTES,
    Allowance,
    BrokenOffError,
    Channel,
    Packed,
    Place,
    channel_of,
    check_topics,
)

if TYPE_CHECKING:
    from rosbags.interfaces import Qos

MAGIC = b"SQLite format 3\0"
BESIDE = ("-journal", "-wal")  # SQLite makes its third file, -shm, anew
_SUPER_JOURNAL = bytes.fromhex("d9d505f920a163d7")  # how a journal ends that names another file
_TABLES = ("schema", "metadata", "topics", "message_definitions", "messages")
_MOST_TABLES = 100
_STEPS_AT_ONCE = 1000  # of SQLite's machine


class Database:
    """The messages of a database; has the methods of `records.Records`."""

    def __init__(self, path: Path, allowance: Allowance) -> None:
        """Open a database that is whole. Raises ValueError unless its tables are as ROS 2 makes them, and hold no more.

        A column that is generated, a view or a virtual table can make gigabytes of nothing. Pages of a damaged database
        can be parts of each other, so that a few hold rows without an end: steps are spent as if each made a byte.
        """
        self.allowance = allowance
        self._database = sqlite3.connect(f"{path.absolute().as_uri()}?immutable=1", uri=True)
        self._database.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, MAX_CHUNK_BYTES)
        self._database.set_progress_handler(self._is_over, _STEPS_AT_ONCE)
        self._channels: dict[Any, Channel] = {}
        try:
            self._check()
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        """Close the database."""
        self._database.close()

    def topics(self) -> Counter[tuple[str, str]]:
        """Return names and types of the topics with their numbers of messages. Raises ValueError."""
        found = Counter({channel[:2]: 0 for channel in self._channels.values()})
        with suppress(BrokenOffError):  # is reported where the messages are read
            for (number,) in self._rows("SELECT topic_id FROM messages ORDER BY rowid"):
                self.allowance.spend(RECORD_BYTES)
                found.update([self._channels[number][:2]] if number in self._channels else [])
        return found

    def messages(self, first: Place = (0, 0)) -> Iterator[Packed]:
        """Yield the messages from a row on. Raises as `records.Records.messages`."""
        query = "SELECT rowid, topic_id, timestamp, data FROM messages WHERE rowid >= ? ORDER BY rowid"
        for row, number, t_ns, data in self._rows(query, first[0]):
            if number not in self._channels or not isinstance(t_ns, int) or not isinstance(data, bytes):
                raise BrokenOffError("a row is damaged")
            self.allowance.spend(RECORD_BYTES + len(data))
            yield Packed((row, 0), self._channels[number], t_ns, data)

    def _check(self) -> None:
        found = [*self._rows("SELECT type, name, rootpage FROM sqlite_master LIMIT ?", _MOST_TABLES + 1)]
        kinds = {kind for kind, _, _ in found}
        if len(found) > _MOST_TABLES or kinds - {"table", "index"} or any(page == 0 for _, _, page in found):
            raise ValueError(f"expected at most {_MOST_TABLES} plain tables, found others")
        for name in _TABLES:
            if any(hidden for (hidden,) in self._rows("SELECT hidden FROM pragma_table_xinfo(?)", name)):
                raise ValueError(f"expected columns that hold what was recorded, found generated ones in {name}")
        for row in self._rows("SELECT id, name, type, serialization_format FROM topics LIMIT ?", MOST_TOPICS + 1):
            self._channels[row[0]] = channel_of(*row[1:])
        check_topics(len(self._channels))

    def _rows(self, query: str, *values: Any) -> Iterator[tuple[Any, ...]]:
        """Yield the rows of a query. Raises BrokenOffError, ValueError where it takes more steps than are allowed."""
        try:
            for row in self._database.execute(query, values):  # noqa: UP028 - closed later than the database
                yield row
        except sqlite3.Error as error:
            self.allowance.spend(0)
            raise BrokenOffError(f"the database is damaged: {error}") from error

    def _is_over(self) -> bool:
        self.allowance.left -= _STEPS_AT_ONCE
        return self.allowance.left < 0


@contextmanager
def restored_copy(path: Path) -> Iterator[Path]:
    """Yield the path of a database with all that was committed and nothing half written.

    That is `path` itself, or a copy in a private folder which is removed in the end, if there is a journal or a log of
    changes beside it. A journal that names another file is refused: SQLite would delete that file. Raises InputError,
    sqlite3.Error, OSError.
    """
    path = Path(os.path.realpath(path))  # SQLite looks beside the file that a link leads to
    sources = [path, *(file for ending in BESIDE if _is_pending(file := beside(path, ending)))]
    if len(sources) == 1:
        yield path
        return
    with tempfile.TemporaryDirectory(prefix="localiser-") as folder:
        before = _states(sources)
        needed, free = sum(state[0] for state in before), shutil.disk_usage(folder).free
        if needed > free:
            problem = f"expected {needed} bytes of space to restore the recording in, found {free} in {folder}"
            raise InputError(f"{problem}; set TMPDIR to another folder", path=path)
        copy = Path(folder, "bag.db3")
        for source in sources:
            shutil.copyfile(source, beside(copy, source.name.removeprefix(path.name)))
        if _states(sources) != before:
            raise InputError("is being written; read it when its recorder has ended", path=path)
        journal = beside(copy, "-journal")
        if journal.exists() and journal.read_bytes().endswith(_SUPER_JOURNAL):
            problem = "expected the journal of a bag, found one that has SQLite delete another file"
            raise InputError(f"{problem}; without it the bag is read as it lies", path=beside(path, "-journal"))
        with closing(sqlite3.connect(copy)) as database:
            database.execute("PRAGMA user_version").fetchone()  # restores it, and does not read its tables
        if any(_is_pending(beside(copy, ending)) for ending in BESIDE):
            raise InputError("cannot be restored", path=path)
        yield copy


def beside(path: Path, ending: str) -> Path:
    """Return the path of what SQLite writes beside a database. ending: -journal or -wal, or nothing for itself."""
    return path.with_name(path.name + ending)


def _is_pending(path: Path) -> bool:
    """Whether SQLite would take changes from this file, or take them back. Raises InputError."""
    if not path.exists():
        return False
    with open_regular(path) as file:
        return file.read(1) not in (b"", b"\0")


def _states(paths: list[Path]) -> list[tuple[int, int]]:
    return [(found.st_size, found.st_mtime_ns) for found in (path.stat() for path in paths)]


# -- recording ---------------------------------------------------------------------------------------------------------

SUFFIX = ".db3"


class BagRecorder:
    """Writes a ROS 2 bag of SQLite, message by message as they came.

    Nothing is lost that `commit` was called for, also when the power fails: that is what a database promises, and what
    MCAP, whose index is written at the end, does not.
    """

    def __init__(self, path: Path, latched: Collection[str] = ()) -> None:
        """Make the file. latched: topics whose last message players of bags keep for those who subscribe later.

        Raises InputError for a path that does not end in .db3, OutputError.
        """
        from rosbags.rosbag2.storage_sqlite3 import Sqlite3Writer

        if path.suffix != SUFFIX:
            raise InputError(
                f"expected a path that ends in {SUFFIX} (`localiser convert` makes other kinds of it), found {path}",
                field="--record",
            )
        for place in (path, *(beside(path, ending) for ending in BESIDE)):
            if place.exists():  # also what SQLite would delete
                raise OutputError(f"{place}: expected a path where nothing is, found something there")
        self._path, self._latched, self._store = path, frozenset(latched), typestore(ros1=False)
        self._topics: dict[tuple[str, str], int] = {}
        self._last_ns = 0
        with self._errors():
            path.parent.mkdir(parents=True, exist_ok=True)
            self._database = sqlite3.connect(path, isolation_level=None, check_same_thread=False)
            self._database.executescript(f"BEGIN;{Sqlite3Writer.SQLITE_SCHEMA}COMMIT;BEGIN;")

    def write(self, topic: str, msgtype: str, t_ns: int, content: bytes) -> None:
        """Add a message as it came at `t_ns`; recorded times increase, so that a reader has the order of calls.

        Raises OutputError.
        """
        self._last_ns = max(t_ns, self._last_ns + 1)
        with self._errors():
            self._insert("messages", topic_id=self._topic(topic, msgtype), timestamp=self._last_ns, data=content)

    def commit(self) -> None:
        """Make sure of all that was written. Raises OutputError."""
        with self._errors():
            self._database.execute("COMMIT")
            self._database.execute("BEGIN")

    def close(self) -> None:
        """End the file; what could not be committed is taken back. Raises OutputError."""
        try:
            with self._errors():
                if self._database.in_transaction:
                    self._database.execute("COMMIT")
        finally:
            self._database.close()

    def _topic(self, topic: str, msgtype: str) -> int:
        key = topic, msgtype
        if key not in self._topics:
            from rosbags.rosbag2.metadata import dump_qos_v8

            digest = self._store.hash_rihs01(msgtype)
            text, _ = self._store.generate_msgdef(msgtype, ros_version=2)
            hashed: dict[str, Any] = {"type_description_hash": digest}
            definition = {"topic_type": msgtype, "encoding": "ros2msg", "encoded_message_definition": text}
            self._insert("message_definitions", **definition, **hashed)
            # As numbers: Humble reads no names, later versions read both.
            profiles = dump_qos_v8([latched_quality()]) if topic in self._latched else ""
            row = {"name": topic, "type": msgtype, "serialization_format": "cdr", "offered_qos_profiles": profiles}
            self._topics[key] = self._insert("topics", **row, **hashed)
        return self._topics[key]

    def _insert(self, table: str, **row: Any) -> int:
        """Add a row to a table; returns its number."""
        places = ", ".join("?" * len(row))
        query = f"INSERT INTO {table}({', '.join(row)}) VALUES({places})"
        return int(self._database.execute(query, list(row.values())).lastrowid or 0)

    @contextmanager
    def _errors(self) -> Iterator[None]:
        try:
            with output_errors(self._path):
                yield
        except sqlite3.Error as error:
            raise OutputError(f"{self._path}: cannot be written: {error}") from None


def latched_quality() -> Qos:
    """Return the quality of service of a topic that keeps its last message for late subscribers, and is reliable."""
    from rosbags.interfaces import Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime

    keep, reliable, latched = QosHistory.KEEP_LAST, QosReliability.RELIABLE, QosDurability.TRANSIENT_LOCAL
    never = QosTime(9_223_372_036, 854_775_807)  # what ROS 2 writes for a duration without end
    return Qos(keep, 1, reliable, latched, never, never, QosLiveliness.AUTOMATIC, never, False)
