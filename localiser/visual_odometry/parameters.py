"""Parameters of visual odometry: how a robot may move between two images, and what measures it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BeforeValidator, Field

from localiser.visual_odometry.twist import Gaussian

LONGEST_S = 600.0


def _not_both(source: Any) -> Any:
    if source == "both":
        raise ValueError("`both` is gone: edges check the wheels anyway; expected 'wheel' or 'vision'")
    return source


Source = Annotated[Literal["wheel", "vision"], BeforeValidator(_not_both)]


@dataclass(frozen=True, slots=True)
class VisualOdometryParameters:
    """Where increments come from, and how a robot may move."""

    source: Annotated[Source, Field(description="what says how the robot moved: its wheels, or its camera alone")] = (
        "wheel"
    )
    speed_m_s: Annotated[
        float,
        Field(gt=0, le=20, description="speed of the robot in any direction, as far as vision knows (m/s, 1 sigma)"),
    ] = 0.5
    turn_deg_s: Annotated[
        float, Field(gt=0, le=720, description="turn rate of the robot, as far as vision knows (degrees/s, 1 sigma)")
    ] = 45.0
    pace_s: Annotated[
        float, Field(gt=0, description="how long the robot goes on at its pace, as far as vision knows (s)")
    ] = 2.0
    sideways_m_s: Annotated[
        float, Field(gt=0, le=20, description="speed sideways of a robot that steers (m/s, 1 sigma)")
    ] = 0.02
    sidle_share: Annotated[
        float, Field(gt=0, lt=1, description="share of increments in which it moves sideways as fast as any way")
    ] = 0.05
    slip_share: Annotated[
        float, Field(gt=0, lt=0.5, description="share of images at which wheels begin to slip beyond their noise")
    ] = 1e-3

    def twist(self, pace: Gaussian | None, seconds: float) -> Gaussian:
        """Return what is known of the twist over `seconds` from the pace until then, a twist per second.

        It keeps that pace for a while and strays from it (an Ornstein-Uhlenbeck process). After `LONGEST_S` a robot can
        be anywhere in a building; no more time makes it less certain.
        """
        seconds = min(seconds, LONGEST_S)
        sigma = np.array([self.speed_m_s, self.speed_m_s, np.deg2rad(self.turn_deg_s)])
        if pace is None:
            return Gaussian(np.zeros(3), np.diag(sigma**2) * seconds**2)
        kept = np.exp(-seconds / self.pace_s)
        cov = kept**2 * pace.cov + (1.0 - kept**2) * np.diag(sigma**2)
        return Gaussian(kept * pace.mean * seconds, cov * seconds**2)
