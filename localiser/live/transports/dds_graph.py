"""The graph of ROS 2 over DDS: the node that we are, and the topics that others publish.

Which topics belong to which node, DDS does not tell. So every participant says it in a message on `ros_discovery_info`:
the names of its nodes, with the identities of their publishers and subscribers.
"""

from __future__ import annotations

from collections.abc import Callable
from threading import Event, Lock, Thread
from typing import Any

import numpy as np

from localiser.live.transports.dds_types import dds, dds_type, raw, ros_type

TOPIC = "ros_discovery_info"
_INFO, _NODE, _GID = (f"rmw_dds_common/msg/{name}" for name in ("ParticipantEntitiesInfo", "NodeEntitiesInfo", "Gid"))
_LOOK_S = 0.1
_MOST_AT_ONCE = 100


class Node:
    """Tells others of one node. namespace: begins with a slash. humble: identities are longer there (24 bytes)."""

    def __init__(self, participant: Any, name: str, namespace: str, humble: bool) -> None:
        """Tell of a node that has no topics yet."""
        from rosbags.typesys import Stores, get_typestore

        package, policy = dds(), dds().core.Policy
        self._store = get_typestore(Stores.ROS2_HUMBLE if humble else Stores.ROS2_JAZZY)
        self._participant, self._name, self._namespace = participant, name, namespace
        self._lock = Lock()
        self._ours: tuple[list[Any], list[Any]] = [], []
        topic = package.topic.Topic(participant, TOPIC, raw(self._store, _INFO, dds_type(_INFO)))
        quality = package.core.Qos(
            policy.Reliability.Reliable(max_blocking_time=0),
            policy.Durability.TransientLocal,
            policy.History.KeepLast(1),
            policy.DurabilityService(0, policy.History.KeepLast(1), -1, -1, -1),
            policy.DataRepresentation(use_cdrv0_representation=True, use_xcdrv2_representation=False),
        )
        self._writer = package.pub.DataWriter(participant, topic, quality)
        self._tell()

    def has(self, reader: Any = None, writer: Any = None) -> None:
        """Tell that a subscriber or a publisher belongs to the node."""
        with self._lock:
            for ours, new in zip(self._ours, (reader, writer), strict=True):
                if new is not None:
                    ours.append(self._gid(new))
            self._tell()

    def _tell(self) -> None:
        types = self._store.types
        readers, writers = self._ours
        node = types[_NODE](self._namespace, self._name, readers, writers)
        info = types[_INFO](self._gid(self._participant), [node])
        content = bytes(self._store.serialize_cdr(info, _INFO))
        self._writer.write(self._writer.topic.data_type(content))

    def _gid(self, entity: Any) -> Any:
        make = self._store.types[_GID]
        length = self._store.fielddefs[_GID][1][0][1][1][1]
        return make(np.frombuffer(entity.get_guid().bytes.ljust(length, b"\0"), dtype=np.uint8))


class Publications:
    """Finds the topics of ROS 2 that others publish, in a thread of its own."""

    def __init__(self, participant: Any, found: Callable[[str, str], None]) -> None:
        """Begin. found: takes name and type of every topic, once."""
        package = dds()
        self._reader = package.builtin.BuiltinDataReader(participant, package.builtin.BuiltinTopicDcpsPublication)
        self._own, self._found = participant.get_guid(), found
        self._known: set[str] = set()
        self._stop = Event()
        self._thread = Thread(target=self._look, name="dds topics", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Stop."""
        self._stop.set()
        self._thread.join()
        self._reader._delete(self._reader._ref)

    def _look(self) -> None:
        while not self._stop.wait(_LOOK_S):
            for one in self._reader.take(_MOST_AT_ONCE):
                name = one.topic_name or ""
                if one.participant_key != self._own and name.startswith("rt/") and name not in self._known:
                    self._known.add(name)
                    self._found(name.removeprefix("rt"), ros_type(one.type_name))
