"""A flood of messages at a live run, over zenoh and over DDS: how soon are images located at their full rate again?

    python benchmarks/flood.py --times 10

A robot drives the log that ships, at 5 images a second. Another process publishes 40,000 messages as fast as it can:
odometry from the future, or one image again and again. Images are told apart by their stamps: from the last one that
was lost, or the end of the flood where none was lost after it, all are located.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parent.parent
sys.path[:0] = [str(ROOT / "tests" / "support")]

from live_networks import KINDS, Network, domains  # noqa: E402
from live_processes import SETTINGS, START, Program, program  # noqa: E402

from localiser.live import open_transport  # noqa: E402
from localiser.live.stand_in import IMAGE, WHEELS  # noqa: E402
from localiser.live.transport import Topic  # noqa: E402
from localiser.storage import ImageEvent, open_log  # noqa: E402
from localiser.storage.bags import ODOM, Messages  # noqa: E402

LOG = ROOT / "logs" / "corridor"
FLOOD = 40_000
FAR_NS = 2 * 10**18  # a stamp in 2033
BEFORE_S, AFTER_S = 3.0, 5.0
PERIOD_S = 0.2


def message(topic: Topic) -> bytes:
    """Return odometry with a stamp that cannot be true, or an image of the log with one of now."""
    make = Messages()
    if topic == WHEELS:
        return make.encode(make.odometry(FAR_NS, ODOM, np.zeros(3)))
    frame = open_log(LOG).frames[0]
    assert isinstance(frame, ImageEvent)
    return make.encode(make.compressed(time.time_ns(), frame.encoded()))


def flooded(run: Program, flood: Callable[[], None]) -> tuple[float, float, int, int]:
    """Return the seconds that a flood took and those until the full rate was back, images lost during and after it."""
    time.sleep(BEFORE_S)
    run.rest()
    before = run.poses(1)
    begin_s = time.time()
    flood()
    end_s = time.time()
    time.sleep(AFTER_S)
    stamps_s = np.unique([line["stamp_ns"] for line in before + run.rest()]) / 1e9
    stamps_s = stamps_s[stamps_s > begin_s - 1.0]  # not that of the image of the flood
    late = np.flatnonzero(np.diff(stamps_s) > 1.5 * PERIOD_S)
    lost_s = [t for k in late for t in np.arange(stamps_s[k] + PERIOD_S, stamps_s[k + 1] - PERIOD_S / 2, PERIOD_S)]
    if time.time() - stamps_s[-1] > 1.0:
        raise SystemExit("no images are located any more")
    after = [t for t in lost_s if t > end_s]
    return end_s - begin_s, max([t - end_s for t in after], default=0.0), len(lost_s) - len(after), len(after)


def measured(kind: str, network: Network, topic: Topic, times: int) -> None:
    """Print how a run got over some floods of messages on a topic."""
    content = message(topic)
    live = ("live", "--map", LOG / "map.yaml", "--start", START, "--json", *SETTINGS)
    robot = ("simulate", LOG, "--serve", "--quiet")
    rows = []
    with (
        program(*live, *network.arguments) as run,
        program(*robot, *network.arguments),
        closing(open_transport(network.options)) as other,
    ):
        run.poses(20)
        while not other.is_heard(topic):
            time.sleep(0.01)

        def flood() -> None:
            for _ in range(FLOOD):
                other.publish(topic, content)

        rows = [flooded(run, flood) for _ in range(times)]
    sent, back, during, after = (np.array(column) for column in zip(*rows, strict=True))
    print(
        f"{kind:6} {topic.name:28} {len(content):6d} B  sent in {np.median(sent):5.2f} s  full rate after "
        f"{np.median(back):4.2f} s (worst {back.max():4.2f})  images lost during, after: {during.sum()}, {after.sum()}"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--times", type=int, default=5)
    times = parser.parse_args().times
    for kind in KINDS:
        for topic in (WHEELS, IMAGE):
            with domains(kind) as domain:
                measured(kind, domain(), topic, times)


if __name__ == "__main__":
    main()
