"""Answer requests of services between two images: look everywhere, load another map."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from localiser.documents import nearest
from localiser.errors import InputError
from localiser.live.inbox import Arrival, Inbox
from localiser.live.transport import ServesRequests, Transport
from localiser.ros import MAP_INVALID, MAP_LOADED, MAP_NOT_THERE, SERVICES, service_bytes, service_message, topic_in
from localiser.storage import read_map

if TYPE_CHECKING:
    from localiser.live.run import LiveRun


def serve(
    transport: Transport, inbox: Inbox, namespace: str = "", names: Mapping[str, str | None] | None = None
) -> None:
    """Let the requests of all services come into the inbox. names: in place of those in SERVICES, None for none.

    namespace: of all names but those that are given with a leading slash. Raises InputError for an unknown kind.
    """
    names = names or {}
    for kind in names:
        if kind not in SERVICES:
            raise InputError(f"unknown kind of service; {nearest(kind, list(SERVICES))}", field="live.services")
    if not isinstance(transport, ServesRequests):
        return
    for kind, service in SERVICES.items():
        if name := topic_in(namespace, names.get(kind, service.name.removeprefix("/"))):
            take = _taker(inbox, kind, name)
            transport.serve(replace(service, name=name), take)


def _taker(inbox: Inbox, kind: str, name: str) -> Callable[[bytes, Callable[[bytes], None]], None]:
    return lambda content, reply: inbox.put(Arrival(kind, name, content, reply=reply))


@dataclass(slots=True, eq=False)
class Requests:
    """Answers requests. folder: where maps may be loaded from; a path that leads elsewhere is refused."""

    folder: Path
    _answers: dict[str, Callable[[LiveRun, Any], dict[str, Any]]] = field(init=False)

    def __post_init__(self) -> None:
        self._answers = {
            "look_everywhere": self._look_everywhere,
            "load_map": self._load_map,
        }

    def answer(self, run: LiveRun, arrival: Arrival) -> None:
        """Do what a request asks for, and answer it. Raises ValueError when it is none."""
        fields = self._answers[arrival.role](run, service_message(arrival.role, "Request", arrival.content))
        if arrival.reply is not None:
            arrival.reply(service_bytes(arrival.role, "Response", **fields))

    def _look_everywhere(self, run: LiveRun, _request: Any) -> dict[str, Any]:
        run.look_everywhere()
        return {}

    def _load_map(self, run: LiveRun, request: Any) -> dict[str, Any]:
        path = self.folder / str(request.map_url).removeprefix("file://")
        if not path.resolve().is_relative_to(self.folder.resolve()) or not path.is_file():
            run.monitor.warn("no such map", f"expected a map in {self.folder}, asked for {request.map_url!r}")
            return {"result": MAP_NOT_THERE}
        try:
            run.load_map(read_map(path), path)
        except InputError as error:
            run.monitor.warn("bad map", f"the map stays as it was: {error}")
            return {"result": MAP_INVALID}
        return {"result": MAP_LOADED}
