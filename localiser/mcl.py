"""Monte Carlo localisation: predict → weigh → estimate → resample.

A source yields events in the order of time; `step` takes one and returns what was located. Replay and live share it.
An image is weighed as soon as odometry up to its time is known, so it may wait for the next odometry event.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Annotated

import numpy as np
from pydantic import Field

from localiser import geometry, particles
from localiser.edges import Edges
from localiser.geometry import Array, Increment
from localiser.increments import Odometer
from localiser.inliers import InlierShare
from localiser.landmarks import LandmarkMap
from localiser.motion import MotionParameters, linearised, predict
from localiser.observation import Observation, ObservationParameters, independent_share
from localiser.particles import Estimate, Particles
from localiser.resampling import systematic_resample
from localiser.weighing import Weighing

# -- events: what a source yields, in the order of time ---------------------------------------------------------------


@dataclass(frozen=True, slots=True, eq=False)
class Start:
    """Where the robot is said to be: pose (3,) in the map and its covariance (3, 3)."""

    t_ns: int
    mean: Array
    cov: Array


@dataclass(frozen=True, slots=True, eq=False)
class Odometry:
    """A pose (3,) in the odometry's own frame; only increments between two of them count."""

    t_ns: int
    pose: Array


@dataclass(frozen=True, slots=True, eq=False)
class Sighting:
    """The edges of the image taken at this time."""

    t_ns: int
    edges: Edges


Event = Start | Odometry | Sighting


@dataclass(frozen=True, slots=True, eq=False)
class Located:
    """What the filter knows after one image.

    estimate: from the weighted particles, before resampling. particles: those it was computed from.
    ess: effective sample size. increment: motion since the last image. odometry: odometry's pose (3,) at the image.
    """

    t_ns: int
    estimate: Estimate
    particles: Particles
    ess: float
    edges: Edges
    increment: Increment
    odometry: Array


# -- the filter -------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class MclParameters:
    """The particle filter itself."""

    particles: Annotated[int, Field(ge=1, le=10_000_000, description="number of particles")] = 2000
    start_particles: Annotated[
        int, Field(ge=1, le=10_000_000, description="number of particles until the first image has been weighed")
    ] = 10_000
    stage_below: Annotated[
        float,
        Field(ge=0, lt=1, description="weigh in stages that each leave this share of effective samples; 0: never"),
    ] = 0.3
    resample_below: Annotated[
        float, Field(gt=0, le=1, description="resample when the effective sample size falls below this share")
    ] = 0.5


@dataclass(frozen=True, slots=True, eq=False)
class Mcl:
    """Everything that stays the same during a run."""

    landmark_map: LandmarkMap
    observation: Observation
    parameters: MclParameters = field(default_factory=MclParameters)
    motion: MotionParameters = field(default_factory=MotionParameters)
    correlation: ObservationParameters = field(default_factory=ObservationParameters)
    odometer: Odometer | None = None  # wheels alone


@dataclass(slots=True, eq=False)
class FilterState:
    """Everything that changes during a run; with the generator it is all that must be saved to go on later.

    particles: hypotheses of where the robot was at `at_ns`. weighed: whether they have been weighed by any image yet.
    inliers: what share of the edges belongs to landmarks hereabouts.
    seen: edges of the last image. odometry: poses since then, and the last one before.
    waiting: sightings that odometry has not reached yet.
    """

    particles: Particles | None = None
    at_ns: int = 0
    weighed: bool = False
    inliers: InlierShare = field(default_factory=InlierShare.unknown)
    seen: Edges | None = None
    odometry: deque[Odometry] = field(default_factory=deque)
    waiting: deque[Sighting] = field(default_factory=deque)


def step(mcl: Mcl, state: FilterState, event: Event, rng: np.random.Generator) -> Iterator[Located]:
    """Take one event and yield what was located: nothing, or one result for every image that odometry now covers."""
    match event:
        case Start():
            state.particles = particles.from_gaussian(event.mean, event.cov, mcl.parameters.start_particles, rng)
            state.at_ns, state.weighed, state.seen = event.t_ns, False, None
        case Odometry():
            state.odometry.append(event)
        case Sighting():
            state.waiting.append(event)
    while state.waiting and _wheels_reach(mcl, state, state.waiting[0].t_ns):
        yield locate(mcl, state, state.waiting.popleft(), rng)


def _wheels_reach(mcl: Mcl, state: FilterState, t_ns: int) -> bool:
    if mcl.odometer is not None and not mcl.odometer.needs_wheels:
        return True
    return bool(state.odometry) and state.odometry[-1].t_ns >= t_ns


def finish(mcl: Mcl, state: FilterState, rng: np.random.Generator) -> Iterator[Located]:
    """Yield the images that came after the last odometry; the robot is taken to have stood still since then."""
    while state.waiting:
        yield locate(mcl, state, state.waiting.popleft(), rng)


def locate(mcl: Mcl, state: FilterState, sighting: Sighting, rng: np.random.Generator) -> Located:
    """Predict, weigh, estimate, resample: Monte Carlo localisation [Thrun, Burgard, Fox 2005, table 8.2].

    Raises ValueError when no start has been given, or one that is later than the image.
    """
    if state.particles is None or sighting.t_ns < state.at_ns:
        raise ValueError("an image came before any start pose")

    # Predict: move every particle by what wheels and edges say, each with its own error.
    increment, odometry_pose = increment_until(state, sighting.t_ns)
    if mcl.odometer is not None:
        _, wheel_cov = linearised(np.zeros(3), increment, mcl.motion)
        seconds = (sighting.t_ns - state.at_ns) / 1e9
        increment = mcl.odometer.increment(increment, wheel_cov, state.seen, sighting.edges, seconds)
    moved = predict(state.particles, increment, mcl.motion, rng)

    # Weigh: how well do the measured edges fit what each particle should see? Only what is new counts.
    share = independent_share(increment, mcl.correlation) if state.weighed else 1.0
    inliers, blurred = state.inliers.after(share), not state.weighed
    weighed, state.inliers, _ = Weighing(mcl.observation, mcl.landmark_map, mcl.parameters.stage_below).weigh(
        moved, sighting.edges, inliers, share, blurred, rng
    )

    # Estimate before resampling, which only adds noise.
    ess = particles.effective_sample_size(weighed.weight)
    located = Located(
        sighting.t_ns, particles.estimate(weighed), weighed, ess, sighting.edges, increment, odometry_pose
    )

    # Resample when few particles carry most of the weight, or when there are more than the way will need.
    if ess < mcl.parameters.resample_below * len(weighed) or len(weighed) != mcl.parameters.particles:
        index = systematic_resample(weighed.weight, mcl.parameters.particles, rng)
        weighed = particles.take(weighed, index)
    state.particles, state.at_ns, state.weighed, state.seen = weighed, sighting.t_ns, True, sighting.edges
    return located


def increment_until(state: FilterState, t_ns: int) -> tuple[Increment, Array]:
    """Return the motion since the particles' time until `t_ns`, and the odometry's pose (3,) then; forget what is past.

    Poses are interpolated at both ends, so the increment is exact whatever the rates of the two sensors.
    """
    start_ns = state.at_ns
    if not state.odometry:
        return Increment.from_mean(np.zeros(3)), np.zeros(3)
    times = np.array([event.t_ns for event in state.odometry])
    track = geometry.Trajectory(times, np.array([event.pose for event in state.odometry]))
    inside = times[(times > start_ns) & (times < t_ns)]
    knots = track.sampled([start_ns, *inside, t_ns]).poses
    moves = geometry.between(knots[:-1], knots[1:])
    path_m, turned_rad = np.hypot(moves[:, 0], moves[:, 1]).sum(), np.abs(moves[:, 2]).sum()
    mean = geometry.between(knots[0], knots[-1])
    # Keep the last pose at or before this image: the next increment starts between it and its successor.
    while len(state.odometry) > 1 and state.odometry[1].t_ns <= t_ns:
        state.odometry.popleft()
    return Increment(mean, np.zeros((3, 3)), float(path_m), float(turned_rad), "wheel"), knots[-1]
