"""How far the pose can be trusted, as a diagnostic_msgs/DiagnosticArray."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from localiser.filter import SURE, LocatedFrame
from localiser.storage.bags import DIAGNOSTICS, Messages, header

NAME = "localiser: pose"
OK, WARN, ERROR = 0, 1, 2
LEAST_SURE = 0.5
"""Below this a pose is more likely wrong than right, and the transform, by which robots drive, is held back."""


def diagnostics(make: Messages, frame: LocatedFrame, stamp_ns: int, facts: Mapping[str, str]) -> Any:
    """Return the probability that the pose is correct, why it may not be, and the figures of the image.

    facts: more of them. Level: ERROR where the pose is more likely wrong than right, WARN where it is not sure.
    """
    located, landmark = frame.located, frame.matches.landmark
    sigma_m = float(np.sqrt(np.trace(located.estimate.pose_cov[:2, :2])))
    sigma_deg = float(np.degrees(np.sqrt(located.estimate.pose_cov[2, 2])))
    values = {
        "p_correct": f"{located.p_correct:.4f}",
        "reason": located.reason,
        "warning": located.warning,
        "sigma_m": f"{sigma_m:.4f}",
        "sigma_deg": f"{sigma_deg:.3f}",
        "edges": str(len(landmark)),
        "edges_matched": str(int((landmark >= 0).sum())),
        "wheels_are_wrong": str(located.wheels_are_wrong).lower(),
        "height_off_m": f"{located.height.mean_m:.3f}",
        "height_off_sigma_m": f"{located.height.sigma_m:.3f}",
        **facts,
    }
    level = OK if located.p_correct > SURE else WARN if located.p_correct >= LEAST_SURE else ERROR
    text = located.warning or located.reason or "sure of the pose"
    status = make.make(
        "diagnostic_msgs/msg/DiagnosticStatus",
        level=level,
        name=NAME,
        message=text,
        values=[make.make("diagnostic_msgs/msg/KeyValue", key=key, value=value) for key, value in values.items()],
    )
    return make.make(DIAGNOSTICS, header=header(stamp_ns, ""), status=[status])
