"""Monte Carlo localisation: predict → weigh → estimate → resample.

A source yields events in the order of time; `step` takes one and returns what was located. Replay and live share it.
An image is weighed as soon as odometry up to its time is known, so it may wait for the next odometry event.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import reduce
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from localiser import geometry, particles
from localiser.edges import Edges
from localiser.filter import confidence
from localiser.filter.alternative_hypothesis import Rival
from localiser.filter.attitude import Attitude, Level
from localiser.filter.optimal_proposal import Guide
from localiser.filter.tempering import Weighing
from localiser.geometry import Array, Increment
from localiser.landmarks import LandmarkMap
from localiser.motion import MotionParameters, at_start, predict, wheel_cov, with_biases
from localiser.observation import InlierShare, Observation, ObservationParameters, independent_share
from localiser.particles import Clusters, Estimate, Particles, systematic_resample
from localiser.relocalisation import SEEN_FIRST, Doubt, Search, only, resampled
from localiser.visual_odometry import Gaussian, Odometer

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

MOVE_M, MOVE_RAD = 0.5, 0.3  # the longest way and turn that are taken as one step


@dataclass(frozen=True, slots=True, eq=False)
class Located:
    """What the filter knows after one image.

    estimate: from the weighted particles, before resampling; where several places are possible, from those at the
    likeliest one. particles: all of them. ess: effective sample size. increment: motion since the last image.
    odometry: odometry's pose (3,) at the image. p_correct: probability that the estimate is within 0.5 m and 10°.
    reason: why it is below 0.9, else "". clusters: the places where the robot may be, heaviest first. attitude: by how
    much tilt and roll differ from what is stated, None where edges do not tell. weighed_edges: the edges as they were
    weighed, corrected by the attitude and by what is known of clutter.
    """

    t_ns: int
    estimate: Estimate
    particles: Particles
    ess: float
    edges: Edges
    increment: Increment
    odometry: Array
    p_correct: float = 1.0
    reason: confidence.Reason = ""
    clusters: Clusters | None = None
    attitude: Attitude | None = None
    weighed_edges: Edges | None = None


STRAY_START = 0.01  # probability that a start that was stated is wrong
FEW = 512  # particles that tell how well all of them fit
ALONE = 0.98  # weight of a place from which on the others are forgotten

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
    search: Search | None = None  # a start must be given, and a robot that is lost stays so
    level: Level | None = None  # tilt and roll are what is stated


@dataclass(slots=True, eq=False)
class FilterState:
    """Everything that changes during a run; with the generator it is all that must be saved to go on later.

    particles: hypotheses of where the robot was at `at_ns`. weighed: whether they have been weighed by any image yet.
    inliers: what share of the edges belongs to landmarks hereabouts. doubt: whether the robot is elsewhere. searching:
    whether several places are possible. rival: where else the robot may be, beside the particles.
    attitude: how the camera hangs, None as it is stated.
    seen: edges of the last image. pace: twist per second then, as far as edges told.
    odometry: poses since then, and the last one before. waiting: sightings that odometry has not reached yet.
    """

    particles: Particles | None = None
    at_ns: int = 0
    weighed: bool = False
    inliers: InlierShare = field(default_factory=InlierShare.unknown)
    doubt: Doubt = field(default_factory=lambda: Doubt.of(STRAY_START))
    searching: bool = False
    rival: Rival | None = None
    attitude: Attitude | None = None
    seen: Edges | None = None
    pace: Gaussian | None = None
    odometry: deque[Odometry] = field(default_factory=deque)
    waiting: deque[Sighting] = field(default_factory=deque)


def step(mcl: Mcl, state: FilterState, event: Event, rng: np.random.Generator) -> Iterator[Located]:
    """Take one event and yield what was located: nothing, or one result for every image that odometry now covers."""
    match event:
        case Start():
            cloud = particles.from_gaussian(event.mean, event.cov, mcl.parameters.start_particles, rng)
            state.particles = at_start(cloud, mcl.motion.bias, rng)
            state.at_ns, state.weighed, state.seen = event.t_ns, False, None
            state.doubt, state.searching, state.rival = Doubt.of(STRAY_START), False, None
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
    """Predict, weigh, look elsewhere, estimate, resample: Monte Carlo localisation [Thrun, Burgard, Fox 2005, t. 8.2].

    Raises ValueError when no start has been given and there is no search, or when one is later than the image.
    """
    if state.particles is None and mcl.search is not None:
        state.at_ns = sighting.t_ns
    elif state.particles is None or sighting.t_ns < state.at_ns:
        raise ValueError("an image came before any start pose")
    edges = sighting.edges

    # Predict: move every particle by what wheels and edges say, each with its own error.
    moves, odometry_pose = moves_until(state, sighting.t_ns, mcl.motion.bias.delay_sigma_s)
    increment = wheels = reduce(Increment.then, moves)
    if mcl.odometer is not None and mcl.odometer.follows_edges:
        seconds, cov = (sighting.t_ns - state.at_ns) / 1e9, wheel_cov(wheels, mcl.motion)
        increment, state.pace = mcl.odometer.increment(wheels, cov, state.seen, edges, seconds, state.pace)

    # Weigh: how well do the measured edges fit what each particle should see? Only what is new counts.
    share = independent_share(increment, mcl.correlation) if state.weighed else 1.0
    if state.seen is not None and share < 1.0:  # else nothing lasts from image to image
        turn_var = float(wheel_cov(increment, mcl.motion)[2, 2])
        edges = mcl.observation.with_lasting(edges, state.seen, increment, turn_var)
    if mcl.level is not None:
        edges, state.attitude = mcl.level.levelled(state.attitude, edges, increment.path_m, share)
    if state.particles is None:
        weighed = _anywhere(mcl, state, edges, rng)
    else:
        weighed = _weighed(mcl, state, moves if increment is wheels else [increment], edges, share, rng)

    # Estimate before resampling, which only adds noise.
    located = _located(state, weighed, sighting, edges, increment, odometry_pose)

    state.particles = _resampled(mcl, state, located, rng)
    state.at_ns, state.weighed, state.seen = sighting.t_ns, True, sighting.edges
    return located


def _anywhere(mcl: Mcl, state: FilterState, edges: Edges, rng: np.random.Generator) -> Particles:
    """Return particles wherever the edges fit, of a robot that may be anywhere."""
    assert mcl.search is not None
    clues, most = mcl.search.clues(edges), mcl.search.most
    # Proposals are dense where the robot may be; blind draws must be so everywhere.
    count = most if clues.is_blind else min(most, SEEN_FIRST)
    like = with_biases(particles.from_gaussian(np.zeros(3), np.zeros((3, 3)), count, rng), mcl.motion.bias)
    state.doubt, state.searching = Doubt.of_anywhere(), True
    return mcl.search.fresh(like, clues, state.doubt.inliers, count, rng)[0]


def _weighed(
    mcl: Mcl, state: FilterState, moves: list[Increment], edges: Edges, share: float, rng: np.random.Generator
) -> Particles:
    """Return the particles, moved and weighed by `share` of the edges' evidence, or those of a rival that has won."""
    assert state.particles is not None
    search, cloud = mcl.search, state.particles
    if search is not None and state.searching:
        moved = _moved(mcl, cloud, moves, rng)
        weighed, state.doubt, _ = search.followed(moved, state.doubt, search.clues(edges), share, rng)
        return weighed
    few = _moved(mcl, only(cloud, slice(None, None, max(len(cloud) // FEW, 1))), moves, rng)
    weighed = _tracked(mcl, state, moves, few, edges, share, rng)
    if search is None:
        return weighed

    # Is the robot where the particles are? A few of them tell.
    clues, inliers = search.clues(edges), state.doubt.inliers
    by_share = clues.by_share(few)
    log_evidence = state.doubt.log_evidence(by_share, few.log_weight)
    log_odds = state.doubt.log_odds - log_evidence
    state.doubt = state.doubt.after(by_share, few.log_weight, share, search.parameters.carried)
    if state.rival is not None:
        others = _moved(mcl, state.rival.particles, moves, rng)
        state.rival = state.rival.followed(search, others, clues, share, share * log_evidence, inliers, rng)
    elif search.looks_around(state.doubt, clues, share):
        state.rival = Rival.begun(search, weighed, state.doubt, log_odds, clues, rng)
    if state.rival is not None:
        state.rival = state.rival.elsewhere(particles.estimate(weighed).pose)
    if state.rival is not None and state.rival.has_won:
        weighed, state.doubt, state.searching, state.rival = state.rival.particles, state.rival.doubt, True, None
    return weighed


def _moved(mcl: Mcl, cloud: Particles, moves: list[Increment], rng: np.random.Generator) -> Particles:
    for move in moves:
        cloud = predict(cloud, move, mcl.motion, rng)
    return cloud


def _tracked(
    mcl: Mcl,
    state: FilterState,
    moves: list[Increment],
    few: Particles,
    edges: Edges,
    share: float,
    rng: np.random.Generator,
) -> Particles:
    """Return the particles moved and weighed by `share` of the edges' evidence. few: some of them, moved blindly."""
    assert state.particles is not None
    parameters, inliers = mcl.parameters, state.inliers.after(share)
    weighing = Weighing(mcl.observation, mcl.landmark_map, parameters.stage_below)
    if state.weighed and len(edges) and share > 0:
        targets = mcl.observation.targets(few, edges, mcl.landmark_map, inliers.mean)
        guide = Guide(mcl.observation.camera, targets, share, parameters.stage_below, parameters.resample_below)
        *earlier, last = moves
        moved = guide.moved(_moved(mcl, state.particles, earlier, rng), last, mcl.motion, rng)
        at_once = weighing.at_once(moved, edges, inliers, share)
        if at_once is not None:
            weighed, state.inliers = at_once
            return weighed
    # The first image, and one whose edges were taken for those of other landmarks.
    moved = _moved(mcl, state.particles, moves, rng)
    weighed, state.inliers = weighing.weigh(moved, edges, inliers, share, not state.weighed, rng)
    return weighed


def _located(
    state: FilterState,
    weighed: Particles,
    sighting: Sighting,
    edges: Edges,
    increment: Increment,
    odometry_pose: Array,
) -> Located:
    clusters = confidence.places_of(weighed)
    chosen = only(weighed, clusters.label == 0) if state.searching else weighed
    estimate = particles.estimate(chosen)
    if state.rival is not None:
        clusters = clusters.beside(confidence.places_of(state.rival.particles), state.rival.probability)
    sure = confidence.confidence_of(weighed, estimate.pose, _lost(state), len(sighting.edges), clusters)
    return Located(
        sighting.t_ns,
        estimate,
        weighed,
        particles.effective_sample_size(weighed.weight),
        sighting.edges,
        increment,
        odometry_pose,
        sure.p_correct,
        sure.reason,
        clusters,
        state.attitude,
        edges,
    )


def _lost(state: FilterState) -> float:
    """Return the probability that the truth is not among the particles."""
    return max(state.doubt.probability, 0.0 if state.rival is None else state.rival.probability)


def _resampled(mcl: Mcl, state: FilterState, located: Located, rng: np.random.Generator) -> Particles:
    """Return the particles that go on: as many as the way needs, from those that explain the edges."""
    weighed, parameters = located.particles, mcl.parameters
    most = max(parameters.particles, 0 if mcl.search is None else mcl.search.most)
    if state.rival is not None:
        state.rival = state.rival.resampled(parameters.particles, max(parameters.particles, SEEN_FIRST), rng)
    if state.searching:
        if confidence.near_weight(weighed, located.estimate.pose) < ALONE:
            return resampled(weighed, parameters.particles, most, rng)
        state.searching = False
    if located.ess < parameters.resample_below * len(weighed) or len(weighed) != parameters.particles:
        index = systematic_resample(weighed.weight, parameters.particles, rng)
        return particles.take(weighed, index)
    return weighed


def moves_until(state: FilterState, t_ns: int, delay_s: float = 0.0) -> tuple[list[Increment], Array]:
    """Return the motion since the particles' time until `t_ns`, and the odometry's pose (3,) then; forget what is past.

    Poses are interpolated at both ends, so the increments are exact whatever the rates of the two sensors. A long way
    is cut into moves short enough for the motion model, which is linear in what it does not know. delay_s: by how much
    the robot may well be later than its odometry.
    """
    start_ns = state.at_ns
    if not state.odometry:
        return [Increment.from_mean(np.zeros(3))], np.zeros(3)
    times = np.array([event.t_ns for event in state.odometry])
    track = geometry.Trajectory(times, np.array([event.pose for event in state.odometry]))
    inside = times[(times > start_ns) & (times < t_ns)]
    knots = track.sampled([start_ns, *inside, t_ns]).poses
    steps = geometry.between(knots[:-1], knots[1:])
    path_m, turned_rad = np.hypot(steps[:, 0], steps[:, 1]), np.abs(steps[:, 2])
    move = np.floor(np.cumsum(path_m / MOVE_M + turned_rad / MOVE_RAD)).astype(np.int64)
    first = np.flatnonzero(np.diff(move, prepend=-1))
    ends = np.append(first, len(steps))
    means = geometry.between(knots[ends[:-1]], knots[ends[1:]])
    by_delay = _by_delay(track, np.array([start_ns, *inside, t_ns])[ends], means, delay_s)
    paths, turns = np.add.reduceat(path_m, first), np.add.reduceat(turned_rad, first)
    moves = [
        Increment(mean, np.zeros((3, 3)), path, turned, "wheel", late)
        for mean, path, turned, late in zip(means, paths, turns, by_delay, strict=True)
    ]
    # Keep the last pose at or before where the next increment, or a later robot's, starts.
    while len(state.odometry) > 1 and state.odometry[1].t_ns <= t_ns - round(1e9 * delay_s):
        state.odometry.popleft()
    return moves, knots[-1]


def _by_delay(track: geometry.Trajectory, ends_ns: NDArray[np.int64], means: Array, delay_s: float) -> Array:
    """Return how motions (M, 3) between times (M + 1,) change per second by which the robot is later than its odometry.

    A secant over a delay that may well be, since velocities that are commanded jump.
    """
    if delay_s == 0:
        return np.zeros_like(means)
    late = track.sampled(ends_ns - round(1e9 * delay_s)).poses
    change = geometry.between(late[:-1], late[1:]) - means
    change[:, 2] = geometry.wrap_angle(change[:, 2])
    return np.asarray(change / delay_s)
