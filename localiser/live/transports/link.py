"""A zenoh session, which may have to wait for its router.

With nothing to listen on, the session is a client of a router: ROS 2's router passes on what clients say, and nothing
between peers that cannot reach each other. With an address to listen on, it is a router itself, so that a robot, and
whoever watches it, may connect here. Multicast and gossip are off: every participant is named by its endpoint.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from pathlib import Path
from threading import Event, Lock, Thread
from typing import Any

from localiser.documents import require_regular, text_of
from localiser.errors import InputError

ENDPOINT = "tcp/127.0.0.1:7447"
"""Where a router on this machine is expected; 7447 is zenoh's port."""

AGAIN_S = 0.3
_CLOSE_S = 5.0
_RETRY = {"period_init_ms": 200, "period_max_ms": 1000, "period_increase_factor": 2}
_UNREACHABLE = "Unable to connect"


class ZenohLink:
    """A session that is open, or will be once a router can be reached. A router that goes away is waited for."""

    def __init__(
        self,
        connect: Sequence[str] = (ENDPOINT,),
        listen: Sequence[str] = (),
        *,
        config_file: str = "",
        wait: bool = True,
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
                raise self._refused(error) from None
            self._thread = Thread(target=self._try_again, name="zenoh", daemon=True)
            self._thread.start()

    def when_open(self, act: Callable[[Any], None]) -> None:
        """Call `act` with the session now, or in another thread as soon as it is open."""
        with self._lock:
            if self._session is None:
                self._waiting.append(act)
                return
        act(self._session)

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
        settings: dict[str, Any] = {
            "connect/endpoints": list(self._connect),
            "listen/endpoints": list(self._listen),
        }
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

    def _refused(self, error: Exception) -> InputError:
        where = ", ".join([*self._connect, *self._listen])
        reason = str(error).split(" at /")[0]
        return InputError(
            f"expected endpoints such as {ENDPOINT} that can be reached, found {where}: {reason}", field="zenoh"
        )


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
        import zenoh
    except ImportError:
        raise InputError("expected the package eclipse-zenoh; install it with: pip install 'eclipse-zenoh<2'") from None
    return zenoh
