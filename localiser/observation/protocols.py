"""Protocols of observations: one required method, and optional abilities.

The required method is `Observation.log_likelihood`. Every optional ability is a protocol of its own. The filter asks
for it with `isinstance` and runs without it where it is missing: without inlier rates, particles are weighed by
`log_likelihood` alone; without targets, they are moved by odometry alone; and so on.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from localiser.camera import Camera
from localiser.edges import Edges
from localiser.errors import InputError
from localiser.geometry import Array, Increment
from localiser.landmarks import LandmarkMap
from localiser.observation.inlier_rate import INLIER_RATES
from localiser.observation.parameters import ObservationParameters
from localiser.particles import Particles

_IMPOSSIBLE = -1e300  # stands for a log-likelihood of -inf, of which no difference can be taken


@dataclass(frozen=True, slots=True, eq=False)
class Sighting:
    """What was measured at one time.

    edges: of an image. measurement: an array that an observation of another kind understands, None where there is none.
    clutter: (E,) how dense clutter is at each edge by the earlier images of the scene; None where nothing is known.
    map_scale: by how much landmarks are farther from where the map has them than it says.
    """

    t_ns: int
    edges: Edges = field(default_factory=Edges.none)
    measurement: NDArray[Any] | None = None
    clutter: Array | None = None
    map_scale: float = 1.0


@dataclass(frozen=True, slots=True, eq=False)
class EarlierImage:
    """An earlier image, how the robot has moved since, and the variance of its turn (rad²)."""

    sighting: Sighting
    since: Increment
    turn_var: float


@dataclass(frozen=True, slots=True, eq=False)
class Targets:
    """Edges (K) with a certain landmark.

    points: (K, 2) of the landmarks. angle: (K,) measured, rad. variance: (K,) rad². is_slope: whether angles are leans,
    not bearings.
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
    exact. gate: (E,) from how many sigmas on the edge would have counted as clutter. Both are nan for clutter, and None
    where the observation does not tell.
    """

    landmark: NDArray[np.int64]
    residual: Array
    visible: NDArray[np.bool_]
    sigma: Array | None = None
    gate: Array | None = None

    @classmethod
    def none(cls, edges: int, landmarks: int) -> Matches:
        """Return that no edge belongs to any landmark."""
        unknown = np.full((3, edges), np.nan)
        return cls(np.full(edges, -1), unknown[0], np.zeros(landmarks, dtype=bool), unknown[1], unknown[2])


@runtime_checkable
class Observation(Protocol):
    """Anything that weighs particles by what was measured."""

    def log_likelihood(self, particles: Particles, sighting: Sighting, landmark_map: LandmarkMap) -> Array:
        """Return log p(sighting | particle) (N,), up to a constant that all particles share."""
        ...


@runtime_checkable
class RatesInliers(Observation, Protocol):
    """An observation whose likelihood depends on the inlier rate, so that the filter can learn it."""

    def by_rate(
        self, particles: Particles, sighting: Sighting, landmark_map: LandmarkMap, blur_rad: float = 0.0
    ) -> Array:
        """Return log p(sighting | particle, w_k) (K, N) for each of `INLIER_RATES`, relative to clutter alone.

        blur_rad: sigma that is added to the sigma of every edge.
        """
        ...


@runtime_checkable
class TempersByScale(RatesInliers, Protocol):
    """An observation that can be blurred where it is much sharper than the cloud of particles is wide."""

    def scales(self, particles: Particles, sighting: Sighting, landmark_map: LandmarkMap) -> tuple[float, float]:
        """Return how far (rad) the particles' predictions of an edge spread, and the sigma (rad) of measuring it."""
        ...


@runtime_checkable
class GuidesSteps(Observation, Protocol):
    """An observation that the optimal proposal can draw steps from."""

    @property
    def camera(self) -> Camera:
        """The camera whose angles the targets are."""
        ...

    def targets(
        self, particles: Particles, sighting: Sighting, landmark_map: LandmarkMap, inlier_rate: float
    ) -> Targets:
        """Return the edges with a certain landmark; inlier_rate: expected fraction of edges of landmarks."""
        ...


@runtime_checkable
class FollowsClutter(Observation, Protocol):
    """An observation that knows persistent clutter: things on no map that are seen again in the next image."""

    def with_persistent_clutter(
        self, sighting: Sighting, before: Sighting, increment: Increment, turn_var: float
    ) -> Sighting:
        """Return the sighting with the clutter density at each edge, after the robot moved by `increment`."""
        ...


@runtime_checkable
class PredictsScenes(Observation, Protocol):
    """An observation that knows how well an image predicts a later one, wherever the robot is."""

    def scene_clutter(self, sighting: Sighting, earlier: Sequence[EarlierImage]) -> tuple[Array, Array]:
        """Return how dense clutter is at each edge (E,), and how much likelier it is if it continues an earlier one.

        earlier: images of the same scene, the one that is believed most first; the others tell of edges that it missed.
        The density is relative to E edges that are spread evenly.
        """
        ...


@runtime_checkable
class Associates(Observation, Protocol):
    """An observation that can say which landmark each edge shows."""

    def associate(self, pose: Array, sighting: Sighting, landmark_map: LandmarkMap) -> Matches:
        """Return the most likely landmark of every edge, seen from one robot pose (3,)."""
        ...


@runtime_checkable
class ScalesMaps(Observation, Protocol):
    """An observation that tells how far landmarks are from where the map has them."""

    def by_map_scale(self, pose: Array, sighting: Sighting, landmark_map: LandmarkMap, scales: Array) -> Array:
        """Return log p(sighting | scale) (K,) where the robot is; scales: (K,) of the map's sigmas."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class EndOffsets:
    """Where matched edges end, beside where their landmarks do: P ends inside the image.

    offset: (P,) measured minus expected upright image height. per_height: (P,) derivative of the expected one by the
    camera's height above the floor, 1/m.
    """

    offset: Array
    per_height: Array

    def __len__(self) -> int:
        return len(self.offset)


@runtime_checkable
class ComparesEnds(Observation, Protocol):
    """An observation that tells the camera's height: it compares where edges end with where landmarks do."""

    def end_offsets(self, pose: Array, sighting: Sighting, landmark_map: LandmarkMap) -> EndOffsets:
        """Return this of the edges that belong to landmarks, seen from one robot pose (3,)."""
        ...


@runtime_checkable
class LocalisesGlobally(RatesInliers, Protocol):
    """An observation of edges that poses can be proposed from with no idea where the robot is."""

    @property
    def camera(self) -> Camera:
        """The camera that saw the edges."""
        ...

    def by_detection_rate(
        self,
        particles: Particles,
        sighting: Sighting,
        landmark_map: LandmarkMap,
        blur_rad: float = 0.0,
        visibility: Array | None = None,
    ) -> Array:
        """Return log p(sighting | particle, p_k) (K, N) for each of `DETECTION_RATES`, relative to clutter alone.

        visibility: (V, L) probability that a landmark in view is not hidden, in each of one or two views of it, for
        which (V, K, N) is returned; None: none is hidden.
        """
        ...

    @property
    def parameters(self) -> ObservationParameters:
        """What the observation is of, and which landmarks count as visible."""
        ...


def likelihood_by_rate(
    observation: Observation, particles: Particles, sighting: Sighting, landmark_map: LandmarkMap, blur_rad: float = 0.0
) -> Array:
    """Return log p(sighting | particle, p_k) (K, N): the same for all rates where the observation knows none.

    Raises InputError when an observation of one's own returns anything else than log-likelihoods.
    """
    if isinstance(observation, RatesInliers):
        return observation.by_rate(particles, sighting, landmark_map, blur_rad)
    found = np.asarray(observation.log_likelihood(particles, sighting, landmark_map))
    name, count = f"{type(observation).__name__}.log_likelihood", len(particles)
    if found.shape != (count,) or found.dtype.kind not in "fiu":
        raise InputError(f"expected ({count},) numbers, found {found.dtype} {found.shape}", field=name)
    if not (found < np.inf).all() or not (found > -np.inf).any():
        problem = "-inf for all particles" if (found == -np.inf).all() else "nan or inf"
        raise InputError(
            f"expected log-likelihoods below inf, at least one of them finite, found {problem}", field=name
        )
    return np.tile(np.maximum(found, _IMPOSSIBLE, dtype=np.float64), (len(INLIER_RATES), 1))


def matches_of(observation: Observation, pose: Array, sighting: Sighting, landmark_map: LandmarkMap) -> Matches:
    """Return which landmark each edge shows, seen from `pose` (3,); none where the observation cannot say."""
    if isinstance(observation, Associates):
        return observation.associate(pose, sighting, landmark_map)
    return Matches.none(len(sighting.edges), len(landmark_map))
