"""The driven path, thinned so that its message stays small."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from localiser.geometry import Array, wrap_angle
from localiser.storage.bags import PATH, Messages, header

STEP_M, STEP_RAD = 0.1, np.deg2rad(10.0)
"""How far a robot moves or turns between two poses of the path."""

MOST_POSES = 1000
_NS = 10**9


@dataclass(slots=True, eq=False)
class DrivenPath:
    """Poses of one run. When there are too many, every other one is left out, so the whole path stays visible."""

    _stamps_ns: list[int] = field(default_factory=list)
    _poses: list[Array] = field(default_factory=list)

    def grows(self, stamp_ns: int, pose: Array) -> bool:
        """Take a pose (3,), and return whether it is far enough from the last one to be part of the path."""
        if self._poses:
            moved = pose - self._poses[-1]
            if np.hypot(*moved[:2]) < STEP_M and abs(wrap_angle(moved[2])) < STEP_RAD:
                return False
        if len(self._poses) >= MOST_POSES:
            del self._poses[1::2], self._stamps_ns[1::2]
        self._poses.append(np.asarray(pose))
        self._stamps_ns.append(stamp_ns)
        return True

    def message(self, make: Messages, stamp_ns: int, frame: str) -> Any:
        """Return a nav_msgs/Path."""
        types = make.store.types
        time, head, stamped = (
            types[name]
            for name in ("builtin_interfaces/msg/Time", "std_msgs/msg/Header", "geometry_msgs/msg/PoseStamped")
        )
        poses = [
            stamped(header=head(stamp=time(*divmod(at_ns, _NS)), frame_id=frame), pose=pose)
            for at_ns, pose in zip(self._stamps_ns, make.poses(np.array(self._poses)), strict=True)
        ]
        return make.make(PATH, header=header(stamp_ns, frame), poses=poses)
