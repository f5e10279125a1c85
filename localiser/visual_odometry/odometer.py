"""Odometry by wheels, by the camera or by both, where wheels may slip unnoticed.

There are two hypotheses: the wheels are right to within their sigma, or they slipped. Under the first one edges are
tracked from the motion of the wheels, under the second one from the earlier speed of the robot. Each explains the edges
more or less well, and Bayes' rule weighs them. If wheels and edges agree, the first one is certain. A slip makes pairs
under it impossible, and the second one wins.

Where the wheels are right, edges are used for the turn alone. Errors of their ranges (skirting boards, the tilt, what
is typical of a room) stay the same for metres: a hundred images measure the path no better than one, but each would
count as new information. The ranges are still used for how far edges move across the image.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from localiser.camera import Camera
from localiser.edges import Edges
from localiser.geometry import Array, Increment
from localiser.visual_odometry.estimate import Belief, Frames, follow
from localiser.visual_odometry.parameters import VisualOdometryParameters
from localiser.visual_odometry.twist import Gaussian, twist_gaussian

SCALE_SIGMA = 0.12
"""Of the scale of all ranges: lower ends that are taken for feet stand on plinths and lower shelves of about 0.1 m."""
SCALE_M = 2.0
"""How far the robot drives until other things are in view, and the scale is another."""
_LEAST_SIGMA = np.array([1e-3, 1e-3, 5e-4])


@dataclass(frozen=True, slots=True, eq=False)
class Odometer:
    """Turns what wheels and two frames say into one increment, by one camera."""

    camera: Camera
    parameters: VisualOdometryParameters

    @property
    def needs_wheels(self) -> bool:
        """Whether an image must wait until wheels have reached its time."""
        return self.parameters.source != "vision"

    @property
    def follows_edges(self) -> bool:
        """Whether anything but wheels counts."""
        return self.parameters.source != "wheel"

    def warm_up(self) -> None:
        """Compile what follows edges, or load it from the disk, so that no image has to wait for it."""
        angle = np.zeros(1)
        one = Edges.from_columns(angle, angle + 0.01, angle, angle + 0.01)
        self.seen(one, one, 1.0, None)

    def increment(
        self,
        wheel: Increment,
        wheel_cov: Array,
        before: Edges | None,
        after: Edges,
        seconds: float,
        pace: Gaussian | None = None,
    ) -> tuple[Increment, Gaussian | None]:
        """Return the motion over `seconds`, as wheels, edges or both say, and the pace that the robot goes on with.

        wheel_cov: (3, 3), of the wheels' motion. before: the edges of the last image, None when there was none.
        pace: twist per second at the last image, None when not known.
        """
        if not self.follows_edges or seconds <= 0:
            return wheel, pace
        if self.parameters.source == "vision":
            motion, pace = self.seen(before, after, seconds, pace)
            return seen_increment(with_scale(motion, walks=True)), pace
        frames, beliefs = self._frames(before, after, seconds, pace)
        found = follow(frames, self._with_wheels(wheel, wheel_cov, beliefs))
        pace = Gaussian(found.twist.mean / seconds, found.twist.cov / seconds**2)
        return Increment(found.motion.mean, found.motion.cov, wheel.path_m, wheel.turned_rad), pace

    def seen(
        self, before: Edges | None, after: Edges, seconds: float, pace: Gaussian | None, *, steers: bool = True
    ) -> tuple[Gaussian, Gaussian]:
        """Return the motion by the edges alone, without the error of the scale, and the pace as `increment` has it.

        steers: whether the robot hardly ever moves sideways. What wheels are judged by must not take that for granted:
        where edges do not tell, the prior would speak against every robot that walks or flies.
        """
        frames, beliefs = self._frames(before, after, seconds, pace)
        found = follow(frames, beliefs if steers else beliefs[1:])
        return found.motion, Gaussian(found.twist.mean / seconds, found.twist.cov / seconds**2)

    def _frames(
        self, before: Edges | None, after: Edges, seconds: float, pace: Gaussian | None
    ) -> tuple[Frames, list[Belief]]:
        """Return both frames, and what may be believed of the motion between them, whatever the wheels say."""
        frames = Frames.of(Edges.none() if before is None else before, after, self.camera)
        prior = self.parameters.twist(None if before is None else pace, seconds)
        return frames, self._from_nothing(frames, prior, seconds)

    def _from_nothing(self, frames: Frames, prior: Gaussian, seconds: float) -> list[Belief]:
        """Return the beliefs that the robot steers, and that it moves sideways as well as any way."""
        starts = frames.likely_motions(prior)
        steers = prior.with_right(0.0, self.parameters.sideways_m_s * seconds)
        share = self.parameters.sidle_share
        return [Belief(steers, starts, float(np.log1p(-share))), Belief(prior, starts, float(np.log(share)))]

    def _with_wheels(self, wheel: Increment, wheel_cov: Array, slipped: list[Belief]) -> list[Belief]:
        """Return the belief that wheels are right to within their noise, and those for when they slipped."""
        share = self.parameters.slip_share
        held = twist_of_wheels(wheel, wheel_cov)
        as_seen = [np.array([*held.mean[:2], start[2]]) for start in slipped[0].starts[:1]]
        return [
            Belief(held, [held.mean, *as_seen], float(np.log1p(-share)), way=False),
            *(replace(belief, log_share=belief.log_share + float(np.log(share))) for belief in slipped),
        ]


def twist_of_wheels(wheel: Increment, cov: Array) -> Gaussian:
    """Return the twist that wheels say, whose motion has this covariance (3, 3).

    Wheels that stand still know it exactly, edges never do: so the covariance is at least that of edges.
    """
    return twist_gaussian(Gaussian(wheel.mean, cov + np.diag(_LEAST_SIGMA**2)))


def with_scale(motion: Gaussian, *, walks: bool) -> Gaussian:
    """Return a motion by edges with the error of their ranges' scale, which is the same for `SCALE_M`.

    walks: whether as a random walk that errs by as much over that way; else that of this motion alone.
    """
    path_m = float(np.hypot(*motion.mean[:2]))
    var = SCALE_SIGMA**2 * (max(SCALE_M / max(path_m, 1e-6), 1.0) if walks else 1.0)
    along = np.append(motion.mean[:2], 0.0)
    return replace(motion, cov=motion.cov + var * np.outer(along, along))


def seen_increment(seen: Gaussian) -> Increment:
    """Return the increment of a motion that edges tell, and not wheels.

    Its path is how far the robot may well have come: one of which nothing is known has not stood still.
    """
    path_m = np.sqrt(np.square(seen.mean[:2]).sum() + np.trace(seen.cov[:2, :2]))
    turned_rad = np.sqrt(seen.mean[2] ** 2 + seen.cov[2, 2])
    return Increment(seen.mean, seen.cov, float(path_m), float(turned_rad))
