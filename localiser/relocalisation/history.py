"""What recent images say of a place that is only proposed now.

A place is often proposed long after the robot could have been there. Until then it was a part of what is unexplored,
and the images since count for it as they do for a candidate that was followed all along:

    P(pose) = Σ_k entered_k Π p(edges_j | pose_j)^(power ν_j)   over the images j ≥ k

entered_k is the probability that came with image k to where nobody has looked: at first all of it, later that of a
robot that was carried, or that comes onto the map. Odometry tells where the robot was at image j, if it is at a pose
now. One image is kept for each scene. It counts for those since the one before, and the last image for those since it.

What entered before the images that are kept counts as what is unexplored does: it falls by what images look at.

Two things are not exact. A pose has one path, drawn from the noise of odometry, so a place that is as good as followed
ones may be found only by a later image. And as a place has the largest probability that any image gave it (`beyond`),
errors of these draws add up on the side of other places.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from localiser.geometry import Array, Increment, between, compose
from localiser.motion import MotionModel, covariance_of
from localiser.observation import Sighting
from localiser.particles import Particles, cells_of, from_gaussian
from localiser.relocalisation.candidates import Candidates
from localiser.relocalisation.global_localisation import Clues

SCENES = 24  # that are kept
MOST_LOG = 600.0  # of a probability that is still finite


@dataclass(frozen=True, slots=True)
class Limits:
    """How much another place may gain by images that the tracked place explains: log-likelihood - less, at most `most`.

    For candidates their mean is limited, and for a place that is proposed late each pose, which is the safe side.
    """

    less: float = 0.0
    most: float = np.inf

    def of(self, log_likelihood: Array) -> Array:
        """Return log-likelihoods (N,) within these limits."""
        return np.minimum(log_likelihood - self.less, self.most)

    def __add__(self, other: Limits) -> Limits:
        return Limits(self.less + other.less, self.most + other.most)


NO_IMAGE = Limits(0.0, 0.0)


@dataclass(frozen=True, slots=True, eq=False)
class PastImage:
    """An image that is kept.

    novelty: of the images since the one before, which it counts for. step: motion from it to the next one that is kept,
    or to the last image. limits: of what a place may gain by it.
    """

    sighting: Sighting
    novelty: float
    step: Increment
    limits: Limits


@dataclass(frozen=True, slots=True, eq=False)
class History:
    """Images of the last scenes, oldest first, and what happened since the last of them.

    entered: (K + 1,) probability that came to where nobody has looked, between one of the K images and the one before,
    and since the last. limits: of what a place may gain since then. overlooked: part of what was unexplored that still
    is. new: scenes.
    """

    images: tuple[PastImage, ...] = ()
    entered: Array = field(default_factory=lambda: np.zeros(1))
    limits: Limits = NO_IMAGE
    overlooked: float = 1.0
    new: float = 0.0

    def moved(self, increment: Increment, novelty: float) -> History:
        """Return the history after a motion. novelty: of the scene of the image that follows it, 0 … 1."""
        if not self.images:
            return replace(self, new=1.0)
        *earlier, last = self.images
        images = (*earlier, replace(last, step=last.step.then(increment)))
        return replace(self, images=images, new=self.new + novelty)

    def entering(self, probability: float, carried: float = 0.0) -> History:
        """Return the history of a robot that comes to where nobody has looked, with this probability.

        carried: probability that it was carried since the last image. What entered before that counts no longer.
        """
        entered = (1.0 - carried) * self.entered
        entered[-1] += probability
        return replace(self, entered=entered)

    def scaled(self, factor: float) -> History:
        """Return the history with all probabilities times a factor."""
        return replace(self, entered=factor * self.entered)

    def limited(self, limits: Limits) -> History:
        """Return the history in which a place may gain no more than this by one more image."""
        return replace(self, limits=self.limits + limits)

    def looked(self, overlooked: float) -> History:
        """Return the history after an image has proposed poses, and has left this part of the unexplored."""
        return replace(self, overlooked=self.overlooked * overlooked)

    def with_image(self, sighting: Sighting) -> History:
        """Return the history with an image, if it is of another scene than the last one that was kept."""
        if self.new < 1.0:
            return self
        still = Increment.from_mean(np.zeros(3))
        images, entered = (*self.images, PastImage(sighting, self.new, still, self.limits)), self.entered
        if len(images) > SCENES:
            oldest, images, entered = entered[0], images[1:], entered[1:].copy()
            entered[0] += self.overlooked * oldest
        return History(images, np.append(entered, 0.0))

    def weighed(
        self,
        proposed: Candidates,
        sighting: Sighting,
        clues_of: Callable[[Sighting], Clues],
        motion: MotionModel,
        rng: np.random.Generator,
    ) -> Candidates:
        """Return proposed poses with the probabilities above.

        Their weights are the density of the region over that of the draws, divided by how many were drawn. sighting:
        the last image. clues_of: returns what an image says of places.
        """
        clouds = self.places_before(proposed.particles, motion, rng)
        images = [(one.sighting, one.limits, one.novelty) for one in self.images]
        images.append((sighting, self.limits, self.new))
        log_path, followed = np.full(len(proposed), -np.inf), proposed
        for cloud, entered, (seen, limits, novelty) in zip(clouds, self.entered, images, strict=True):
            log_entered = np.log(max(entered, 1e-300))
            log_path = np.logaddexp(log_path, log_entered)
            rates = followed.rates + np.exp(log_entered - log_path) * (proposed.rates - followed.rates)
            there = Candidates(replace(cloud, log_weight=np.zeros(len(cloud))), rates)
            clues = clues_of(seen)
            followed, _ = there.weighed(clues.by_rate(cloud), novelty, needs_landmarks=not clues.is_blind)
            log_path += limits.of(followed.particles.log_weight)
        log_weight = proposed.particles.log_weight + log_path
        return Candidates(replace(proposed.particles, log_weight=log_weight), followed.rates)

    def places_before(self, cloud: Particles, motion: MotionModel, rng: np.random.Generator) -> list[Particles]:
        """Return where particles were at each image that is kept, and where they are now, by odometry and its noise."""
        clouds = [cloud]
        for image in reversed(self.images):
            steps = from_gaussian(image.step.mean, covariance_of(motion, image.step), len(cloud), rng).poses
            columns = clouds[-1].columns.copy()
            columns[:3] = compose(columns[:3].T, between(steps, np.zeros_like(steps))).T
            clouds.append(replace(cloud, columns=columns))
        return clouds[::-1]


def beyond(proposed: Candidates, known: list[tuple[Particles, float]]) -> tuple[Candidates | None, float]:
    """Return proposed poses with the probability that they have beyond those known in their cells, and all of it.

    proposed: log_weight is that of their probability. known: particles, and the probability of each cloud. Where a
    place is followed already, what images say of it is counted once.
    """
    log_weight = proposed.particles.log_weight
    top = max(float(log_weight.max()) - MOST_LOG, 0.0)
    mass = np.exp(log_weight - top)
    poses = np.concatenate([proposed.particles.poses, *(one.poses for one, _ in known)])
    cell = cells_of(poses)
    here, there, cells = cell[: len(mass)], cell[len(mass) :], int(cell.max()) + 1
    found = np.bincount(here, mass, minlength=cells)
    weights = np.concatenate([np.zeros(0), *(np.exp(-top) * probability * one.weight for one, probability in known)])
    before = np.bincount(there, weights, minlength=cells)
    mass = mass * (np.maximum(found - before, 0.0) / np.maximum(found, 1e-300))[here]
    more = mass > 0
    if not more.any():
        return None, 0.0
    chosen = proposed.only(more)
    particles = replace(chosen.particles, log_weight=np.log(mass[more]))
    return replace(chosen, particles=particles), float(mass.sum())
