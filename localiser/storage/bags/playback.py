"""Fetch the images of a bag one at a time, when they are asked for: a bag may be larger than memory."""

from __future__ import annotations

import weakref
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from localiser.camera import Mount
from localiser.errors import InputError
from localiser.storage.bags.bag import Bag, Message, Topic
from localiser.storage.bags.images import image_file
from localiser.storage.images import ImageEvent, check_whole, image_event


@dataclass(frozen=True, slots=True)
class ImagePlace:
    """Where an image stands in a bag. stamp_ns: when it was taken. recorded_ns: when it was recorded.

    order: how many images of its topic were recorded before it. later: how many of those at the same time.
    offset_ns: what was added to the stamp in its message, because the robot's clock had jumped.
    """

    stamp_ns: int
    recorded_ns: int
    order: int
    later: int
    offset_ns: int = 0


class Playback:
    """Fetches images of one topic; in the order of recording each is read once, in any other the bag is searched."""

    def __init__(self, path: Path, topic: Topic, size: tuple[int, int]) -> None:
        """Prepare to read; the bag is opened when the first image is asked for. size: (width, height) expected."""
        self._path, self._topic, self._size = path, topic, size
        self._bag: Bag | None = None
        self._messages: Iterator[Message] = iter(())
        self._next = 0
        self._last: tuple[int, bytes] | None = None

    def event(self, place: ImagePlace, *, by_wheels: bool = True, mount: Mount | None = None) -> ImageEvent:
        """Return the image as an event of a log; by_wheels, mount: see there."""
        field = f"{self._topic.name} at {place.stamp_ns} ns"

        def file() -> bytes:
            """Return the image as a JPEG or PNG file that is whole and of the right size."""
            if self._last is None or self._last[0] != place.order:
                try:
                    data = image_file(self._fetch(place).content)
                except ValueError as error:
                    raise InputError(str(error), path=self._path, field=field) from None
                check_whole(data, self._size, path=self._path, field=field)
                self._last = (place.order, data)
            return self._last[1]

        name = f"{self._topic.name}/{place.order:06d}"
        return image_event(
            place.stamp_ns, name, file, self._size, path=self._path, field=field, by_wheels=by_wheels, mount=mount
        )

    def _fetch(self, place: ImagePlace) -> Message:
        if self._bag is None or place.order != self._next:
            self._messages = self._from(place)
        message = next(self._messages, None)
        if message is None or message.stamp_ns + place.offset_ns != place.stamp_ns:
            raise InputError("expected the image that was here when the bag was opened", path=self._path)
        self._next = place.order + 1
        return message

    def _from(self, place: ImagePlace) -> Iterator[Message]:
        """Return the messages from an image on."""
        if self._bag is None:
            self._bag = Bag(self._path)
            weakref.finalize(self, self._bag.close)
        messages = self._bag.messages([self._topic], place.recorded_ns)
        for _ in range(place.later):
            next(messages, None)
        return messages
