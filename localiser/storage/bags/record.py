"""Record a bag while messages come. Whatever ends the program, what was committed can be read."""

from __future__ import annotations

import sqlite3
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from localiser.documents import output_errors
from localiser.errors import InputError, OutputError
from localiser.storage.bags.bag import typestore
from localiser.storage.bags.restore import BESIDE, beside

if TYPE_CHECKING:
    from rosbags.interfaces import Qos

SUFFIX = ".db3"

_TABLES = """
CREATE TABLE schema(schema_version INTEGER PRIMARY KEY, ros_distro TEXT NOT NULL);
CREATE TABLE metadata(id INTEGER PRIMARY KEY, metadata_version INTEGER NOT NULL, metadata TEXT NOT NULL);
CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT NOT NULL, type TEXT NOT NULL, serialization_format TEXT NOT NULL,
  offered_qos_profiles TEXT NOT NULL, type_description_hash TEXT NOT NULL);
CREATE TABLE message_definitions(id INTEGER PRIMARY KEY, topic_type TEXT NOT NULL, encoding TEXT NOT NULL,
  encoded_message_definition TEXT NOT NULL, type_description_hash TEXT NOT NULL);
CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER NOT NULL, timestamp INTEGER NOT NULL,
  data BLOB NOT NULL);
CREATE INDEX timestamp_idx ON messages (timestamp ASC);
INSERT INTO schema(schema_version, ros_distro) VALUES (4, 'humble');
"""


def latched_quality() -> Qos:
    """Return the quality of service of a topic that keeps its last message for late subscribers, and is reliable."""
    from rosbags.interfaces import Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime

    keep, reliable, latched = QosHistory.KEEP_LAST, QosReliability.RELIABLE, QosDurability.TRANSIENT_LOCAL
    never = QosTime(9_223_372_036, 854_775_807)  # what ROS 2 writes for a duration without end
    return Qos(keep, 1, reliable, latched, never, never, QosLiveliness.AUTOMATIC, never, False)


class BagRecorder:
    """Writes a ROS 2 bag of SQLite, message by message as they came.

    Nothing is lost that `commit` was called for, also when the power fails: that is what a database promises, and what
    MCAP, whose index is written at the end, does not.
    """

    def __init__(self, path: Path, latched: Collection[str] = ()) -> None:
        """Make the file. latched: topics whose last message players of bags keep for those who subscribe later.

        Raises InputError for a path that does not end in .db3, OutputError.
        """
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
            self._database.executescript(f"BEGIN;{_TABLES}COMMIT;BEGIN;")

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
