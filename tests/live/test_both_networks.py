"""What a live run does the same over zenoh and over DDS: demo, domains that are apart, what is kept for late comers."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
from live_networks import KINDS, Network, domains
from live_processes import SETTINGS, START, free_domain, program, wait_until
from short_log import CORRIDOR, Localiser

from localiser.live import open_transport
from localiser.live.transport import Topic
from localiser.storage import open_log, read_track
from localiser.storage.bags import ODOM, Messages, RosType

WHEELS = Topic("/odom", RosType.ODOMETRY)
LIVE = ("live", "--map", CORRIDOR / "map.yaml", "--start", START, "--json", *SETTINGS)
ROBOT = ("simulate", CORRIDOR, "--serve", "--quiet")
MAKE = Messages()


@pytest.fixture(params=KINDS)
def domain(request: pytest.FixtureRequest) -> Iterator[Callable[[], Network]]:
    """Return what makes domains of ROS 2, each over the same router, or each of DDS."""
    with domains(request.param) as made:
        yield made


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_a_demo_is_identical_to_the_replay_of_its_recording(localiser: Localiser, tmp_path: Path, kind: str) -> None:
    pytest.importorskip("cyclonedds" if kind == "dds" else "zenoh")
    bag = tmp_path / "drive.db3"
    settings = ("--set", "mcl.particles=300", "--set", "mcl.start_particles=1000")
    network = ("--set", f"live.dds={free_domain()}") if kind == "dds" else ()
    with program("live", "demo", CORRIDOR, *network, "--json", "--record", bag, *settings) as live:
        lines = live.poses(15)
        assert live.end() == 0, live.all_said()
        live.all_said()
        lines += live.rest()
    track = read_track(localiser.replay(bag, tmp_path / "results", few=False) / "trajectory.csv")
    assert len(track.t_ns) == len(open_log(bag).frames) >= 15
    assert track.t_ns.tolist() == [line["t_ns"] for line in lines]
    poses = [[line["x"], line["z"], line["heading"]] for line in lines]
    np.testing.assert_allclose(track.poses, poses, rtol=0, atol=1e-9)


def test_messages_do_not_leave_their_domain(domain: Callable[[], Network]) -> None:
    mine, other = domain(), domain()
    heard: list[bytes] = []
    wanted, unwanted = (MAKE.encode(MAKE.odometry(t_ns, ODOM, np.zeros(3))) for t_ns in (1, 2))
    with closing(open_transport(mine.options)) as member, closing(open_transport(other.options)) as beside:
        member.subscribe(WHEELS, lambda content, source: heard.append(content))
        wait_until(lambda: member.is_heard(WHEELS))
        assert not beside.is_heard(WHEELS)
        beside.publish(WHEELS, unwanted)
        wait_until(lambda: member.publish(WHEELS, wanted) or heard)
    assert set(heard) == {wanted}
