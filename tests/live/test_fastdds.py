"""Over DDS with Debian's Fast DDS, a counterpart that nobody here wrote: poses to it, images and odometry from it."""

import subprocess
from contextlib import closing
from pathlib import Path

import fast_dds
import numpy as np
import pytest
from live_processes import free_domain, wait_until

from localiser.config import LiveParameters
from localiser.live import open_transport
from localiser.ros import Topic
from localiser.storage.bags import Messages, RosType, floor_pose, typestore
from localiser.storage.bags.messages import stated_size

IMAGES, RATE_HZ = 60, 20.0
PATIENCE_S = 120.0

pytestmark = [
    pytest.mark.slow,
    pytest.mark.debian,
    pytest.mark.skipif(not fast_dds.can_be_built(), reason=fast_dds.NEEDS),
]


@pytest.fixture(scope="module")
def peer(tmp_path_factory: pytest.TempPathFactory) -> Path:
    pytest.importorskip("cyclonedds")
    return fast_dds.built_in(tmp_path_factory.mktemp("fastdds"))


def test_a_pose_is_heard_by_fast_dds(peer: Path) -> None:
    make, topic, domain = Messages(), Topic("/localiser/pose", RosType.POSE), free_domain()
    content = make.encode(make.pose_in_map(7_000_000_009, np.array([1.0, 2.0, 0.0]), np.diag([0.04, 0.05, 0.06])))
    with (
        closing(open_transport(LiveParameters(dds=domain))) as transport,
        subprocess.Popen([peer, str(domain), "hear"], stdout=subprocess.PIPE, text=True) as process,
    ):
        wait_until(lambda: transport.is_heard(topic))
        transport.publish(topic, content)
        out, _ = process.communicate(timeout=PATIENCE_S)
    half = np.sqrt(0.5)  # of a heading of 0: a yaw of 90°
    frame, *numbers = out.split()
    assert frame == "map"
    np.testing.assert_allclose([float(number) for number in numbers], [7, 9, 1.0, -2.0, half, half, 0.04], atol=1e-12)


@pytest.mark.parametrize("reliable", [True, False])
def test_images_and_odometry_of_fast_dds_are_heard(peer: Path, reliable: bool) -> None:
    """640×480×3 at 20 Hz: none lost where it is reliable, else those alone that the system's socket buffers dropped."""
    domain = free_domain()
    images: list[bytes] = []
    wheels: list[bytes] = []
    command = [peer, str(domain), "send", "reliable" if reliable else "best", str(IMAGES), str(RATE_HZ)]
    with closing(open_transport(LiveParameters(dds=domain))) as transport:
        image = Topic("/camera/image_raw", RosType.IMAGE, reliable=reliable, depth=5)
        transport.subscribe(image, lambda content, source: images.append(content))
        transport.subscribe(
            Topic("/odom", RosType.ODOMETRY, reliable=reliable), lambda content, source: wheels.append(content)
        )
        with subprocess.Popen(command, stdin=subprocess.PIPE, text=True) as process:
            wait_until(lambda: images and wheels)
            process.stdin.write("heard\n")
            process.stdin.flush()
            wait_until(lambda: len(sent(images)) + (0 if reliable else dropped()) >= IMAGES)
            process.communicate(timeout=PATIENCE_S)
        assert process.returncode == 0
    store = typestore(ros1=False)
    heard = [store.deserialize_cdr(content, RosType.IMAGE) for content in sent(images)]
    assert [one.data[0] for one in heard] == sorted({one.data[0] for one in heard}), "in their order, none twice"
    assert all(stated_size(one) == (640, 480) and (one.data == one.data[0]).all() for one in heard)
    assert all(one.header.frame_id == "camera_optical_frame" for one in heard)
    if reliable:
        assert floor_pose(store.deserialize_cdr(wheels[-1], RosType.ODOMETRY))[0] == pytest.approx(0.01 * (IMAGES - 1))


def sent(images: list[bytes]) -> list[bytes]:
    """Return those after the empty ones that go out until they are heard."""
    return [content for content in images if len(content) > 1000]


def dropped() -> int:
    """Return how many datagrams this process lost for want of space in the buffers of its sockets."""
    links = [one.readlink().name for one in Path("/proc/self/fd").iterdir() if one.is_symlink()]
    inodes = {name.removeprefix("socket:[").removesuffix("]") for name in links if name.startswith("socket:")}
    rows = [line.split() for line in Path("/proc/net/udp").read_text().splitlines()[1:]]
    return sum(int(row[-1]) for row in rows if row[9] in inodes)
