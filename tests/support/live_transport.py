"""A transport that keeps what is published, for tests in one process."""

from dataclasses import dataclass, field
from typing import Any

from localiser.live.transport import Take, Topic
from localiser.storage.bags import typestore


@dataclass
class KeepingTransport:
    """Keeps messages by topic. heard: the topics that somebody listens to, None for all; what is latched always is."""

    heard: set[str] | None = None
    advertised: list[str] = field(default_factory=list)
    sent: dict[str, list[tuple[Topic, bytes]]] = field(default_factory=dict)

    def advertise(self, topic: Topic) -> None:
        self.advertised.append(topic.name)

    def subscribe(self, topic: Topic, take: Take) -> None:
        raise AssertionError("nothing is sent here")

    def publish(self, topic: Topic, content: bytes) -> None:
        self.sent.setdefault(topic.name, []).append((topic, content))

    def is_heard(self, topic: Topic) -> bool:
        return topic.latched or self.heard is None or topic.name in self.heard

    def close(self) -> None:
        pass

    def kinds(self) -> set[str]:
        return set(self.sent)

    def messages(self, name: str, first: int = 0) -> list[Any]:
        store = typestore(ros1=False)
        return [store.deserialize_cdr(content, topic.msgtype) for topic, content in self.sent.get(name, [])[first:]]
