"""The pose that `localiser pose set` sends, over a transport that keeps what it gets."""

from __future__ import annotations

import pytest
from live_transport import KeepingTransport

from localiser import live
from localiser.commands import pose
from localiser.config import LiveParameters
from localiser.storage.bags import floor_pose


@pytest.mark.parametrize("frame", ["map", "world"])
def test_a_pose_names_the_frame_of_the_map(frame: str, monkeypatch: pytest.MonkeyPatch) -> None:
    transport = KeepingTransport()
    monkeypatch.setattr(live, "open_transport", lambda *_, **__: transport)
    monkeypatch.setattr(pose, "PAUSE_S", 0.0)
    assert pose.send_pose("1,2,90", "0.1,3", LiveParameters(map_frame=frame, namespace="robot1")) == (
        "/robot1/initialpose"
    )
    message = transport.messages("/robot1/initialpose")[-1]
    assert message.header.frame_id == frame and floor_pose(message)[:2] == (1.0, 2.0)
