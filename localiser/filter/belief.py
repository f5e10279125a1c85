"""The belief: which of five hypotheses holds. Their probabilities add up to one (docs/belief.md has the model).

If clutter were predicted exactly, a place on a wrong map would have an expected likelihood, relative to clutter, of 1
in every image, whatever the images before. By Ville's inequality, the odds of being on that map would then never exceed
k times their first value, except with a probability of at most 1 / k.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from localiser import particles
from localiser.filter.events import SURE, MapWarning, Reason, is_near
from localiser.filter.motion_hypotheses import Jump
from localiser.geometry import Array, Increment
from localiser.motion import MotionModel
from localiser.observation import FEWEST_EDGES, UNKNOWN_RATE, PlaceLandmarks, Sighting, marked_landmarks
from localiser.particles import Clusters, Estimate, Particles
from localiser.relocalisation import BLUR_RAD, MANY_PAIRS, PLACE_POWER, Candidates, GlobalLocalisation, History, beyond

LEFT = 1e-3  # between scenes: from mapped to unmapped surroundings, or from off the map onto it
RETURNED = 1e-2  # in unmapped surroundings: to mapped ones, or the place is lost
MISTAKEN = 1e-5  # between scenes: from tracked to off the map, because parts of another building may look the same
BARE = 0.1  # how much rarer scenes without any landmark are on the map than off it
MOST_CARRIED = 0.9  # an image may also be blurred, or a turn missed
PROPOSING_NOVELTY = 0.1  # scenes between images that poses are proposed from
MOST_EFFORT = 0.4  # of a scene's, for one image while a place is tracked, so that no frame takes long
SURELY_CARRIED = 0.5  # probability of having been carried from which on one image may do the work of a whole scene
FIRST_EFFORT = 2.0  # for the poses that the first image proposes; a robot that looks for its place may wait
OVERLOOKED = 0.3  # how often the poses that one image proposes miss the true one, at least
KNOWN = 0.005  # probability of having been overlooked below which a place that was found counts as one that was stated
NEGLIGIBLE = 1e-6  # probability of the candidates below which they are not followed
ALONE = 0.98  # weight of one place among the candidates from which on it is tracked
LIKELY = 0.1  # and its own probability
# Rooms repeat themselves: the most a place gains on one that explains what is seen, a metre with landmarks in view.
PATIENCE = 1.5
# It explains it where its log-likelihood along the last such metre is above this; where none is in view, above 0.
SUPPORT_M, MOST_SUPPORT, SUPPORTED = 1.0, 8.0, 2.0
SUSPECTED = 0.008  # P(carried) from which on that counts for nothing; `SURELY_CARRIED` where none is in view
WON = 50.0  # odds against the particles from which on a place is tracked in their stead
RELEASED = 1e-3  # probability below which the particles are no longer tracked, but candidates like others
BESIDE = 0.25  # candidates while a place is tracked, as a part of those while none is
# From which probability of being off the map on, and after how many scenes with enough edges, a map does not fit.
TRACKED_UNFIT, UNFIT = (0.7, 15.0), (0.97, 22.0)  # while a place is tracked, and while none is
MISSING = 0.3  # probability of the map by near landmarks, below which they are: `TRACKED_UNFIT` without scenes


@dataclass(frozen=True, slots=True, eq=False)
class Belief:
    """tracked, unmapped, elsewhere, unexplored, off_map: probabilities of sum 1; elsewhere is that of the candidates.

    candidates: None while there are none. detections: (K,) probability of each of `DETECTION_RATES` at the tracked
    place. unfit: progress towards the warning that the map does not fit, which is given at 1. unproposed: scenes since
    poses were last proposed, or since there was last no need to. shown: (K,) the same of landmarks that show there.
    support: log-likelihood of the tracked place, given these, along the last metre from which landmarks were in view.
    is_known: whether the tracked place was stated, or found so long ago that others cannot have been overlooked.
    overlooked: probability that no image has looked at the true place since a place was last known. history: what
    recent images say of places that are proposed next. landmarks: what images showed of those of the tracked place.
    """

    tracked: float
    elsewhere: float
    unexplored: float
    off_map: float
    candidates: Candidates | None = None
    detections: Array = field(default_factory=lambda: UNKNOWN_RATE)
    unfit: float = 0.0
    unproposed: float = 1.0
    unmapped: float = 0.0
    support: float = 0.0
    shown: Array = field(default_factory=lambda: UNKNOWN_RATE)
    is_known: bool = True
    overlooked: float = 1.0
    history: History = field(default_factory=History)
    landmarks: PlaceLandmarks = field(default_factory=PlaceLandmarks)

    @classmethod
    def stated(cls) -> Belief:
        """Return the belief at a start that was stated."""
        return cls(0.7, 0.0, 0.05, 0.25, history=History(entered=np.array([0.05])))

    @classmethod
    def anywhere(cls) -> Belief:
        """Return the belief of a robot of which nothing is known."""
        return cls(0.0, 0.0, 0.5, 0.5, is_known=False, history=History(entered=np.array([0.5])))

    @property
    def here(self) -> float:
        """The probability that the robot is among the particles, whether or not its surroundings are mapped."""
        return self.tracked + self.unmapped

    # -- an image -----------------------------------------------------------------------------------------------------

    def after(
        self,
        search: GlobalLocalisation,
        before: Particles | None,
        like: Particles,
        sighting: Sighting,
        jump: Jump,
        increment: Increment,
        motion: MotionModel,
        rng: np.random.Generator,
    ) -> Belief:
        """Return the belief after an image, until which the candidates have moved already.

        before: some particles at the tracked place, not weighed by it yet; None where none is tracked. like: particles
        whose constant errors hold elsewhere too, those tracked if any are. jump: how new the image is.
        """
        is_tracked, carried = before is not None, jump.carried(search.parameters.carried)
        edges = search.known_edges(sighting)
        novelty = max(jump.novelty, carried)
        maps = self.landmarks.maps if self.is_known else len(search.landmark_map.maps)
        landmarks = replace(self.landmarks, maps=maps)
        begun = replace(self, history=self.history.moved(increment, novelty), landmarks=landmarks)
        belief = begun._judged(search, before, sighting, edges >= FEWEST_EDGES, jump)
        off_map, scenes = TRACKED_UNFIT if is_tracked else UNFIT
        told = novelty / scenes if edges >= FEWEST_EDGES else 0.0  # a few edges may be anything, whatever the map
        belief = replace(belief, unfit=self.unfit + told if belief.off_map > off_map else 0.0)
        new = min(self.unproposed + novelty, 1.0)
        may_be_lost = 1.0 - belief.here >= search.parameters.doubt or not belief.is_known
        if new < PROPOSING_NOVELTY or (may_be_lost and not edges):
            return replace(belief, unproposed=new, history=belief.history.with_image(sighting))
        if may_be_lost:
            most_effort = 1.0 if carried > SURELY_CARRIED else MOST_EFFORT
            belief = belief._explored(search, like, is_tracked, sighting, new, most_effort, motion, rng)
        if not may_be_lost or (is_tracked and belief.overlooked < KNOWN):
            belief = replace(belief, is_known=True, overlooked=1.0)
        most = round(BESIDE * search.parameters.particles_most) if is_tracked else search.parameters.particles_most
        candidates = None if belief.candidates is None else belief.candidates.resampled(most, rng)
        return replace(belief, candidates=candidates, unproposed=0.0, history=belief.history.with_image(sighting))

    def _judged(
        self, search: GlobalLocalisation, before: Particles | None, sighting: Sighting, sees: bool, jump: Jump
    ) -> Belief:
        """Return the belief after transitions and Bayes' rule. sees: whether the image has more than a few edges."""
        carried = jump.carried(search.parameters.carried)
        novelty = max(jump.novelty, carried)
        belief, detections, shown = self._moved_on(novelty, min(carried, MOST_CARRIED)), self.detections, self.shown
        log_tracked, log_shown, blind, support = 0.0, 0.0, 0.0, 0.0
        if before is not None:
            visible = self.landmarks.shown(len(search.landmark_map))
            views = np.stack([np.ones_like(visible), visible])
            by_views = search.observation.by_views(before, sighting, search.landmark_map, views, BLUR_RAD)
            detections, log_tracked = _rated(before, PLACE_POWER * by_views[0], detections, novelty)
            shown, log_shown = _rated(before, PLACE_POWER * by_views[1], shown, novelty)
            blind = float(before.weight[(by_views[0] == 0.0).all(axis=0)].sum())
            support = self.support
        seen_m = (1.0 - blind) * jump.path_m
        shows_marker = (marked_landmarks(sighting.edges, search.landmark_map) >= 0).any()
        is_suspected = shows_marker or carried >= (SUSPECTED if blind < 0.5 else SURELY_CARRIED)
        explained = log_shown if is_suspected else support * float(np.exp(-seen_m / SUPPORT_M)) + log_shown
        is_explained = not is_suspected and explained > SUPPORTED * (1.0 - blind)
        candidates, log_elsewhere = self.candidates, 0.0
        if candidates is not None:
            (by_rate, _), within = search.evidence(candidates.particles, sighting), None
            if not is_explained:
                within = search.observation.log_likelihood(candidates.particles, sighting, search.landmark_map)
            candidates, log_elsewhere = candidates.weighed(by_rate, novelty, needs_landmarks=sees, within=within)
        limits = np.array([0.0, np.inf])
        if is_explained:
            gain = max(log_tracked, 0.0)
            limits = np.array([max(log_shown - gain, 0.0), gain + PATIENCE * seen_m])
            log_elsewhere = float(min(log_elsewhere - limits[0], limits[1]))
        log_bare = -BARE * novelty if sees else 0.0
        support = min(explained, MOST_SUPPORT)
        belief = replace(belief, candidates=candidates, detections=detections, shown=shown, support=support)
        belief = replace(belief, history=replace(belief.history, limits=belief.history.limits + limits))
        log_tracked += blind * log_bare
        top = max(log_tracked, log_elsewhere if belief.elsewhere > 0 else 0.0, 0.0)
        return belief._normalised(*(float(np.exp(log - top)) for log in (log_tracked, log_bare, log_elsewhere, 0.0)))

    def _moved_on(self, novelty: float, carried: float) -> Belief:
        """Return the belief before an image.

        The robot may be carried to another place, with that probability. The surroundings of a place that is tracked
        may cease to be mapped. Any other place may be left for where nothing is mapped, from where it may be entered.
        """
        left, entered = novelty * LEFT * self.tracked, novelty * LEFT * self.off_map
        returned = novelty * RETURNED * self.unmapped  # and as much is lost
        tracked, unmapped = self.tracked - left + returned, self.unmapped + left - returned - returned
        elsewhere, stays = (1.0 - novelty * LEFT) * self.elsewhere, 1.0 - carried
        mistaken = novelty * MISTAKEN * tracked
        enters = returned + entered + carried * (tracked - mistaken + unmapped + elsewhere)
        return replace(
            self,
            tracked=stays * (tracked - mistaken),
            unmapped=stays * unmapped,
            elsewhere=stays * elsewhere,
            unexplored=self.unexplored + enters,
            history=self.history.entering(enters + carried * self.unexplored, carried),
            off_map=self.off_map - entered + mistaken + self.elsewhere - elsewhere,
            overlooked=self.overlooked + carried * (1.0 - self.overlooked),
        )

    def _explored(
        self,
        search: GlobalLocalisation,
        like: Particles,
        is_tracked: bool,
        sighting: Sighting,
        new: float,
        most_effort: float,
        motion: MotionModel,
        rng: np.random.Generator,
    ) -> Belief:
        """Return the belief with the poses that an image proposes among the candidates.

        new: scenes since an image proposed poses last, 0 … 1. While a place is tracked, images share the work of a
        scene in proportion to it, at most `most_effort` each. On a large map they do so when the place is known.
        """
        is_first = not is_tracked and self.elsewhere == 0.0 and self.overlooked == 1.0
        shares = is_tracked and (self.is_known or len(search.pairs.pair) <= MANY_PAIRS)
        effort = min(new, most_effort) if shares else FIRST_EFFORT if is_first else 1.0
        proposed, hits = search.proposed(like, sighting, effort, rng)
        missed = max(OVERLOOKED ** (effort if shares or is_first else new), float(np.exp(-hits)))
        history = replace(self.history, overlooked=missed * self.history.overlooked)
        unexplored, overlooked = missed * self.unexplored, missed * self.overlooked
        belief = replace(self, unexplored=unexplored, overlooked=overlooked, history=history)
        if is_tracked:  # poses at the tracked place are no other place
            proposed = proposed.only(~is_near(proposed.particles.poses, like.estimate.pose))
        if len(proposed):
            late = self.history.weighed(proposed, sighting, search.evidence, motion, rng)
            more, probability = beyond(late, self.candidates, self.elsewhere)
            belief = belief._with(more, probability) if len(more) else belief
        return belief._normalised()

    def _with(self, others: Candidates, probability: float) -> Belief:
        """Return the belief with others, of this probability, among the candidates."""
        if self.candidates is not None and self.elsewhere > 0:
            log_odds = float(np.log(max(probability, 1e-300)) - np.log(self.elsewhere))
            others = self.candidates.joined(others, log_odds)
        return replace(self, elsewhere=self.elsewhere + probability, candidates=others)

    def beside(self, pose: Array) -> Belief:
        """Return the belief whose candidates are elsewhere: those near the tracked `pose` (3,) count as tracked."""
        if self.candidates is None:
            return self
        far = ~is_near(self.candidates.particles.poses, pose)
        away = self.elsewhere * float(self.candidates.particles.weight[far].sum())
        tracked = self.tracked + self.elsewhere - away
        if away < NEGLIGIBLE:
            unexplored = self.unexplored + away
            return replace(self, tracked=tracked, elsewhere=0.0, unexplored=unexplored, candidates=None)
        return replace(self, tracked=tracked, elsewhere=away, candidates=self.candidates.only(far))

    def _normalised(
        self, tracked: float = 1.0, unmapped: float = 1.0, elsewhere: float = 1.0, others: float = 1.0
    ) -> Belief:
        """Return the belief with probabilities times these likelihoods, of sum 1."""
        tracked, unmapped, elsewhere = tracked * self.tracked, unmapped * self.unmapped, elsewhere * self.elsewhere
        unexplored, off_map, entered = others * self.unexplored, others * self.off_map, others * self.history.entered
        total = tracked + unmapped + elsewhere + unexplored + off_map
        return replace(
            self,
            tracked=tracked / total,
            unmapped=unmapped / total,
            elsewhere=elsewhere / total,
            unexplored=unexplored / total,
            off_map=off_map / total,
            history=replace(self.history, entered=1.0 / total * entered),
        )

    # -- what follows from it -----------------------------------------------------------------------------------------

    def found(self, maps: int = 1, *, is_tracked: bool) -> tuple[Particles, Belief] | None:
        """Return the particles at the likeliest place, and the belief in which they are tracked; None if not yet.

        maps: among which places compete.
        """
        if self.candidates is None:
            return None
        cloud = self.candidates.particles
        near = is_near(cloud.poses, cloud.clusters.mean[0])
        share = float(cloud.weight[near].sum())
        if is_tracked and share * self.elsewhere < max(WON * self.here, 0.5):
            return None
        if not is_tracked and (share < ALONE or share * self.elsewhere < LIKELY):
            return None
        return particles.only(cloud, near), Belief(
            tracked=share * self.elsewhere,
            elsewhere=(1.0 - share) * self.elsewhere,
            unexplored=self.unexplored + self.here,
            off_map=self.off_map,
            candidates=None if near.all() else self.candidates.only(~near),
            unproposed=self.unproposed,
            is_known=False,
            overlooked=self.overlooked,
            history=self.history.entering(self.here),
            landmarks=self.landmarks.elsewhere(maps),
        )

    def released(self, cloud: Particles, maps: int = 1) -> Belief:
        """Return the belief in which the particles that were tracked are candidates. maps: as for `found`."""
        belief = self._with(Candidates.of(cloud, self.detections), self.here)
        belief = replace(belief, tracked=0.0, unmapped=0.0, is_known=False, landmarks=self.landmarks.elsewhere(maps))
        return replace(belief, detections=UNKNOWN_RATE, shown=UNKNOWN_RATE)

    def places(self, tracked: Particles | None) -> tuple[Particles, Estimate, Clusters]:
        """Return the particles that the estimate is from, the estimate, and all places where the robot may be.

        It is from those tracked, else from the likeliest place among the candidates.
        """
        others = None if self.candidates is None else self.candidates.particles
        if tracked is None:
            assert others is not None
            return others, particles.only(others, others.clusters.label == 0).estimate, others.clusters
        clusters = tracked.clusters
        if others is not None and self.elsewhere > 0:
            clusters = clusters.beside(others.clusters, self.elsewhere / (self.elsewhere + self.here))
        return tracked, tracked.estimate, clusters

    def p_correct(self, cloud: Particles, pose: Array, *, is_tracked: bool) -> float:
        """Return the probability that the estimate `pose` (3,) from these particles is within 0.5 m and 10°."""
        here = self.here if is_tracked else self.elsewhere
        probability = here * (self.landmarks.probability if is_tracked or self.landmarks.maps > 1 else 1.0)
        near = float(min(cloud.weight[is_near(cloud.poses, pose)].sum(), 1.0))
        return self._looked_at * probability * near

    @property
    def _looked_at(self) -> float:
        """The probability that the true place was not overlooked."""
        return 1.0 if self.is_known else 1.0 - self.overlooked

    def reason(self, p_correct: float, sighting: Sighting) -> Reason:
        """Return why p_correct is low, "" where it is not."""
        if p_correct >= SURE:
            return ""
        if len(sighting.edges) == 0 and sighting.measurement is None:
            return "no edges"
        others = self.elsewhere + self.unexplored + (1.0 - self._looked_at) * self.here
        return "edges contradict the map" if self._misfit > others else "several places fit"

    @property
    def _misfit(self) -> float:
        """The probability that this is no map of what is seen."""
        return self.off_map + (self.landmarks.log_odds < 0) * (1.0 - self.landmarks.probability) * self.here

    @property
    def warning(self) -> MapWarning:
        """What a user should look at, "" where all is well."""
        are_missing = self.landmarks.probability < MISSING and self._misfit > TRACKED_UNFIT[0]
        return "this map does not fit" if self.unfit >= 1.0 or are_missing else ""


def _rated(cloud: Particles, by_rate: Array, rate: Array, novelty: float) -> tuple[Array, float]:
    """Return the detection rate after an image, and the logarithm of the mean likelihood of these particles.

    by_rate: (K, N) log p(edges | particle, p_k). rate: (K,) before the image.
    """
    weighed, log_mean = Candidates.of(cloud, rate).weighed(by_rate, novelty, needs_landmarks=False)
    rates = weighed.rates @ weighed.particles.weight
    return rates / rates.sum(), log_mean
