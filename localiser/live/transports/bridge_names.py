"""Names of topics on a zenoh network, as zenoh-bridge-ros2dds has them: the topic without its leading slash.

The bridge tells types and nodes in tokens of its own, which a robot does not need to be heard.
"""

from __future__ import annotations

from dataclasses import dataclass

from localiser.live.transports.transport import Topic


@dataclass(frozen=True, slots=True)
class BridgeNames:
    """Names as a bridge has them. It keeps domains apart by a namespace of its own, if at all."""

    def key(self, topic: Topic) -> str:
        """Return the key under which messages are sent."""
        return topic.name.strip("/")

    def pattern(self, topic: Topic) -> str:
        """Return the keys under which messages are awaited."""
        return self.key(topic)

    @property
    def everything(self) -> str:
        """The keys of all messages."""
        return "**"

    def topic_of(self, key: str) -> tuple[str, str | None]:
        """Return the topic of a key; types are not told."""
        return f"/{key}", None
