"""Monte Carlo localisation: predict, weigh, estimate, resample [Thrun, Burgard, Fox 2005, table 8.2].

A source yields events in the order of time. `step` takes one and returns what was located; replay and live share it.
An image is weighed as soon as odometry up to its time is known, so it may wait for the next odometry event.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from functools import reduce
from typing import Annotated

import numpy as np
from pydantic import Field

from localiser import particles
from localiser.errors import InputError
from localiser.filter.attitude import Attitude, Level
from localiser.filter.belief import RELEASED, Belief
from localiser.filter.events import SURE, Anywhere, Event, Located, Odometry, Start, is_near, is_silent, moves_between
from localiser.filter.height import COARSE_SIGMA_M, LEAST_NOVELTY, Height, is_measured, raised
from localiser.filter.map_error import SCALES, MapError
from localiser.filter.motion_hypotheses import MOST_FOLLOWED, Jump, Wheels
from localiser.filter.optimal_proposal import OptimalProposal
from localiser.filter.scene import Scene
from localiser.filter.tempering import Weighed, weighed_in_stages
from localiser.geometry import Array, Increment
from localiser.landmarks import LandmarkMap
from localiser.motion import MotionModel, MotionParameters, covariance_of
from localiser.observation import (
    Association,
    EarlierFrame,
    EdgeObservation,
    InlierRate,
    Matches,
    Observation,
    ObservationParameters,
    Sighting,
    novelty_of,
    persistent_clutter,
)
from localiser.particles import POSE, Particles, log_sum, systematic_resample, thinned
from localiser.relocalisation import GlobalLocalisation
from localiser.visual_odometry import Gaussian, Odometer, TwoImages, increment_of, with_scale

FEW_JUDGED = 512  # particles that tell how well an image fits the place that they are at, and how high the camera is
FEW_TOLD = 64  # particles that tell how well a motion predicts an image


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
    """Everything that stays the same during a run.

    observation: one that ships, or any other that has `Observation.log_likelihood`. motion: any `MotionModel`.
    correlation: how far the errors of consecutive images repeat. odometer: visual odometry, None for wheels alone.
    search: global localisation; without it a start must be given, and a robot that is lost stays so. level: estimates
    tilt and roll; without it they are as stated. edges, odometry_model: observation and motion if they ship, else None.
    """

    landmark_map: LandmarkMap
    observation: Observation
    parameters: MclParameters = field(default_factory=MclParameters)
    motion: MotionModel = field(default_factory=MotionParameters)
    correlation: ObservationParameters = field(default_factory=ObservationParameters)
    odometer: Odometer | None = None
    search: GlobalLocalisation | None = None
    level: Level | None = None
    edges: EdgeObservation | None = field(init=False)
    odometry_model: MotionParameters | None = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "edges", self.observation if isinstance(self.observation, EdgeObservation) else None)
        object.__setattr__(self, "odometry_model", self.motion if isinstance(self.motion, MotionParameters) else None)

    def by_edges(self) -> Mcl:
        """Return the same in which edges alone tell how the robot moved. Raises InputError without a camera."""
        if self.odometer is None:
            raise InputError("expected a camera, found none: edges alone tell no motion without one", field="camera")
        if self.odometer.parameters.source == "vision":
            return self
        parameters = replace(self.odometer.parameters, source="vision", sideways_m_s=np.inf)
        return replace(self, odometer=replace(self.odometer, parameters=parameters))

    def moved(self, cloud: Particles, moves: list[Increment], rng: np.random.Generator) -> Particles:
        """Return particles moved by odometry alone."""
        for move in moves:
            cloud = self.motion.predict(cloud, move, rng)
        return cloud


@dataclass(slots=True, eq=False)
class FilterState:
    """Everything that changes during a run; with the generator it is all that must be saved to go on later.

    particles: hypotheses of where the robot was at `at_ns`; None while it is not tracked. inliers: the learnt inlier
    rate. belief: whether the robot is elsewhere, and where. attitude: tilt and roll of the camera; None: as stated.
    height: of the camera. map_error: how far landmarks are from where the map has them. seen: the last image, None
    before the first since the start. scene: the images that the belief compares the next one with. wheels: whether they
    are right. pace: motion per second at the last image, where edges alone told it. odometry: poses since then, and the
    last one before. waiting: sightings that odometry has not reached yet.
    """

    particles: Particles | None = None
    at_ns: int = 0
    inliers: InlierRate = field(default_factory=InlierRate.unknown)
    belief: Belief = field(default_factory=Belief.anywhere)
    attitude: Attitude | None = None
    height: Height = field(default_factory=Height)
    map_error: MapError = field(default_factory=MapError)
    seen: Sighting | None = None
    pace: Gaussian | None = None
    odometry: deque[Odometry] = field(default_factory=deque)
    waiting: deque[Sighting] = field(default_factory=deque)
    scene: Scene = field(default_factory=Scene)
    wheels: Wheels = field(default_factory=Wheels)

    @property
    def is_begun(self) -> bool:
        """Whether there are particles, tracked or at candidate places: a start was stated or an image located."""
        return self.particles is not None or self.belief.candidates is not None

    def begin_at(self, t_ns: int) -> None:
        """Take the robot to be there at a time: forget the images before, and what is known of the wheels."""
        self.at_ns, self.seen, self.scene, self.wheels = t_ns, None, Scene(), Wheels()


def step(mcl: Mcl, state: FilterState, event: Event, rng: np.random.Generator) -> Iterator[Located]:
    """Take one event and yield what was located: nothing, or one result for every image that odometry now covers."""
    match event:
        case Start():
            cloud = particles.from_gaussian(event.mean, event.cov, mcl.parameters.start_particles, rng)
            if mcl.odometry_model is not None:
                cloud = mcl.odometry_model.at_start(cloud, rng)
            state.begin_at(event.t_ns)
            state.particles = cloud
            # An observation of one's own cannot tell whether the robot is elsewhere.
            state.belief = Belief(0.99, 0.0, 0.01, 0.0) if mcl.search is None else Belief.stated()
        case Anywhere():
            state.begin_at(event.t_ns)
            state.particles, state.belief = None, Belief.anywhere()
        case Odometry():
            state.odometry.append(event)
        case Sighting():
            state.waiting.append(event)
    by_vision = mcl.odometer is not None and mcl.odometer.parameters.source == "vision"
    while state.waiting and (by_vision or (state.odometry and state.odometry[-1].t_ns >= state.waiting[0].t_ns)):
        yield locate(mcl, state, state.waiting.popleft(), rng)


def finish(mcl: Mcl, state: FilterState, rng: np.random.Generator) -> Iterator[Located]:
    """Yield the images that came after the last odometry; the robot is taken to have stood still since then."""
    while state.waiting:
        yield locate(mcl, state, state.waiting.popleft(), rng)


def locate(mcl: Mcl, state: FilterState, sighting: Sighting, rng: np.random.Generator) -> Located:
    """Return where the robot is, from one image.

    Raises ValueError when no start has been given and there is no global localisation, or when one is later than the
    image.
    """
    silent = is_silent(state.odometry, state.at_ns, sighting.t_ns)
    # Bearings without ends do not tell how far the robot went.
    if silent and mcl.odometer is not None and np.isfinite(sighting.edges.ends_px).all():
        mcl = mcl.by_edges()
    measured = replace(sighting, map_scale=state.map_error.scale)
    # Drive: how did the robot move, by odometry?
    drive = _driven(mcl, state, _from_height(mcl, state, measured))
    state.height = _height_with_poses(mcl, state, measured, drive.moves, rng)
    sighting = _from_height(mcl, state, measured)
    image, found = _received(mcl, state, sighting, drive), None
    if state.particles is not None:
        # Predict: every particle moves by its own draw of the motion, if possible where the edges say.
        # Weigh: how well does the image fit what each particle should see? Only what is new of it counts.
        found = _weighed(mcl, state, state.particles, image, rng)
        # Do edges and map contradict the wheels? Then the robot may have moved as the edges say.
        motion = _contradicted(mcl, state, sighting, found.particles, image, rng)
        if motion is not None:
            drive = replace(drive, moves=[motion], increment=motion)
            image = _received(mcl, state, sighting, drive)
            found = _weighed(mcl, state, state.particles, image, rng)
        state.inliers = found.inliers
    state.scene, state.attitude = image.scene, image.attitude
    # Compare: is the robot at another place, or not on this map at all?
    weighed = _compared(mcl, state, found, image, rng)
    # Estimate: before resampling, which only adds noise. Which landmark does each edge show from there?
    located, association = _located(mcl, state, weighed, measured, image)
    if found is not None and not is_near(found.particles.estimate.pose[None], located.estimate.pose).all():
        located = replace(located, took_over=True)
    # Learn: which edges are clutter, which landmarks are seen, how far do edges, the camera's height and the map err?
    clutter = None
    if association is not None and weighed is not None:
        clutter = 1.0 - located.p_correct * (1.0 - association.clutter(state.inliers.mean))
    if weighed is not None and mcl.search is not None:
        pose, points = located.estimate.as_seen.pose, mcl.landmark_map.points
        landmarks = state.belief.landmarks.after(located.matches, points, pose, image.jump.novelty)
        state.belief = replace(state.belief, landmarks=landmarks)
    if state.particles is not None and weighed is not None:
        state.height = _height(mcl, state, located, association, image)
    state.map_error = _map_error(mcl, state, located, association, image.novelty)
    # Resample: where weights are uneven, or the number of particles is not the usual one.
    count, below = mcl.parameters.particles, mcl.parameters.resample_below
    if weighed is not None and (located.ess < below * len(weighed) or len(weighed) != count):
        weighed = particles.take(weighed, systematic_resample(weighed.weight, count, rng))
    state.particles = weighed
    seconds = (sighting.t_ns - state.at_ns) / 1e9
    state.wheels = state.wheels.located(None if weighed is None or located.took_over else located.estimate, seconds)
    state.at_ns, state.seen = sighting.t_ns, replace(sighting, clutter=clutter)
    return located


# -- the steps --------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, eq=False)
class _Drive:
    """The motion since the last image, in parts, all of it, odometry's pose (3,) now, and whether that jumped."""

    moves: list[Increment]
    increment: Increment
    odometry: Array
    jumped: bool


@dataclass(frozen=True, slots=True, eq=False)
class _Image:
    """What is known with an image before particles are weighed by it.

    drive: the motion since the last image. sighting: its edges corrected by the attitude, with the density of clutter.
    novelty: 0 … 1, of the errors of its edges. jump: how new what it shows is. scene, attitude: with this image.
    """

    drive: _Drive
    sighting: Sighting
    novelty: float
    jump: Jump
    scene: Scene
    attitude: Attitude | None


def _driven(mcl: Mcl, state: FilterState, sighting: Sighting) -> _Drive:
    """Return how the robot moved until an image, as odometry says, or vision where that was asked for."""
    if not state.is_begun and mcl.search is not None:
        state.at_ns = sighting.t_ns
    elif not state.is_begun or sighting.t_ns < state.at_ns:
        raise ValueError("an image came before any start pose")
    delay_s = 0.0 if mcl.odometry_model is None else mcl.odometry_model.bias.delay_sigma_s
    moves, odometry_pose, jumped = moves_between(state.odometry, state.at_ns, sighting.t_ns, delay_s)
    increment, seconds = reduce(Increment.then, moves), (sighting.t_ns - state.at_ns) / 1e9
    if mcl.odometer is not None and mcl.odometer.parameters.source == "vision" and seconds > 0:
        before = None if state.seen is None else state.seen.edges
        pace = state.wheels.pace if state.pace is None else state.pace
        moved, state.pace = mcl.odometer.motion(before, sighting.edges, seconds, pace)
        increment = increment_of(with_scale(moved, walks=True))
        moves = [increment]
    else:
        state.pace = None
    return _Drive(moves, increment, odometry_pose, jumped)


def _received(mcl: Mcl, state: FilterState, sighting: Sighting, drive: _Drive) -> _Image:
    """Return what the motion and earlier images tell of an image."""
    motion, seen, increment = mcl.motion, state.seen, drive.increment
    novelty = novelty_of(increment, mcl.correlation, state.map_error.decorrelation) if state.seen is not None else 1.0
    jump, scene, attitude = Jump(novelty), state.scene, state.attitude
    if mcl.level is not None:
        edges, attitude = mcl.level.levelled(attitude, sighting.edges, increment.path_m, novelty)
        sighting = replace(sighting, edges=edges)
    if mcl.edges is not None:
        scene, density, jump = scene.followed(mcl.edges, motion, sighting, increment)
        sighting = replace(sighting, scene=density)
        if seen is not None and len(seen.edges) and novelty < 1.0:
            now, turn_var = mcl.edges.frame(sighting.edges), float(covariance_of(motion, increment)[2, 2])
            last = mcl.edges.frame(state.scene.images[-1].sighting.edges)  # levelled, too
            before = EarlierFrame.of(last, now, increment, turn_var)
            sighting = replace(sighting, persistent=persistent_clutter(now, before, seen.clutter))
    return _Image(drive, sighting, novelty, jump, scene, attitude)


def _weighed(mcl: Mcl, state: FilterState, cloud: Particles, image: _Image, rng: np.random.Generator) -> Weighed:
    """Return particles that moved, by the optimal proposal where edges guide them, and are weighed."""
    inliers, novelty, parameters = state.inliers.after(image.novelty), image.novelty, mcl.parameters
    observation, motion, sighting = mcl.edges, mcl.odometry_model, image.sighting
    if motion is not None and observation is not None and state.seen is not None and novelty and len(sighting.edges):
        *earlier, last = image.drive.moves
        cloud = mcl.moved(cloud, earlier, rng)
        step = motion.expected_step(cloud, last)
        ahead, axes = Particles(POSE, step.poses, cloud.log_weight).estimate, step.axes.mean(axis=2)
        found = observation.associate(ahead.pose, sighting, mcl.landmark_map, ahead.cov + axes @ axes.T)
        camera, targets = found.frame.camera, found.targets(inliers.mean)
        proposal = OptimalProposal(camera, targets, novelty, parameters.stage_below, parameters.resample_below)
        moved = proposal.moved(cloud, step, last, motion, rng)
    else:
        moved = mcl.moved(cloud, image.drive.moves, rng)
    landmark_map, stage_below, is_first = mcl.landmark_map, parameters.stage_below, state.seen is None
    return weighed_in_stages(
        moved, mcl.observation, sighting, landmark_map, inliers, novelty, stage_below, rng, is_first=is_first
    )


def _contradicted(
    mcl: Mcl, state: FilterState, sighting: Sighting, weighed: Particles, image: _Image, rng: np.random.Generator
) -> Increment | None:
    """Return how the robot moved as the edges say, where they and the map contradict the wheels; None where not.

    weighed: the particles, where the wheels lead.
    """
    seconds, seen, increment = (sighting.t_ns - state.at_ns) / 1e9, state.seen, image.drive.increment
    odometer, observation, before = mcl.odometer, mcl.edges, state.particles
    if observation is None or odometer is None or odometer.parameters.source == "vision":
        return None
    # Later the robot may go on at any pace: nothing can be judged.
    if seen is None or before is None or not 0 < seconds <= odometer.parameters.pace_s:
        return None
    if not len(sighting.edges) or not len(seen.edges):
        # The particles follow the wheels. While these are doubted, that tells no pace.
        state.wheels = replace(state.wheels, fit=state.wheels.wrong == 0.0)
        return None
    level = replace(image.sighting, persistent=None)

    def fit_of(cloud: Particles) -> float:
        fit = state.inliers.log_mean(observation.by_rate(cloud, level, mcl.landmark_map))
        return float(log_sum(cloud.log_weight + fit) - log_sum(cloud.log_weight))

    longest = seen.edges.longest(MOST_FOLLOWED), sighting.edges.longest(MOST_FOLLOWED)
    state.wheels, motion = state.wheels.after(
        np.array([fit_of(thinned(weighed, FEW_TOLD)), image.jump.log_fit]),
        lambda: TwoImages.of(*longest, odometer.camera, state.scene.usual),
        lambda motion: fit_of(mcl.moved(thinned(before, FEW_TOLD), [motion], rng)),
        increment,
        covariance_of(mcl.motion, increment),
        odometer.parameters,
        seconds,
    )
    return motion


def _compared(
    mcl: Mcl, state: FilterState, found: Weighed | None, image: _Image, rng: np.random.Generator
) -> Particles | None:
    """Return the particles that are tracked from now on; None while there are candidates only."""
    weighed = None if found is None else found.particles
    if mcl.search is None:
        return weighed
    belief, drive, like = state.belief, image.drive, weighed
    if like is None and belief.candidates is not None:
        like = belief.candidates.particles
    elif like is None:  # constant errors that a robot may have of which nothing is known
        like = particles.from_gaussian(np.zeros(3), np.zeros((3, 3)), mcl.parameters.start_particles, rng)
        like = like if mcl.odometry_model is None else mcl.odometry_model.with_constant_errors(like)
    if belief.candidates is not None:
        moved = mcl.moved(belief.candidates.particles, drive.moves, rng)
        belief = replace(belief, candidates=replace(belief.candidates, particles=moved))
    before = None if found is None else thinned(found.before, FEW_JUDGED)
    belief = belief.after(mcl.search, before, like, image.sighting, image.jump, drive.increment, mcl.motion, rng)
    if weighed is not None:
        belief = belief.beside(weighed.estimate.pose)
    elif belief.candidates is None:
        belief = replace(belief, candidates=mcl.search.even(like, mcl.search.parameters.particles_most, rng))
    maps = len(mcl.landmark_map.maps)
    other = belief.found(maps, is_tracked=weighed is not None)
    if other is not None:
        weighed, belief = other
    elif weighed is not None and belief.here < RELEASED:
        belief, weighed = belief.released(weighed, maps), None
    state.belief = belief
    return weighed


def _located(
    mcl: Mcl, state: FilterState, weighed: Particles | None, measured: Sighting, image: _Image
) -> tuple[Located, Association | None]:
    """Return what is known of the robot, and how the edges compare with the landmarks that it sees."""
    belief, association = state.belief, None
    cloud, estimate, clusters = belief.places(weighed)
    p_correct = belief.p_correct(cloud, estimate.pose, is_tracked=weighed is not None)
    if mcl.edges is not None:
        seen = estimate.as_seen
        cov = None if weighed is None else seen.cov
        association = mcl.edges.associate(seen.pose, image.sighting, mcl.landmark_map, cov)
    located = Located(
        t_ns=measured.t_ns,
        estimate=estimate,
        particles=cloud,
        ess=particles.effective_sample_size(cloud.weight),
        edges=measured.edges,
        increment=image.drive.increment,
        odometry=image.drive.odometry,
        p_correct=p_correct,
        reason=belief.reason(p_correct, measured),
        warning=belief.warning,
        wheels_are_wrong=state.wheels.wrong > 0.5,
        odometry_jumped=image.drive.jumped,
        clusters=clusters,
        attitude=state.attitude,
        height=state.height,
        map_error=state.map_error,
        sighting=image.sighting,
        matches=Matches.none(0, len(mcl.landmark_map)) if association is None else association.matches(),
    )
    return located, association


def _from_height(mcl: Mcl, state: FilterState, sighting: Sighting) -> Sighting:
    """Return an image as seen from the height that is learnt."""
    if mcl.level is None or not len(sighting.edges):
        return sighting
    is_tracked = state.particles is not None
    return replace(sighting, edges=state.height.corrected(sighting.edges, mcl.level.camera, is_tracked=is_tracked))


def _height_with_poses(
    mcl: Mcl, state: FilterState, sighting: Sighting, moves: list[Increment], rng: np.random.Generator
) -> Height:
    """Return what is known of the camera's height after an image that tells it together with the pose.

    That is over the poses of some particles. Edges are blurred so that a few particles are dense enough.
    """
    observation, landmarks, edges = mcl.edges, mcl.landmark_map, sighting.edges
    is_asked = state.height.is_unknown and (state.seen is None or state.height.novelty >= LEAST_NOVELTY)
    if mcl.level is None or observation is None or state.particles is None or not is_asked:
        return state.height
    have_ends = np.isfinite(edges.ends_px).all() and np.isfinite([landmarks.bottom_m, landmarks.top_m]).any()
    if not have_ends or is_measured(mcl.level.camera, edges):
        return state.height
    camera, few = mcl.level.camera, mcl.moved(thinned(state.particles, FEW_JUDGED), moves, rng)
    spread_rad, sigma_rad = observation.scales(few, sighting, landmarks)
    blur_rad = max(spread_rad / len(few) ** (1 / len(POSE)) - sigma_rad, 0.0)

    def log_likelihood(offset_m: float) -> float:
        shifted = replace(raised(edges, camera, offset_m), height_sigma_m=COARSE_SIGMA_M)
        by_rate = observation.by_rate(few, replace(sighting, edges=shifted), landmarks, blur_rad)
        return float(log_sum(few.log_weight + state.inliers.after(1.0).log_mean(by_rate)))

    return state.height.with_poses(log_likelihood, state.height.novelty if state.seen is not None else 1.0)


def _height(mcl: Mcl, state: FilterState, located: Located, association: Association | None, image: _Image) -> Height:
    """Return what is known of the camera's height after an image, while a place is tracked."""
    if mcl.level is None or association is None or not len(located.edges):
        return state.height
    new = image.novelty if state.seen is not None else 0.0
    height = replace(state.height, novelty=min(state.height.novelty + new, 1.0))
    if height.novelty < LEAST_NOVELTY or height.is_unknown or is_measured(mcl.level.camera, located.edges):
        return height
    stated = mcl.level.camera.at(located.edges.mount)
    return height.after(*association.end_offsets(located.matches, located.estimate.as_seen.pose, stated), stated)


def _map_error(
    mcl: Mcl, state: FilterState, located: Located, association: Association | None, novelty: float
) -> MapError:
    """Return what is known of the landmarks' errors after an image, where the pose is sure."""
    is_sure = state.particles is not None and located.p_correct >= SURE
    if association is None or mcl.correlation.association == "known" or not len(located.edges) or not is_sure:
        return state.map_error
    found = replace(state.map_error, novelty=min(state.map_error.novelty + novelty, 1.0))
    return found if found.novelty < LEAST_NOVELTY else found.after(association.by_map_scale(SCALES))
