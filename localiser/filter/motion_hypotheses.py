"""Motion hypotheses: the robot moved as its wheels say, as its edges say, or it was carried (docs/motion.md).

Each is judged by how edges continue those of the image before, and by the map; carried, in the belief. The edges that
continue may belong to a person who walks by, so one image alone says only so much. While the wheels may be wrong,
particles move by a Gaussian with mean and covariance of both motions, each with its probability.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from localiser.filter.height import IMAGE_POWER
from localiser.geometry import Array, Increment, between, robot_from_map, wrap_angle
from localiser.particles import Estimate
from localiser.visual_odometry import (
    Gaussian,
    TwoImages,
    VisualOdometryParameters,
    follow,
    increment_of,
    mixture,
    with_scale,
)

# The fraction of edges that continue one of the image before is beta distributed: its mean after a robot was carried,
# and a + b, as edges of one object come and go together.
CARRIED, CONCENTRATION = 0.2, 6.0
FRACTIONS: Array = np.linspace(0.01, 0.99, 50)
STAY_WRONG = 0.7  # how probably wheels that were wrong at the last image still are
UNUSUAL = np.array([0.7, 0.4])  # part of what is usual below which other motions are compared: map, image before
FIT_MEMORY = 0.5  # part of what is usual that an image leaves
MOST_FOLLOWED = 32  # that are followed: the work grows with the square of their number
MOST_TOLD = 4.0  # log-ratio of one image by the map; as much for the wheels says that the pace may be wrong, too
DOUBTED = 0.05  # probability of being wrong from which on particles do not move by the wheels alone
ASTRAY = 0.05  # part of the motions by edges that are off by more than they claim
LEAST_SIGMA = np.array([1e-2, 1e-2, 2e-3])  # of any motion that is compared with edges, which are never exact


@dataclass(frozen=True, slots=True)
class Jump:
    """How new an image is, and whether the robot was carried since the last one.

    novelty: of the scene, 0 … 1, by the way. log_ratio: log p(edges | carried) / p(edges | not carried).
    path_m: driven since the last image. log_fit: log p(edges | last image, motion), over that of new edges.
    """

    novelty: float
    log_ratio: float = 0.0
    path_m: float = 0.0
    log_fit: float = 0.0

    def carried(self, chance: float) -> float:
        """Return the probability of having been carried, whose prior `chance` is that between two scenes."""
        share = 1.0 if self.log_ratio > 0.0 else self.novelty
        odds = share * chance / (1.0 - chance) * np.exp(min(self.log_ratio, 100.0))
        return float(odds / (1.0 + odds))


def log_carried(continuing: Array, usual: float) -> tuple[float, float, float]:
    """Return log p(edges | carried) / p(edges | not carried), that of the latter, and the fraction that continue.

    continuing: (E,) how much likelier an edge is if it continues one. usual: which fraction f does, of a robot that was
    not carried. At ½ and below, edges come and go so often that they tell nothing.
    """
    by_fraction = np.log1p(FRACTIONS * (continuing[:, None] - 1.0)).sum(axis=0)
    mean = np.array([[CARRIED], [max(usual, 0.5)]])  # of f; its beta densities but for a constant that both share
    density = (CONCENTRATION * mean - 1.0) * np.log(FRACTIONS)
    density += (CONCENTRATION * (1.0 - mean) - 1.0) * np.log1p(-FRACTIONS)
    carried, stayed = by_fraction + (density - np.logaddexp.reduce(density, axis=1, keepdims=True))
    weight, log_fit = np.exp(stayed - stayed.max()), float(np.logaddexp.reduce(stayed))
    return float(np.logaddexp.reduce(carried)) - log_fit, log_fit, float(weight @ FRACTIONS / weight.sum())


@dataclass(frozen=True, slots=True, eq=False)
class Wheels:
    """What is known of the wheels.

    wrong: probability that they were wrong at the last image. usual: (2,) mean log-likelihood of images whose motion
    they told: by the map, and by the image before. pose: (3,) estimate at the last image, None where none was tracked.
    pace: motion per second, None where not known. fit: whether the estimate of the last image tells it: where the image
    fitted what the wheels said, or edges told that these are wrong. Else the robot goes on at the pace from before.
    """

    wrong: float = 0.0
    usual: Array = field(default_factory=lambda: np.zeros(2))
    pose: Array | None = None
    pace: Gaussian | None = None
    fit: bool = True

    def after(
        self,
        fit: Array,
        images: Callable[[], TwoImages],
        by_map: Callable[[Increment], float],
        increment: Increment,
        cov: Array,
        parameters: VisualOdometryParameters,
        seconds: float,
    ) -> tuple[Wheels, Increment | None]:
        """Return what is known after an image, and how the robot moved by both if the wheels may be wrong, else None.

        fit: (2,) log-likelihood of the image after the motion of the wheels: by the map, and by the image before.
        images: returns the last one and this, by their longest edges. by_map: returns the logarithm of the mean
        likelihood of the image over particles after a motion. increment, cov: what the wheels say, and its covariance
        (3, 3). seconds: since the last image.

        Where wheels were right, and the image fits about as usual (`UNUSUAL`), or the map too well to bring them in
        doubt with all that edges may say, the motion counts as that of the wheels, and the pace follows it.
        """
        prior = STAY_WRONG * self.wrong + parameters.slip_share * (1.0 - self.wrong)
        needed = max(_log_odds(DOUBTED) - _log_odds(prior) + float(np.log(ASTRAY)), 0.0)
        least = np.minimum(UNUSUAL * self.usual, self.usual - [needed / IMAGE_POWER, 0.0])
        fits = (fit >= least).all()
        usual = FIT_MEMORY * self.usual + (1.0 - FIT_MEMORY) * fit
        if self.pace is None or (self.wrong < parameters.slip_share and fits):
            return replace(self, wrong=0.0, usual=usual, fit=True), None
        expected = parameters.expected(self.pace, seconds)
        wheels_say = Gaussian(increment.mean, cov + np.diag(LEAST_SIGMA**2))
        seen = with_scale(follow(images(), [(expected, 0.0)]), walks=False)
        log_ratio = min(IMAGE_POWER * (by_map(increment_of(seen)) - by_map(increment)), MOST_TOLD)
        log_ratio += contradicts(wheels_say, seen, expected)
        log_odds = float(np.clip(_log_odds(prior) + log_ratio, -50.0, 50.0))
        wheels = replace(self, wrong=float(1.0 / (1.0 + np.exp(-log_odds))), fit=log_ratio < -MOST_TOLD or log_odds > 0)
        if wheels.wrong > DOUBTED:
            both = mixture([Gaussian(increment.mean, cov), seen], np.array([1.0 - wheels.wrong, wheels.wrong]))
            return wheels, increment_of(both)
        # Where the image fits, `located` takes the estimate's pace instead.
        pace = Gaussian(expected.mean / seconds, expected.cov / seconds**2)
        return replace(wheels, usual=usual, pace=pace), None

    def located(self, estimate: Estimate | None, seconds: float) -> Wheels:
        """Return what is known once the robot is located, `seconds` after the last image; None: was not, or jumped."""
        if estimate is None or self.pose is None:
            return replace(self, pose=None if estimate is None else estimate.pose, pace=None)
        if seconds <= 0 or not self.fit:
            return replace(self, pose=estimate.pose)
        in_robot = np.eye(3)
        in_robot[:2, :2] = robot_from_map([0.0, 0.0, self.pose[2]], np.eye(2)).T
        cov = in_robot @ estimate.pose_cov @ in_robot.T / seconds**2
        pace = Gaussian(between(self.pose, estimate.pose) / seconds, cov)
        return replace(self, pose=estimate.pose, pace=pace)


def _log_odds(probability: float) -> float:
    """Return log(p / (1 - p))."""
    return float(np.log(probability) - np.log1p(-probability))


def contradicts(wheels: Gaussian, seen: Gaussian, expected: Gaussian) -> float:
    """Return log p(edges | the robot went on at its pace) / p(edges | the wheels are right).

    seen: the motion by the edges and the `expected` one, so that p(edges | motion) is their ratio. A few motions that
    are seen are far off (`ASTRAY`), so edges can say only so much against the wheels.
    """
    seen, wheels = (
        replace(each, mean=np.append(each.mean[:2], expected.mean[2] + wrap_angle(each.mean[2] - expected.mean[2])))
        for each in (seen, wheels)
    )
    of_seen, of_wheels, of_pace = (np.linalg.inv(each.cov) for each in (seen, wheels, expected))
    information = of_seen + of_wheels - of_pace
    if np.linalg.eigvalsh(information)[0] <= 0.0:  # edges tell less than the pace
        return 0.0
    mean = np.linalg.solve(information, of_seen @ seen.mean + of_wheels @ wheels.mean - of_pace @ expected.mean)
    right = seen.log_density(mean) + wheels.log_density(mean) - expected.log_density(mean)
    right -= 0.5 * np.linalg.slogdet(information / (2.0 * np.pi))[1]
    return -float(np.logaddexp(np.log1p(-ASTRAY) + right, np.log(ASTRAY)))
