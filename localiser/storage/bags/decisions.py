"""Record which messages a live run used, so that a replay of the recording uses the same ones.

Each decision is a line of JSON on a topic of std_msgs/String, recorded after the message that it is about. Messages are
named by their number: how many of their topic were recorded before them.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from localiser.filter import Anywhere, Start
from localiser.storage.bags.frames import check_start

_LAST_NS = 2**62
_MOST = 10**8  # messages of a topic; larger numbers could be chosen to fall into one place of a set


def image_decision(number: int, t_ns: int, unused: str = "", *, by_wheels: bool = True) -> str:
    """Return that an image was weighed, or why not. t_ns: its time, by which people find it.

    by_wheels: whether the wheels told how the robot came there, or its edges had to, because the wheels were silent.
    """
    data: dict[str, Any] = {"image": number, "t_ns": t_ns, "used": not unused}
    data |= {"why": unused} if unused else {}
    return json.dumps(data | ({} if by_wheels else {"by_wheels": False}))


def odometry_decision(number: int, t_ns: int, why: str) -> str:
    """Return why a pose of the wheels was not used; all others were."""
    return json.dumps({"odometry": number, "t_ns": t_ns, "used": False, "why": why})


def clock_decision(offset_ns: int) -> str:
    """Return what is added to all stamps from here on, because the robot's clock has jumped."""
    return json.dumps({"clock": offset_ns})


def start_decision(start: Start) -> str:
    """Return that the filter was started, exactly as it was."""
    return json.dumps({"start": start.t_ns, "mean": start.mean.tolist(), "cov": start.cov.tolist()})


def anywhere_decision(t_ns: int | None = None) -> str:
    """Return that the robot was looked for on the whole map: at the beginning, or from a later time on."""
    return json.dumps({"start": None} if t_ns is None else {"anywhere": t_ns})


@dataclass(slots=True, eq=False)
class Decisions:
    """The decisions of a recording, taken in their order.

    images, unused_odometry: by number. blind: images that were weighed without wheels. starts: the first is None where
    the robot was looked for. offset_ns: what to add to the stamps that are read now. any: whether
    there is any decision at all.
    """

    images: set[int] = field(default_factory=set)
    blind: set[int] = field(default_factory=set)
    unused_odometry: set[int] = field(default_factory=set)
    starts: list[Start | Anywhere | None] = field(default_factory=list)
    offset_ns: int = 0
    any: bool = False

    def take(self, text: str) -> None:
        """Take one decision. Raises ValueError."""
        self.any = True
        try:
            data = json.loads(text)
        except RecursionError as error:
            raise ValueError("expected a decision") from error
        match data:
            case {"image": int(number), "used": bool(used)} if 0 <= number < _MOST:
                if used:
                    self.images.add(number)
                if data.get("by_wheels") is False:
                    self.blind.add(number)
            case {"odometry": int(number), "used": False} if 0 <= number < _MOST:
                self.unused_odometry.add(number)
            case {"clock": int(offset_ns)} if abs(offset_ns) < _LAST_NS:
                self.offset_ns = offset_ns
            case {"start": int(t_ns)} if 0 <= t_ns < _LAST_NS:
                self.starts.append(_start(t_ns, data))
            case {"anywhere": int(t_ns)} if 0 <= t_ns < _LAST_NS and self.starts:
                self.starts.append(Anywhere(t_ns))
            case {"start": None} if not self.starts:
                self.starts.append(None)
            case _:
                raise ValueError("expected a decision on an image, odometry, the clock or a start")


def _start(t_ns: int, data: Mapping[str, Any]) -> Start:
    mean, cov = (np.array(data.get(name), dtype=np.float64) for name in ("mean", "cov"))
    if mean.shape != (3,) or cov.shape != (3, 3) or not (np.isfinite(mean).all() and np.isfinite(cov).all()):
        raise ValueError("expected a start of a pose and its covariance")
    check_start(mean, cov)
    return Start(t_ns, mean, cov)
