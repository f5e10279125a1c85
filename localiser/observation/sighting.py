"""What was measured at one time, what an observation says of it, and what any observation must be able to do.

The filter needs `Observation.log_likelihood` alone. All else it does with `EdgeObservation`, whose parameters are here.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated, Any, Literal, Protocol

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from localiser.edges import Edges
from localiser.errors import InputError
from localiser.geometry import Array, Increment
from localiser.landmarks import LandmarkMap, SightParameters
from localiser.particles import Particles

LEANS_REPEAT = 2.0  # how much longer the errors of leans repeat than those of bearings
_IMPOSSIBLE = -1e300  # stands for a log-likelihood of -inf, of which no difference can be taken


@dataclass(frozen=True, slots=True, eq=False)
class Sighting:
    """What was measured at one time.

    edges: of an image. measurement: an array that an observation of another kind understands, None where there is none.
    persistent: (E,) how much denser clutter is at each edge than anywhere in the image, by the image before. scene:
    (E,) the same by the earlier images of the scene. clutter: (E,) probability that an edge is of nothing on the map,
    once the image has told where the robot is. None where nothing is known. map_scale: by how much landmarks are
    farther from where the map has them than it says.
    """

    t_ns: int
    edges: Edges = field(default_factory=Edges.none)
    measurement: NDArray[Any] | None = None
    persistent: Array | None = None
    scene: Array | None = None
    clutter: Array | None = None
    map_scale: float = 1.0


@dataclass(frozen=True, slots=True, eq=False)
class Targets:
    """Edges (K) with a certain landmark: its point (K, 2), measured angle (K,) (rad), variance (K,) (rad²).

    is_slope: whether angles are leans, not bearings.
    """

    points: Array
    angle: Array
    variance: Array
    is_slope: bool


@dataclass(frozen=True, slots=True, eq=False)
class Matches:
    """Which landmark each edge belongs to, seen from one pose.

    landmark: (E,) index into the map, -1 for clutter. residual: (E,) measured minus predicted, rad, nan for clutter.
    visible: (L,) whether the landmark is inside the field of view. sigma: (E,) of the residual, rad, the pose taken as
    exact. gate: (E,) from how many sigmas on the edge would have counted as clutter. Both are nan for clutter.
    """

    landmark: NDArray[np.int64]
    residual: Array
    visible: NDArray[np.bool_]
    sigma: Array
    gate: Array

    @classmethod
    def none(cls, edges: int, landmarks: int) -> Matches:
        """Return that no edge belongs to any landmark."""
        unknown = np.full((3, edges), np.nan)
        return cls(np.full(edges, -1), unknown[0], np.zeros(landmarks, dtype=bool), unknown[1], unknown[2])


class Observation(Protocol):
    """Anything that weighs particles by what was measured."""

    def log_likelihood(self, particles: Particles, sighting: Sighting, landmark_map: LandmarkMap) -> Array:
        """Return log p(sighting | particle) (N,), up to a constant that all particles share."""


def own_log_likelihood(
    observation: Observation, particles: Particles, sighting: Sighting, landmark_map: LandmarkMap
) -> Array:
    """Return log p(sighting | particle) (N,) by an observation of one's own.

    Raises InputError when it returns anything else than log-likelihoods.
    """
    found = np.asarray(observation.log_likelihood(particles, sighting, landmark_map))
    name, count = f"{type(observation).__name__}.log_likelihood", len(particles)
    if found.shape != (count,) or found.dtype.kind not in "fiu":
        raise InputError(f"expected ({count},) numbers, found {found.dtype} {found.shape}", field=name)
    if not (found < np.inf).all() or not (found > -np.inf).any():
        problem = "-inf for all particles" if (found == -np.inf).all() else "nan or inf"
        raise InputError(f"expected log-likelihoods below inf, at least one finite, found {problem}", field=name)
    return np.maximum(found, _IMPOSSIBLE, dtype=np.float64)


# -- parameters -------------------------------------------------------------------------------------------------------


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
        int, Field(ge=1, le=64, description="threads; with 2, a replay finds edges ahead; results do not depend on it")
    ] = 1
    sight: SightParameters = field(default_factory=SightParameters)


def novelty_of(increment: Increment, parameters: ObservationParameters, longer: float = 1.0) -> float:
    """Return the share of a frame's log-likelihood that is new after moving by `increment`, 0 … 1.

    Errors of an edge are taken as a first-order Markov process. After x decorrelation lengths they agree by
    ρ = exp(-x), and such images tell as much about a constant as if each counted (1 - ρ) / (1 + ρ) = tanh(x / 2).
    longer: by how much errors repeat longer than that.
    """
    if parameters.decorrelation_m == 0 or parameters.decorrelation_deg == 0:
        return 1.0
    lengths = increment.path_m / parameters.decorrelation_m
    lengths += increment.turned_rad / np.radians(parameters.decorrelation_deg)
    longer *= LEANS_REPEAT if parameters.kind == "slope" else 1.0
    return float(np.tanh(lengths / longer / 2.0))
