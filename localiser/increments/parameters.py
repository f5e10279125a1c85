"""What can be set about increments: what a robot may do between two images, and whom to believe."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from localiser.geometry import Array

Source = Literal["wheel", "vision", "both"]


@dataclass(frozen=True, slots=True)
class IncrementParameters:
    """Where increments come from, and how a robot may move."""

    source: Annotated[
        Source, Field(description="what says how the robot moved: its wheels, its camera alone, or both")
    ] = "wheel"
    speed_m_s: Annotated[
        float,
        Field(gt=0, le=20, description="speed of the robot in any direction, as far as vision knows (m/s, 1 sigma)"),
    ] = 0.5
    turn_deg_s: Annotated[
        float, Field(gt=0, le=720, description="turn rate of the robot, as far as vision knows (degrees/s, 1 sigma)")
    ] = 45.0
    slip_share: Annotated[
        float, Field(gt=0, lt=0.5, description="share of increments in which wheels slip beyond their stated noise")
    ] = 1e-3

    def motion_cov(self, seconds: float) -> Array:
        """Return the covariance (3, 3) of a motion (right m, backward m, turn rad) of which only its time is known."""
        sigma = np.array([self.speed_m_s, self.speed_m_s, np.deg2rad(self.turn_deg_s)]) * seconds
        return np.diag(sigma**2)
