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

from dataclasses import dataclass, field, replace

import numpy as np

from localiser.geometry import Array, Increment, between, compose
from localiser.motion import MotionModel, covariance_of
from localiser.observation import Sighting
from localiser.particles import cells_of, from_gaussian
from localiser.relocalisation.candidates import Candidates
from localiser.relocalisation.global_localisation import FEWEST, GlobalLocalisation

SCENES = 24  # that are kept
MOST_LOG = 600.0  # of a probability that is still finite


@dataclass(frozen=True, slots=True, eq=False)
class PastImage:
    """An image that is kept.

    novelty: of the images since the one before, which it counts for. step: motion from it to the next one that is kept,
    or to the last image. limits: (2,) another place gains log-likelihood - limits[0] by it, at most limits[1]. For
    candidates their mean is limited, and for a place that is proposed late each pose, which is the safe side.
    """

    sighting: Sighting
    novelty: float
    step: Increment
    limits: Array


@dataclass(frozen=True, slots=True, eq=False)
class History:
    """Images of the last scenes, oldest first, and what happened since the last of them.

    entered: (K + 1,) probability that came to where nobody has looked, between one of the K images and the one before,
    and since the last. limits: of what a place may gain since then. overlooked: part of what was unexplored that still
    is. new: scenes.
    """

    images: tuple[PastImage, ...] = ()
    entered: Array = field(default_factory=lambda: np.zeros(1))
    limits: Array = field(default_factory=lambda: np.zeros(2))
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

    def with_image(self, sighting: Sighting) -> History:
        """Return the history with an image, if it is of another scene than the last one that was kept."""
        if self.new < 1.0:
            return self
        last = PastImage(sighting, self.new, Increment.from_mean(np.zeros(3)), self.limits)
        images, entered = (*self.images, last), self.entered
        if len(images) > SCENES:
            oldest, images, entered = entered[0], images[1:], entered[1:].copy()
            entered[0] += self.overlooked * oldest
        return History(images, np.append(entered, 0.0))

    def weighed(
        self,
        proposed: Candidates,
        sighting: Sighting,
        search: GlobalLocalisation,
        motion: MotionModel,
        rng: np.random.Generator,
    ) -> Candidates:
        """Return proposed poses with the probabilities above. sighting: the last image.

        Their weights are the density of the region over that of the draws, divided by how many were drawn.
        """
        clouds = [proposed.particles]  # where they were, by odometry and its noise; now last
        for image in reversed(self.images):
            steps = from_gaussian(image.step.mean, covariance_of(motion, image.step), len(proposed), rng).poses
            columns = clouds[0].columns.copy()
            columns[:3] = compose(columns[:3].T, between(steps, np.zeros_like(steps))).T
            clouds.insert(0, replace(proposed.particles, columns=columns))
        last = PastImage(sighting, self.new, Increment.from_mean(np.zeros(3)), self.limits)
        log_path, followed = np.full(len(proposed), -np.inf), proposed
        for cloud, entered, image in zip(clouds, self.entered, (*self.images, last), strict=True):
            log_entered = np.log(max(entered, 1e-300))
            log_path = np.logaddexp(log_path, log_entered)
            rates = followed.rates + np.exp(log_entered - log_path) * (proposed.rates - followed.rates)
            there = Candidates(replace(cloud, log_weight=np.zeros(len(cloud))), rates)
            needs_landmarks = search.known_edges(image.sighting) >= FEWEST
            by_rate = search.by_rate(cloud, image.sighting)
            followed, _ = there.weighed(by_rate, image.novelty, needs_landmarks=needs_landmarks)
            log_path += np.minimum(followed.particles.log_weight - image.limits[0], image.limits[1])
        log_weight = proposed.particles.log_weight + log_path
        return Candidates(replace(proposed.particles, log_weight=log_weight), followed.rates)


def beyond(proposed: Candidates, known: Candidates | None, probability: float) -> tuple[Candidates | None, float]:
    """Return proposed poses with the probability that they have beyond those known in their cells, and all of it.

    proposed: log_weight is that of their probability. known: candidates that are followed, and the probability of all
    of them. What images say of a place that is followed already is counted once.
    """
    log_weight = proposed.particles.log_weight
    top = max(float(log_weight.max()) - MOST_LOG, 0.0)
    mass = np.exp(log_weight - top)
    old = proposed.particles.poses[:0] if known is None else known.particles.poses
    cell = cells_of(np.concatenate([proposed.particles.poses, old]))
    here, cells = cell[: len(mass)], int(cell.max()) + 1
    found = np.bincount(here, mass, minlength=cells)
    if known is not None:
        before = np.exp(-top) * probability * known.particles.weight
        gained = np.maximum(found - np.bincount(cell[len(mass) :], before, minlength=cells), 0.0)
        mass = mass * (gained / np.maximum(found, 1e-300))[here]
    more = mass > 0
    if not more.any():
        return None, 0.0
    chosen = proposed.only(more)
    particles = replace(chosen.particles, log_weight=np.log(mass[more]))
    return replace(chosen, particles=particles), float(mass.sum())
