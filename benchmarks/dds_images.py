"""Images from Debian's Fast DDS to this program over the loopback interface: how many are lost, and how late they are.

    python benchmarks/dds_images.py --images 200 --runs 3     # needs Debian's fastddsgen, libfastrtps-dev and g++

640×480×3 bytes each, at 20 Hz, beside odometry. Latency is from the stamp, set before an image is handed to Fast DDS,
to its arrival in the inbox's thread. Where it is best effort, an image is lost with the first datagram that finds the
socket's buffer full.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
import time
from contextlib import closing
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parent.parent
sys.path[:0] = [str(ROOT / "tests" / "support")]

import fast_dds  # noqa: E402
from live_processes import free_domain  # noqa: E402

from localiser.config import LiveParameters  # noqa: E402
from localiser.live import open_transport  # noqa: E402
from localiser.ros import Topic  # noqa: E402
from localiser.storage.bags import RosType, stamp_of, typestore  # noqa: E402

RATE_HZ = 20.0
LEAST_BYTES = 1000  # of an image; empty ones go out until they are heard
REST_S = 2.0


def received(peer: Path, reliable: bool, count: int) -> tuple[int, np.ndarray]:
    """Return how many images were lost, and the latencies in ms (K,) of the others."""
    domain = free_domain()
    arrived: list[tuple[int, bytes]] = []
    wheels: list[int] = []
    command = [peer, str(domain), "send", "reliable" if reliable else "best", str(count), str(RATE_HZ)]
    with closing(open_transport(LiveParameters(dds=domain))) as transport:
        image = Topic("/camera/image_raw", RosType.IMAGE, reliable=reliable, depth=5)
        transport.subscribe(image, lambda content, source: arrived.append((time.time_ns(), content)))
        odometry = Topic("/odom", RosType.ODOMETRY, reliable=reliable, depth=5)
        transport.subscribe(odometry, lambda content, source: wheels.append(time.time_ns()))
        with subprocess.Popen(command, stdin=subprocess.PIPE, text=True) as process:
            assert process.stdin is not None
            while not (arrived and wheels):
                time.sleep(0.01)
            process.stdin.write("heard\n")
            process.stdin.flush()
            time.sleep(count / RATE_HZ + REST_S)
            process.stdin.close()
    images = [(at_ns, content) for at_ns, content in arrived if len(content) > LEAST_BYTES]
    store = typestore(ros1=False)
    latency_ms = [(at_ns - stamp_of(store.deserialize_cdr(content, RosType.IMAGE))) / 1e6 for at_ns, content in images]
    return count - len(images), np.array(latency_ms)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--images", type=int, default=200)
    parser.add_argument("--runs", type=int, default=3)
    arguments = parser.parse_args()
    if not fast_dds.can_be_built():
        parser.error(fast_dds.NEEDS)
    with tempfile.TemporaryDirectory() as folder:
        peer = fast_dds.built_in(Path(folder))
        for reliable in (True, False):
            for _ in range(arguments.runs):
                lost, latency_ms = received(peer, reliable, arguments.images)
                median, late, worst = np.percentile(latency_ms, [50, 99, 100]) if len(latency_ms) else [np.nan] * 3
                how, of = "reliable" if reliable else "best effort", arguments.images
                print(f"{how:12} lost {lost} of {of}  ms: median {median:.1f}, 99 % {late:.1f}, worst {worst:.1f}")


if __name__ == "__main__":
    main()
