"""Whether the wheels are right: they may stand still while the robot drives, slip, or be silent for a while.

An image should fit the map from where the wheels say the robot is, and its edges should be where those of the last
image were, moved by that motion. Where either is much worse than usual, another explanation is weighed beside it: the
wheels are wrong, the robot went on at its pace (an Ornstein-Uhlenbeck process of its speed), and it turned as most
edges say that continue from the last image. Bayes' rule compares both,

    odds(wrong) = prior odds · (M(pace) C(pace) / M(wheels) C(wheels))^0.6 · p(seen | wrong) / p(seen | right)

M: mean likelihood of the image over particles after a motion. C: density of its edges, as the last image predicts them.
The wheels, too, may turn within their noise as the edges say: else they would lose against whatever knows less. Where
the wheels are under suspicion, visual odometry follows the edges, and the last factor compares the motion that it sees
with theirs. It goes astray now and then, so one image alone says only so much.

While the wheels may be wrong, particles move as the mixture of both motions says, each with its probability, and the
map decides. The wheels are believed again when they predict better.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from localiser.edges import Edges
from localiser.geometry import Array, Increment, between
from localiser.particles import Estimate
from localiser.visual_odometry import (
    Gaussian,
    Odometer,
    TwoImages,
    VisualOdometryParameters,
    increment_of,
    likely_motions,
    mixture,
    with_scale,
)

PACE_POWER = 0.6  # of the likelihood: edges of an image err together
STAY_WRONG = 0.7  # how probably wheels that were wrong at the last image still are
UNUSUAL = 0.7
FIT_MEMORY = 0.9  # part of what is usual that an image leaves
MOST_FOLLOWED = 48  # that are followed: the work grows with the square of their number
TURN_SIGMA_RAD = np.radians(1.0)  # of a turn that edges tell by their votes
MOST_TOLD = 4.0  # log-ratio of one image: a person who walks by moves most of its edges, whatever the wheels do
DOUBTED = 0.05  # probability of being wrong from which on particles do not move by the wheels alone
SUSPECT = -4.0  # log-ratio from which on edges are followed, which takes longer
ASTRAY = 0.05  # part of the motions by edges that are off by more than they claim
LEAST_SIGMA = np.array([1e-3, 1e-3, 5e-4])  # of any motion that is compared with edges, which are never exact


@dataclass(frozen=True, slots=True, eq=False)
class Evidence:
    """What an image says of how the robot moved.

    odometer: follows edges from one image to the next. before, after: longest edges of the last image and of this.
    by_map: returns the logarithm of the mean likelihood of the image over particles after a motion. by_last_image:
    returns the log-density of its edges, as those of the last image predict them after a motion.
    """

    odometer: Odometer
    before: Edges
    after: Edges
    by_map: Callable[[Increment], float]
    by_last_image: Callable[[Increment], float]

    def turned(self, prior: Gaussian) -> tuple[Increment, float]:
        """Return a motion whose turn the edges tell, and the log of how well the prior foresaw that turn."""
        images = TwoImages.of(self.before, self.after, self.odometer.camera)
        likely = likely_motions(images, prior) if len(self.before) and len(self.after) else []
        if not likely:
            return increment_of(prior), 0.0
        miss_rad, var = likely[0][2] - prior.mean[2], prior.cov[2, 2]
        kept = min(TURN_SIGMA_RAD**2 / var, 1.0)
        scale = np.array([1.0, 1.0, kept**0.5])
        told = Gaussian(np.array([*prior.mean[:2], likely[0][2]]), prior.cov * np.outer(scale, scale))
        log_ratio = min(0.5 * float(np.log(kept) - miss_rad**2 / var), 0.0)
        return increment_of(told), log_ratio

    def weighed(self, pace: Gaussian, wheels: Gaussian, by_map: float, by_last: float) -> float:
        """Return log p(image | it went on at its pace) / p(image | the wheels are right), to the power `PACE_POWER`.

        pace, wheels: motions. by_map, by_last: of the motion of the wheels. Both turn as the edges tell, so that none
        wins because it knows less of its turn.
        """
        (paced, log_paced), (held, log_held) = self.turned(pace), self.turned(wheels)
        last = self.by_last_image(paced) + log_paced - max(self.by_last_image(held) + log_held, by_last)
        return min(PACE_POWER * (self.by_map(paced) - by_map + last), MOST_TOLD)


@dataclass(frozen=True, slots=True, eq=False)
class Wheels:
    """What is known of the wheels.

    wrong: probability that they were wrong at the last image. usual: (2,) mean log-likelihood of images whose motion
    they told: by the map, and by the image before. pose: (3,) estimate at the last image, None where none was tracked.
    pace: motion per second, None where not known. fit: whether the last image fitted where the wheels said. The pace is
    the estimate's while images fit; where one does not, the robot is expected to go on at the pace from before.
    """

    wrong: float = 0.0
    usual: Array = field(default_factory=lambda: np.zeros(2))
    pose: Array | None = None
    pace: Gaussian | None = None
    fit: bool = True

    @property
    def are_wrong(self) -> bool:
        """Whether they are more likely wrong than right."""
        return self.wrong > 0.5

    def after(
        self,
        evidence: Evidence,
        increment: Increment,
        cov: Array,
        fit: tuple[float, float],
        parameters: VisualOdometryParameters,
        seconds: float,
    ) -> tuple[Wheels, Increment | None]:
        """Return what is known after an image, and how the robot moved if the wheels are wrong.

        increment, cov: what the wheels say, and its covariance (3, 3); fit: what `evidence` says of it, by the map and
        by the last image. seconds: since the last image.
        """
        right = np.array(fit)
        fits = (right >= UNUSUAL * self.usual).all()
        usual = FIT_MEMORY * self.usual + (1.0 - FIT_MEMORY) * right
        if self.pace is None or (self.wrong < parameters.slip_share and fits):
            return replace(self, wrong=0.0, usual=usual, fit=True), None
        expected = parameters.expected(self.pace, seconds)
        wheels_say = Gaussian(increment.mean, cov + np.diag(LEAST_SIGMA**2))
        log_ratio, seen = evidence.weighed(expected, wheels_say, *fit), None
        if log_ratio > SUSPECT or self.are_wrong:
            seen, _ = evidence.odometer.motion(evidence.before, evidence.after, seconds, self.pace)
            seen = with_scale(seen, walks=False)
            log_ratio += contradicts(increment.mean, cov, seen, parameters.expected(None, seconds).cov)
        prior = STAY_WRONG * self.wrong + parameters.slip_share * (1.0 - self.wrong)
        log_odds = float(np.clip(np.log(prior / (1.0 - prior)) + log_ratio, -50.0, 50.0))
        wheels = replace(self, wrong=float(1.0 / (1.0 + np.exp(-log_odds))), fit=log_ratio < SUSPECT)
        if wheels.wrong > DOUBTED and seen is not None:
            return wheels, increment_of(
                mixture([Gaussian(increment.mean, cov), seen], np.array([1.0 - wheels.wrong, wheels.wrong]))
            )
        if wheels.fit:
            return replace(wheels, usual=usual), None
        pace = Gaussian(expected.mean / seconds, expected.cov / seconds**2)
        return replace(wheels, usual=usual, pace=pace), None

    def located(self, estimate: Estimate | None, seconds: float) -> Wheels:
        """Return what is known once the robot has been located, `seconds` after the last image; None: it was not."""
        if estimate is None or self.pose is None or seconds <= 0:
            return replace(self, pose=None if estimate is None else estimate.pose, pace=None)
        if not (self.fit or self.are_wrong):
            return replace(self, pose=estimate.pose)
        pace = between(self.pose, estimate.pose) / seconds
        return replace(self, pose=estimate.pose, pace=Gaussian(pace, estimate.pose_cov / seconds**2))


def contradicts(wheels: Array, cov: Array, seen: Gaussian, any_cov: Array) -> float:
    """Return log p(seen | the wheels are wrong) / p(seen | they are right).

    wheels: (3,) their motion, with its covariance (3, 3). any_cov: (3, 3) of any motion that the robot may make. One
    motion in twenty that is seen is far off (`ASTRAY`), so it can say at most log 20 against the wheels.
    """
    apart, both = seen.mean - wheels, cov + seen.cov + np.diag(LEAST_SIGMA**2)
    right, any_motion = (Gaussian(np.zeros(3), each).log_density(apart) for each in (both, both + any_cov))
    return any_motion - float(np.logaddexp(np.log1p(-ASTRAY) + right, np.log(ASTRAY) + any_motion))
