"""The pose that `localiser pose set` sends, over a transport that keeps what it gets."""

from __future__ import annotations

import pytest
from live_transport import KeepingTransport

from localiser.live import NetworkOptions, send_pose
from localiser.storage.bags import floor_pose


@pytest.mark.parametrize("frame", ["map", "world"])
def test_a_pose_names_the_frame_of_the_map(frame: str, monkeypatch: pytest.MonkeyPatch) -> None:
    transport = KeepingTransport()
    monkeypatch.setitem(send_pose.__globals__, "open_transport", lambda *_, **__: transport)
    monkeypatch.setitem(send_pose.__globals__, "_PAUSE_S", 0.0)
    send_pose("1,2,90", "0.1,3", NetworkOptions(), "/initialpose", frame)
    message = transport.messages("/initialpose")[-1]
    assert message.header.frame_id == frame and floor_pose(message)[:2] == (1.0, 2.0)
