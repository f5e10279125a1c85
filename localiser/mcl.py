"""Monte Carlo localisation: predict → weigh → estimate → resample.

A source yields events in the order of time; `step` takes one and returns what was located. Replay and live share it.
An image is weighed as soon as odometry up to its time is known, so it may wait for the next odometry event.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
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


MOST_STAGES = 12  # so that a frame takes a bounded time whatever it shows

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
    weighed, state.inliers = weigh(
        mcl, moved, sighting.edges, state.inliers.after(share), share, not state.weighed, rng
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


def weigh(
    mcl: Mcl, moved: Particles, edges: Edges, inliers: InlierShare, share: float, first: bool, rng: np.random.Generator
) -> tuple[Particles, InlierShare]:
    """Return the particles with `share` of the edges' log-likelihood in their weights, and what that tells of clutter.

    Edges much sharper than the cloud would leave all weight on the few particles that happen to lie nearest. So only
    as much of the evidence is taken at once as leaves `stage_below` of them effective; these are resampled and spread
    by a small kernel, and the rest is weighed on the new, denser cloud [Musso, Oudjane, Le Gland 2001]. At the start
    (`first`) perhaps no particle fits at all; then edges are blurred first and sharpened from stage to stage.
    """
    fewest = mcl.parameters.stage_below * len(moved)
    coarser_rad: float | None = None
    for blur_rad in blurs_of(mcl, moved, edges) if first else [0.0]:
        left = share
        for stage in range(MOST_STAGES):
            by_share = mcl.observation.by_share(moved, edges, mcl.landmark_map, blur_rad)
            log_likelihood = inliers.log_mean(by_share)
            if coarser_rad is not None:  # which the particles have been weighed by already
                known = mcl.observation.by_share(moved, edges, mcl.landmark_map, coarser_rad)
                log_likelihood = log_likelihood - inliers.log_mean(known)
            last = stage == MOST_STAGES - 1
            taken = left if last else particles.largest_step(moved.log_weight, log_likelihood, left, fewest)
            weighed = replace(moved, log_weight=moved.log_weight + taken * log_likelihood)
            left -= taken
            if left <= 0 and blur_rad == 0:
                break
            index = systematic_resample(weighed.weight, len(weighed), rng)
            moved = particles.spread(particles.take(weighed, index), rng)
            if left <= 0:
                break
        coarser_rad = blur_rad
    return weighed, inliers.given(by_share, weighed.weight, share)


def blurs_of(mcl: Mcl, moved: Particles, edges: Edges) -> list[float]:
    """Return the sigmas (rad) to blur edges by, from stage to stage, the last one 0.

    Only 0 where at least one particle is expected within an edge's sigma of the truth in every dimension. Else from
    twice the spread of the particles' predictions, halved until it is below the edges' sigma.
    """
    spread_rad, sigma_rad = mcl.observation.scales(moved, edges, mcl.landmark_map)
    if len(moved) * sigma_rad ** len(moved.names) >= spread_rad ** len(moved.names):
        return [0.0]
    return [*(b for b in 2.0 * spread_rad * 0.5 ** np.arange(MOST_STAGES) if b > sigma_rad), 0.0]


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
