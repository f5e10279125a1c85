"""A robot that something is wrong with: the stand-in, whose messages go wrong as lines on standard input say.

Its true poses are written on standard output, as lines of JSON.

python faulty_robot.py LOG ENDPOINT
"""

from __future__ import annotations

import json
import sys
from collections import Counter
from contextlib import closing
from pathlib import Path
from random import Random
from threading import Event, Thread

from localiser.config import LiveParameters
from localiser.live import Passage, StandIn, open_transport
from localiser.live.stand_in import IMAGE, TRUTH, WHEELS
from localiser.live.transport import Transport
from localiser.ros import Topic
from localiser.storage import open_log
from localiser.storage.bags import RosType, floor_pose, stamp_of, typestore

EVERY = {IMAGE: 7, WHEELS: 3}
"""One of so many messages goes wrong."""

HOUR_S = 3600
_SECONDS = slice(4, 8)  # of the stamp in the header that a message begins with, after four bytes of CDR's own


class FaultyTransport:
    """Sends what has become of messages. fault: what is wrong now, "" if nothing."""

    def __init__(self, transport: Transport) -> None:
        self._transport = transport
        self._count: Counter[Topic] = Counter()
        self._held: dict[Topic, list[bytes]] = {topic: [] for topic in EVERY}
        self._random = Random(0)
        self.fault = ""
        self.advertise, self.is_heard = transport.advertise, transport.is_heard

    def publish(self, topic: Topic, content: bytes) -> None:
        """Send what has become of a message; the truth is written out."""
        if topic == TRUTH:
            message = typestore(ros1=False).deserialize_cdr(content, RosType.ODOMETRY)
            sys.stdout.write(f"{json.dumps({'t_ns': stamp_of(message), 'pose': floor_pose(message)})}\n")
            sys.stdout.flush()
        for message in self._made_of(topic, content) if topic in EVERY else [content]:
            self._transport.publish(topic, message)

    def _made_of(self, topic: Topic, content: bytes) -> list[bytes]:
        """Return what is sent in the place of a message."""
        self._count[topic] += 1
        held, self._held[topic] = self._held[topic], []
        goes_wrong = self._count[topic] % EVERY[topic] == 0
        match self.fault:
            case "no odometry" if topic == WHEELS:
                return []
            case "duplicated" if goes_wrong:
                return [content, content]
            case "reordered" if goes_wrong:
                self._held[topic] = [content]
                return held
            case "in the future" if goes_wrong:
                return [_an_hour_ahead(content)]
            case "corrupt" if goes_wrong and topic == IMAGE:
                return [_without_middle(content) if self._count[topic] % 2 else _without_end(content)]
            case "junk" if goes_wrong:
                held = [self._random.randbytes(self._random.randrange(400)), *held]
        return [content, *held]


def _an_hour_ahead(content: bytes) -> bytes:
    ahead = bytearray(content)
    ahead[_SECONDS] = (int.from_bytes(ahead[_SECONDS], "little") + HOUR_S).to_bytes(4, "little")
    return bytes(ahead)


def _without_middle(content: bytes) -> bytes:
    third = len(content) // 3
    return content[:third] + bytes(third) + content[2 * third :]


def _without_end(content: bytes) -> bytes:
    return content[: len(content) // 2] + bytes(len(content) - len(content) // 2)


def main(log: Path, endpoint: str) -> None:
    with closing(open_transport(LiveParameters([], [endpoint]))) as transport:
        faulty, stop = FaultyTransport(transport), Event()
        robot = StandIn(faulty, Passage.of(open_log(log)))
        robot.wait_for_listener(stop)
        running = Thread(target=robot.run, args=(stop,))
        running.start()
        for line in sys.stdin:
            faulty.fault = line.strip()
        stop.set()
        running.join()


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2])
