"""Parameters of map building. Each has a unit and a physical meaning."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated

from pydantic import Field

from localiser.mapping.association import TrackParameters


@dataclass(frozen=True, slots=True)
class MappingParameters:
    """How landmarks are built from edges."""

    parallax_min_deg: Annotated[
        float, Field(gt=0, lt=180, description="a landmark must be seen from directions this far apart (degrees)")
    ] = 6.0
    sightings_min: Annotated[int, Field(ge=2, description="images that must show a landmark")] = 5
    existence_min: Annotated[
        float, Field(ge=0, le=1, description="probability of being there that a landmark needs to be on the map")
    ] = 0.9
    range_max_m: Annotated[float, Field(gt=0, description="landmarks are not built farther away than this (m)")] = 15.0
    systematic_px: Annotated[
        float, Field(ge=0, description="error of where an edge is measured that more images do not average out (px)")
    ] = 0.1
    plumb_sigma_m: Annotated[
        float, Field(ge=0, description="how far apart two sightings of one edge may stand, beside noise (m)")
    ] = 0.003
    place_sigma_m: Annotated[
        float, Field(ge=0, description="error of a landmark's place that more images do not average out (m)")
    ] = 0.006
    tracks: TrackParameters = field(default_factory=TrackParameters)
