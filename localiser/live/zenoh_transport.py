"""Topics over a zenoh session, under the names that ROS 2's own middleware rmw_zenoh gives them.

With nothing to listen on, the session is a client of a router: ROS 2's router passes on what clients say, and nothing
between peers that cannot reach each other. With an address to listen on, it is a router itself. Multicast and gossip
are off: every participant is named by its endpoint.

A message goes under `<domain>/<topic>/<type>/<hash of the type>`. Nodes, publishers, subscribers and services are known
to others by liveliness tokens below `@ros2_lv`. Every message carries an attachment of 33 bytes; a subscriber drops one
without it. What is latched goes through zenoh's advanced publisher, which keeps the last messages, and subscriber,
which asks every publisher that it finds, early or late, for what it missed.
"""

from __future__ import annotations

import json
import struct
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from itertools import count
from pathlib import Path
from threading import Event, Lock, Thread
from typing import Any

from localiser.documents import require_regular, text_of
from localiser.errors import InputError
from localiser.live.transport import ENDPOINT, Reply, Service, Take, Topic, checked_name, dds_type
from localiser.storage.bags import typestore

AGAIN_S = 0.3
_CLOSE_S = 5.0
_HEARTBEAT_S = 0.5  # after a latched message, so that a subscriber notices that it missed one
_RETRY = {"period_init_ms": 200, "period_max_ms": 1000, "period_increase_factor": 2}
_UNREACHABLE = "Unable to connect"
_ATTACHMENT = struct.Struct("<qqB16s")  # sequence number, time in ns, length of the gid, gid
NO_HASH = "TypeHashNotSupported"
"""What ROS 2 Humble has in the place of a type's hash."""


class ZenohLink:
    """A session that is open, or will be once a router can be reached. A router that goes away is waited for."""

    def __init__(
        self, connect: Sequence[str], listen: Sequence[str], *, config_file: str = "", wait: bool = True
    ) -> None:
        """Open a session. wait: whether to wait for a router that cannot be reached. Raises InputError.

        config_file: a configuration of zenoh, as for TLS and passwords. It decides everything but the endpoints that
        are given; empty for none.
        """
        self._connect, self._listen = [text_of(one) for one in connect], [text_of(one) for one in listen]
        self._config_file = config_file
        self._lock, self._stop = Lock(), Event()
        self._session: Any = None
        self._waiting: list[Callable[[Any], None]] = []
        self._thread: Thread | None = None
        try:
            self._session = self._open()
        except _zenoh().ZError as error:
            if not (wait and _UNREACHABLE in str(error)):
                where, reason = ", ".join([*self._connect, *self._listen]), str(error).split(" at /")[0]
                problem = f"expected endpoints such as {ENDPOINT} that can be reached, found {where}: {reason}"
                raise InputError(problem, field="zenoh") from None
            self._thread = Thread(target=self._try_again, name="zenoh", daemon=True)
            self._thread.start()

    def when_open(self, act: Callable[[Any], None]) -> None:
        """Call `act` with the session now, or in another thread as soon as it is open."""
        with self._lock:
            if self._session is None:
                self._waiting.append(act)
                return
        act(self._session)

    def is_joined(self) -> bool:
        """Whether a router is there, or this is one."""
        return self._session is not None and bool(self._listen or self._session.info.routers_zid())

    def close(self) -> None:
        """Leave the network."""
        self._stop.set()
        if self._thread is not None:
            self._thread.join(_CLOSE_S)
        if self._session is not None:
            self._session.close()

    def _open(self) -> Any:
        zenoh = _zenoh()
        config = _from_file(Path(self._config_file)) if self._config_file else zenoh.Config()
        settings: dict[str, Any] = {"connect/endpoints": list(self._connect), "listen/endpoints": list(self._listen)}
        if self._config_file:
            settings = {name: endpoints for name, endpoints in settings.items() if endpoints}
        else:
            settings |= {
                "mode": "router" if self._listen else "client",
                "scouting/multicast/enabled": False,
                "scouting/gossip/enabled": False,
                "transport/shared_memory/enabled": False,  # else a peer that was killed leaves 19 MB behind
                "connect/retry": _RETRY,
                "connect/exit_on_failure": False,
                "connect/timeout_ms": -1 if self._listen and self._connect else 0,
            }
        for name, value in settings.items():
            config.insert_json5(name, json.dumps(value))
        return zenoh.open(config)

    def _try_again(self) -> None:
        zenoh = _zenoh()
        while not self._stop.wait(AGAIN_S):
            try:
                session = self._open()
            except zenoh.ZError:
                continue
            with self._lock:
                self._session, waiting = session, self._waiting
                self._waiting = []
            for act in waiting:
                act(session)
            return


def _from_file(path: Path) -> Any:
    """Return the configuration of zenoh in a file. Raises InputError, without its text: it may hold passwords."""
    require_regular(path)
    try:
        return _zenoh().Config.from_file(text_of(path))
    except _zenoh().ZError:
        problem = "expected a configuration of zenoh, JSON5 or YAML as the name ends, found something else"
        raise InputError(problem, path=path, field="live.zenoh_config") from None


def _zenoh() -> Any:
    try:
        import xxhash  # noqa: F401  # which `gid_of` needs
        import zenoh
    except ImportError as error:
        problem = f"expected the packages eclipse-zenoh and xxhash ({error}); install them with: pip install '.[live]'"
        raise InputError(f"{problem} in a clone") from None
    return zenoh


@dataclass(frozen=True, slots=True)
class RmwNames:
    """Names of one node. domain: only nodes of the same one meet. namespace: "" or such as `/robot1`.

    hashes: whether types have a hash, as from ROS 2 Iron on; Humble has none.
    """

    domain: int = 0
    namespace: str = ""
    node: str = "localiser"
    hashes: bool = True

    def key(self, topic: Topic) -> str:
        """Return the key under which messages are sent."""
        return f"{self._stem(topic)}/{self._hash(topic)}"

    def pattern(self, topic: Topic) -> str:
        """Return the keys under which messages are awaited: of any hash, so that Humble is heard too."""
        return f"{self._stem(topic)}/*"

    def service_key(self, service: Service) -> str:
        """Return the key under which requests come."""
        stem = f"{self.domain}/{checked_name(service.name, 'live.services')}/{dds_type(service.srvtype)}"
        return f"{stem}/{service.type_hash if self.hashes else NO_HASH}"

    def node_token(self, zid: str) -> str:
        """Return the token by which others know the node. zid: of the zenoh session."""
        return self._node(zid, 0, "NN")

    def topic_token(self, zid: str, number: int, topic: Topic, kind: str) -> str:
        """Return the token of a publisher ("MP") or subscriber ("MS"). number: unique in the session, above 0."""
        stem, type_hash = f"{mangled(topic.name)}/{dds_type(topic.msgtype)}", self._hash(topic)
        return f"{self._node(zid, number, kind)}/{stem}/{type_hash}/{quality(topic)}"

    def service_token(self, zid: str, number: int, service: Service) -> str:
        """Return the token of a service; number: see `topic_token`."""
        _, *_, kind, type_hash = self.service_key(service).split("/")
        return f"{self._node(zid, number, 'SS')}/{mangled(service.name)}/{kind}/{type_hash}/{quality(Topic('', ''))}"

    def topic_of(self, key: str) -> tuple[str, str | None]:
        """Return the topic of a key, and the type of its messages where the key tells it."""
        parts = key.split("/")
        if len(parts) >= 4 and "::dds_::" in parts[-2]:
            package, _, rest = parts[-2].partition("::")
            name = rest.rsplit("::", 1)[-1].removesuffix("_")
            return "/" + "/".join(parts[1:-2]), f"{package}/msg/{name}"
        return f"/{key}", None

    def _stem(self, topic: Topic) -> str:
        return f"{self.domain}/{checked_name(topic.name)}/{dds_type(topic.msgtype)}"

    def _node(self, zid: str, number: int, kind: str) -> str:
        return f"@ros2_lv/{self.domain}/{zid}/0/{number}/{kind}/%/{mangled(self.namespace)}/{self.node}"

    def _hash(self, topic: Topic) -> str:
        return type_hash(topic.msgtype) if self.hashes else NO_HASH


def mangled(name: str) -> str:
    """Return a name as one part of a key: `%` stands for the slashes."""
    return "/".join(["", *name.strip("/").split("/")]).replace("/", "%")


@cache
def type_hash(msgtype: str) -> str:
    """Return the hash of a type (REP-2011), such as RIHS01_d31d41a9…"""
    return typestore(ros1=False).hash_rihs01(msgtype)


def quality(topic: Topic) -> str:
    """Return the quality of service as tokens have it; what is empty is the default.

    reliability (2: best effort), durability (1: transient local), history and depth, deadline, lifespan, liveliness.
    """
    return f"{'' if topic.reliable else 2}:{1 if topic.latched else ''}:,{topic.depth}:,:,:,,"


def gid_of(token: str) -> bytes:
    """Return the identity (16 bytes) of whoever a token is of: its XXH3-128, lower half first, little-endian."""
    import xxhash

    return xxhash.xxh3_128_intdigest(token.encode()).to_bytes(16, "little")


def attachment(sequence: int, t_ns: int, gid: bytes) -> bytes:
    """Return the 33 bytes that go with a message. sequence: counts from 1. t_ns: when it is sent, by the calendar."""
    return _ATTACHMENT.pack(sequence, t_ns, len(gid), gid)


def parts_of(content: bytes) -> tuple[int, int, bytes]:
    """Return sequence number, time and gid of an attachment. Raises ValueError unless it is one."""
    if len(content) != _ATTACHMENT.size:
        raise ValueError(f"expected an attachment of {_ATTACHMENT.size} bytes, found {len(content)}")
    sequence, t_ns, length, gid = _ATTACHMENT.unpack(content)
    if length != len(gid):
        raise ValueError(f"expected a gid of {len(gid)} bytes, found {length}")
    return sequence, t_ns, gid


class ZenohTransport:
    """Publishes and subscribes on one session; also what is asked for before the session is open."""

    def __init__(self, link: ZenohLink, names: RmwNames) -> None:
        """Take part under these names."""
        self._link, self._names = link, names
        self._numbers, self._lock = count(1), Lock()
        self._held: list[Any] = []
        self._publishers: dict[str, _Publisher] = {}
        link.when_open(lambda session: self._declare_token(session, names.node_token(_zid(session))))

    def subscribe(self, topic: Topic, take: Take) -> None:
        """See `Transport`."""
        pattern = self._names.pattern(topic)
        number = next(self._numbers)

        def handle(sample: Any) -> None:
            take(sample.payload.to_bytes(), _source_of(sample))

        def declare(session: Any) -> None:
            if topic.latched:
                from zenoh import ext

                history = ext.HistoryConfig(detect_late_publishers=True, max_samples=topic.depth)
                recovery = ext.RecoveryConfig(periodic_queries=None, heartbeat=True)
                subscriber = ext.declare_advanced_subscriber(
                    session, pattern, handle, history=history, recovery=recovery
                )
                self._held.append(subscriber)
            else:
                self._held.append(session.declare_subscriber(pattern, handle))
            self._declare_token(session, self._names.topic_token(_zid(session), number, topic, "MS"))

        self._link.when_open(declare)

    def advertise(self, topic: Topic) -> None:
        """See `Transport`."""
        self._publisher(topic)

    def publish(self, topic: Topic, content: bytes) -> None:
        """See `Transport`. What is latched and sent before the session is open goes out then."""
        self._publisher(topic).put(content)

    def is_heard(self, topic: Topic) -> bool:
        """See `Transport`."""
        return self._publisher(topic).is_heard()

    def serve(self, service: Service, take: Callable[[bytes, Reply], None]) -> None:
        """See `Transport`."""
        key, number = self._names.service_key(service), next(self._numbers)

        def handle(query: Any) -> None:
            try:
                sequence, _, gid = parts_of(query.attachment.to_bytes() if query.attachment is not None else b"")
            except ValueError:  # no request of ROS 2
                query.drop()
                return

            def reply(content: bytes) -> None:
                query.reply(key, content, attachment=attachment(sequence, time.time_ns(), gid))
                query.drop()

            take(b"" if query.payload is None else query.payload.to_bytes(), reply)

        def declare(session: Any) -> None:
            self._held.append(session.declare_queryable(key, handle, complete=True))
            self._declare_token(session, self._names.service_token(_zid(session), number, service))

        self._link.when_open(declare)

    def listen_to_all(self, take: Callable[[str, str | None, bytes], None]) -> None:
        """See `Transport`."""

        def handle(sample: Any) -> None:
            take(*self._names.topic_of(str(sample.key_expr)), sample.payload.to_bytes())

        everything = f"{self._names.domain}/**"
        self._link.when_open(lambda session: self._held.append(session.declare_subscriber(everything, handle)))

    def is_joined(self) -> bool:
        """See `Transport`."""
        return self._link.is_joined()

    def report_to(self, report: Callable[[str], None]) -> None:
        """See `Transport`. Nothing is reported here: zenoh has no quality of service that could differ."""

    def close(self) -> None:
        """See `Transport`."""
        self._link.close()

    def _publisher(self, topic: Topic) -> _Publisher:
        with self._lock:
            if topic.name not in self._publishers:
                publisher = self._publishers[topic.name] = _Publisher(topic, self._names.key(topic))
                number = next(self._numbers)

                def declare(session: Any) -> None:
                    token = self._names.topic_token(_zid(session), number, topic, "MP")
                    publisher.declare(session, token)
                    self._declare_token(session, token)

                self._link.when_open(declare)
            return self._publishers[topic.name]

    def _declare_token(self, session: Any, token: str) -> None:
        self._held.append(session.liveliness().declare_token(token))


class _Publisher:
    """A publisher of one topic, which exists on the network once the session is open."""

    def __init__(self, topic: Topic, key: str) -> None:
        self._topic, self._key = topic, key
        self._declared: Any = None
        self._gid = b""
        self._sequence = 0
        self._kept: bytes | None = None
        self._lock = Lock()

    def declare(self, session: Any, token: str) -> None:
        """Begin to exist; what was latched before goes out now. token: by which others know it."""
        import zenoh
        from zenoh import ext

        with self._lock:
            self._gid = gid_of(token)
            options: dict[str, Any] = {"congestion_control": zenoh.CongestionControl.DROP, "express": True}
            if self._topic.latched:
                missed = ext.MissDetectionConfig(heartbeat=None, sporadic_heartbeat=_HEARTBEAT_S)
                options |= {"cache": ext.CacheConfig(self._topic.depth), "sample_miss_detection": missed}
                self._declared = ext.declare_advanced_publisher(session, self._key, publisher_detection=True, **options)
            else:
                self._declared = session.declare_publisher(self._key, **options)
            kept, self._kept = self._kept, None
        if kept is not None:
            self.put(kept)

    def put(self, content: bytes) -> None:
        """Send a message."""
        with self._lock:
            if self._declared is None:
                self._kept = content if self._topic.latched else None
                return
            self._sequence += 1
            self._declared.put(content, attachment=attachment(self._sequence, time.time_ns(), self._gid))

    def is_heard(self) -> bool:
        """Whether anyone subscribes now; whoever comes later counts for what is latched."""
        if self._topic.latched:
            return True
        return self._declared is not None and bool(self._declared.matching_status.matching)


def _zid(session: Any) -> str:
    return str(session.info.zid())


def _source_of(sample: Any) -> bytes:
    """Return who sent a message, b"" where it does not say."""
    try:
        return parts_of(b"" if sample.attachment is None else sample.attachment.to_bytes())[2]
    except ValueError:
        return b""
