"""Topics over a zenoh session, under the names of rmw_zenoh.

What is latched goes through zenoh's advanced publisher and subscriber: the publisher keeps the last messages, the
subscriber asks every publisher that it finds, early or late, for what it missed.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from itertools import count
from threading import Lock
from typing import Any

from localiser.documents import text_of
from localiser.errors import InputError
from localiser.live.transports.link import ZenohLink
from localiser.live.transports.rmw_names import RmwNames, attachment, gid_of, parts_of
from localiser.live.transports.transport import Reply, Service, Take, Topic

_HEARTBEAT_S = 0.5  # after a latched message, so that a subscriber notices that it missed one


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
        pattern = _checked(topic, self._names.pattern(topic))
        number = next(self._numbers)

        def handle(sample: Any) -> None:
            take(sample.payload.to_bytes(), _source_of(sample))

        def declare(session: Any) -> None:
            if topic.latched:
                self._held.append(_latched_subscriber(session, pattern, topic.depth, handle))
            else:
                self._held.append(session.declare_subscriber(pattern, handle))
            self._declare_token(session, self._names.subscriber_token(_zid(session), number, topic))

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
        """See `ServesRequests`."""
        key, number = self._names.service_key(service), next(self._numbers)

        def handle(query: Any) -> None:
            sequence, _, gid = parts_of(query.attachment.to_bytes() if query.attachment is not None else b"")

            def reply(content: bytes) -> None:
                query.reply(key, content, attachment=attachment(sequence, time.time_ns(), gid))
                query.drop()

            take(b"" if query.payload is None else query.payload.to_bytes(), reply)

        def declare(session: Any) -> None:
            self._held.append(session.declare_queryable(key, _checked_query(handle), complete=True))
            self._declare_token(session, self._names.service_token(_zid(session), number, service))

        self._link.when_open(declare)

    def listen_to_all(self, take: Callable[[str, str | None, bytes], None]) -> None:
        """See `HearsAll`."""

        def handle(sample: Any) -> None:
            take(*self._names.topic_of(str(sample.key_expr)), sample.payload.to_bytes())

        everything = self._names.everything
        self._link.when_open(lambda session: self._held.append(session.declare_subscriber(everything, handle)))

    def close(self) -> None:
        """See `Transport`."""
        self._link.close()

    def _publisher(self, topic: Topic) -> _Publisher:
        with self._lock:
            if topic.name not in self._publishers:
                key = _checked(topic, self._names.key(topic))
                publisher = self._publishers[topic.name] = _Publisher(topic, key)
                number = next(self._numbers)

                def declare(session: Any) -> None:
                    token = self._names.publisher_token(_zid(session), number, topic)
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
        with self._lock:
            self._gid = gid_of(token)
            self._declared = _declared(session, self._topic, self._key)
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


def _declared(session: Any, topic: Topic, key: str) -> Any:
    import zenoh
    from zenoh import ext

    options: dict[str, Any] = {"congestion_control": zenoh.CongestionControl.DROP, "express": True}
    if not topic.latched:
        return session.declare_publisher(key, **options)
    return ext.declare_advanced_publisher(
        session,
        key,
        cache=ext.CacheConfig(topic.depth),
        sample_miss_detection=ext.MissDetectionConfig(heartbeat=None, sporadic_heartbeat=_HEARTBEAT_S),
        publisher_detection=True,
        **options,
    )


def _latched_subscriber(session: Any, pattern: str, depth: int, handle: Callable[[Any], None]) -> Any:
    from zenoh import ext

    return ext.declare_advanced_subscriber(
        session,
        pattern,
        handle,
        history=ext.HistoryConfig(detect_late_publishers=True, max_samples=depth),
        recovery=ext.RecoveryConfig(periodic_queries=None, heartbeat=True),
    )


def _zid(session: Any) -> str:
    return str(session.info.zid())


def _source_of(sample: Any) -> bytes:
    """Return who sent a message, b"" where it does not say."""
    try:
        return parts_of(b"" if sample.attachment is None else sample.attachment.to_bytes())[2]
    except ValueError:
        return b""


def _checked(topic: Topic, key: str) -> str:
    """Return a key. Raises InputError when the topic's name makes none."""
    import zenoh

    try:
        zenoh.KeyExpr(text_of(key))
    except zenoh.ZError:
        raise InputError(f"expected the name of a topic, found {topic.name!r}", field="live.topics") from None
    if any(mark in topic.name for mark in "*$?#") or not topic.name.strip("/"):
        raise InputError(f"expected the name of a topic, found {topic.name!r}", field="live.topics")
    return key


def _checked_query(handle: Callable[[Any], None]) -> Callable[[Any], None]:
    """Return a handler of queries that leaves out those which are no request of ROS 2."""

    def checked(query: Any) -> None:
        try:
            handle(query)
        except ValueError:
            query.drop()

    return checked
