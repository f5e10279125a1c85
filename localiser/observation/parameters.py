"""Parameters of the observation of edges, and the novelty of an image."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from localiser.geometry import Increment
from localiser.landmarks import SightParameters

LEANS_REPEAT = 2.0  # how much longer the errors of leans repeat than those of bearings


@dataclass(frozen=True, slots=True)
class ObservationParameters:
    """The mixture of landmarks and clutter."""

    kind: Annotated[
        Literal["line", "slope"],
        Field(description="what is compared: the line held through the nadir point, or the slope alone (the paper's)"),
    ] = "line"
    landmark_sigma_m: Annotated[
        float,
        Field(ge=0, description="how far a landmark may stand from where the map has it, where that is silent (m)"),
    ] = 0.006
    decorrelation_m: Annotated[
        float, Field(ge=0, description="driving after which errors of an edge are new (m); 0: always new")
    ] = 0.2
    decorrelation_deg: Annotated[
        float, Field(ge=0, description="turning after which errors of an edge are new (degrees); 0: always new")
    ] = 4.0
    association: Annotated[
        Literal["unknown", "known"],
        Field(description="whether to believe what edges of a log say of which landmark they belong to"),
    ] = "unknown"
    threads: Annotated[
        int,
        Field(ge=1, le=64, description="threads; with 2, a replay finds edges ahead; results do not depend on it"),
    ] = 1
    sight: SightParameters = field(default_factory=SightParameters)


def novelty_of(increment: Increment, parameters: ObservationParameters, longer: float = 1.0) -> float:
    """Return the share of a frame's log-likelihood that is new after moving by `increment`, 0 … 1.

    Errors of an edge are taken as a first-order Markov process over the path. After x decorrelation lengths they agree
    by ρ = exp(-x). A chain of such images tells as much about a constant as if each counted
    (1 - ρ) / (1 + ρ) = tanh(x / 2). So a robot that stands still learns nothing from seeing the same image again.
    longer: by how much errors repeat longer than that.
    """
    if parameters.decorrelation_m == 0 or parameters.decorrelation_deg == 0:
        return 1.0
    lengths = increment.path_m / parameters.decorrelation_m
    lengths += increment.turned_rad / np.radians(parameters.decorrelation_deg)
    longer *= LEANS_REPEAT if parameters.kind == "slope" else 1.0
    return float(np.tanh(lengths / longer / 2.0))
