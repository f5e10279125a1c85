"""A session on a zenoh network: receives messages of a robot and sends poses.

Multicast is off. Every peer is named by its endpoint.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from localiser.documents import require_regular
from localiser.errors import InputError
from localiser.live.sources.inbox import Arrival, Inbox
from localiser.live.sources.keys import keys_of

ENDPOINT = "tcp/127.0.0.1:7447"
"""Where a robot on this machine is expected; 7447 is zenoh's port."""

_ANY_PORT = "tcp/127.0.0.1:0"  # without one of its own, zenoh listens on every interface
_RETRY = {"period_init_ms": 200, "period_max_ms": 2000, "period_increase_factor": 2}


class Network:
    """A zenoh session; to be used as a context manager, or closed. Peers that go away are waited for."""

    def __init__(
        self,
        connect: Sequence[str] = (ENDPOINT,),
        listen: Sequence[str] = (),
        *,
        client: bool = False,
        config_file: Path | None = None,
    ) -> None:
        """Open a session. client: only to say something to one peer. Raises InputError.

        config_file: a configuration of zenoh, as for TLS and passwords. It decides everything but the endpoints that
        are given.
        """
        zenoh = _zenoh()
        config = zenoh.Config() if config_file is None else _from_file(config_file)
        settings: dict[str, Any] = {
            "mode": "client" if client else "peer",
            "scouting/multicast/enabled": False,
            "connect/endpoints": list(connect),
            "connect/retry": _RETRY,
            "connect/exit_on_failure": client,
            "connect/timeout_ms": 2000 if client else (-1 if connect else 0),
            "listen/endpoints": [] if client else list(listen) or [_ANY_PORT],
        }
        if config_file is not None:
            given = {"connect/endpoints": list(connect), "listen/endpoints": list(listen)}
            settings = {name: endpoints for name, endpoints in given.items() if endpoints}
        try:
            for name, value in settings.items():
                config.insert_json5(name, json.dumps(value))
            self._session: Any = zenoh.open(config)
        except zenoh.ZError as error:
            where = ", ".join([*connect, *listen])
            reason = str(error).split(" at /")[0]
            raise InputError(
                f"expected endpoints such as {ENDPOINT} that can be reached, found {where}: {reason}", field="zenoh"
            ) from None
        self._held: list[Any] = []
        self._publishers: dict[str, Any] = {}

    def __enter__(self) -> Network:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Leave the network."""
        self._session.close()

    def subscribe(self, role: str, topic: str, msgtype: str, inbox: Inbox) -> None:
        """Put every message on a topic into the inbox; also the last one of a topic that is kept for latecomers."""

        def take(sample: Any) -> None:
            inbox.put(Arrival(role, topic, sample.payload.to_bytes()))

        def take_reply(reply: Any) -> None:
            if reply.ok is not None:
                take(reply.ok)

        for key in self._checked(topic, keys_of(topic, msgtype)):
            self._held.append(self._session.declare_subscriber(key, take))
            if role == "transforms":  # what ROS calls transient local
                self._session.get(key, take_reply)

    def listen_to_all(self, heard: Callable[[str, bytes], None]) -> None:
        """Call `heard` with key and content of every message on the network, in a thread of zenoh's."""
        take = lambda sample: heard(str(sample.key_expr), sample.payload.to_bytes())  # noqa: E731
        self._held.append(self._session.declare_subscriber("**", take))

    def keep(self, topic: str, content: bytes) -> None:
        """Answer with `content` whoever asks later for what was sent on a topic."""
        (key,) = self._checked(topic, [topic.strip("/")])
        self._held.append(self._session.declare_queryable(key, lambda query: query.reply(key, content)))

    def publish(self, topic: str, content: bytes) -> None:
        """Send a message under a bridge's key; to those who are too slow for it, not at all."""
        self._publisher(topic).put(content)

    def is_heard(self, topic: str) -> bool:
        """Whether anyone subscribes to a topic."""
        return bool(self._publisher(topic).matching_status.matching)

    def _publisher(self, topic: str) -> Any:
        if topic not in self._publishers:
            (key,) = self._checked(topic, [topic.strip("/")])
            drop = _zenoh().CongestionControl.DROP
            self._publishers[topic] = self._session.declare_publisher(key, congestion_control=drop, express=True)
        return self._publishers[topic]

    def _checked(self, topic: str, keys: Sequence[str]) -> Sequence[str]:
        try:
            for key in keys:
                _zenoh().KeyExpr(key)
        except _zenoh().ZError:
            raise InputError(f"expected the name of a topic, found {topic!r}", field="--topic") from None
        return keys


def _from_file(path: Path) -> Any:
    """Return the configuration of zenoh in a file. Raises InputError, without its text: it may hold passwords."""
    require_regular(path)
    try:
        return _zenoh().Config.from_file(str(path))
    except _zenoh().ZError:
        problem = "expected a configuration of zenoh, JSON5 or YAML as the name ends, found something else"
        raise InputError(problem, path=path, field="--zenoh-config") from None


def _zenoh() -> Any:
    try:
        import zenoh
    except ImportError:
        raise InputError(
            "expected the package eclipse-zenoh; install it with: pip install '.[live]' in a clone"
        ) from None
    return zenoh
