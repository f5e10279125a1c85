"""Bags that hold texts only."""

from pathlib import Path

from localiser.storage.bags import Messages
from localiser.storage.bags.bag import Bag

MAKE = Messages()


def text(words: str) -> bytes:
    return MAKE.encode(MAKE.text(words))


def texts(path: Path) -> list[str]:
    with Bag(path) as bag:
        return [message.content.data for message in bag.messages(bag.topics)]
