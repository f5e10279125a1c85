"""Parameters of finding edges. Each has a unit and a physical meaning."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from pydantic import AfterValidator, Field

from localiser.edges.detectors import DETECTORS, registered
from localiser.geometry import Array

DetectorName = Annotated[
    str, AfterValidator(registered), Field(json_schema_extra=lambda schema: schema.update(enum=list(DETECTORS)))
]


@dataclass(frozen=True, slots=True)
class EdgeParameters:
    """How vertical edges are found in an image."""

    detector: Annotated[DetectorName, Field(description="what looks for segments in the image")] = "columns"
    half_resolution: Annotated[
        bool, Field(description="look for edges in the image at half its resolution, in half to two thirds of the time")
    ] = False
    min_length_px: Annotated[float, Field(gt=2, le=1000, description="shortest edge that counts (px)")] = 30.0
    min_contrast: Annotated[
        float, Field(ge=0, le=2, description="faintest edge that counts, as a fraction of the brightness of its sides")
    ] = 0.08
    gate_sigma: Annotated[
        float, Field(gt=0, le=10, description="how far a vertical edge may miss the nadir point (sigmas)")
    ] = 3.0
    tilt_sigma_deg: Annotated[
        float, Field(ge=0, le=10, description="how certain the camera's stated tilt is (deg, 1 sigma)")
    ] = 0.5
    roll_sigma_deg: Annotated[
        float, Field(ge=0, le=10, description="how certain the camera's stated roll is (deg, 1 sigma)")
    ] = 0.3
    plumb_sigma_deg: Annotated[
        float, Field(ge=0, le=5, description="how far a building's vertical edges are from plumb (deg, 1 sigma)")
    ] = 0.3

    @property
    def mount_sigma_rad(self) -> Array:
        """How certain the stated tilt and roll (2,) are (rad, 1 sigma)."""
        return np.deg2rad([self.tilt_sigma_deg, self.roll_sigma_deg])
