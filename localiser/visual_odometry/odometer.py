"""Odometry by the camera alone, what the wheels are judged by, and how a robot may move between two images."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BeforeValidator, Field

from localiser.camera import Camera
from localiser.edges import Edges
from localiser.geometry import Increment
from localiser.visual_odometry.estimate import Gaussian, follow
from localiser.visual_odometry.two_images import TwoImages

LONGEST_S = 600.0


def _not_both(source: Any) -> Any:
    if source == "both":
        raise ValueError("`both` is gone: edges check the wheels anyway; expected 'wheel' or 'vision'")
    return source


@dataclass(frozen=True, slots=True)
class VisualOdometryParameters:
    """Where increments come from, and how a robot may move."""

    source: Annotated[
        Literal["wheel", "vision"],
        BeforeValidator(_not_both),
        Field(description="what says how the robot moved: its wheels, or its camera alone"),
    ] = "wheel"
    speed_m_s: Annotated[
        float,
        Field(gt=0, le=20, description="speed of the robot in any direction, as far as vision knows (m/s, 1 sigma)"),
    ] = 0.5
    turn_deg_s: Annotated[
        float, Field(gt=0, le=720, description="turn rate of the robot, as far as vision knows (degrees/s, 1 sigma)")
    ] = 45.0
    pace_s: Annotated[
        float, Field(gt=0, description="how long the robot goes on at its pace, as far as vision knows (s)")
    ] = 2.0
    sideways_m_s: Annotated[
        float, Field(gt=0, le=20, description="speed sideways of a robot that steers (m/s, 1 sigma)")
    ] = 0.02
    sidle_share: Annotated[
        float, Field(gt=0, lt=1, description="share of increments in which it moves sideways as fast as any way")
    ] = 0.05
    slip_share: Annotated[
        float, Field(gt=0, lt=0.5, description="share of images at which wheels begin to slip beyond their noise")
    ] = 1e-3

    def expected(self, pace: Gaussian | None, seconds: float) -> Gaussian:
        """Return what is known of the motion over `seconds` from the pace until then, a motion per second.

        It keeps that pace for a while and strays from it (an Ornstein-Uhlenbeck process). After `LONGEST_S` a robot can
        be anywhere in a building; no more time makes it less certain.
        """
        seconds = min(seconds, LONGEST_S)
        sigma = np.array([self.speed_m_s, self.speed_m_s, np.deg2rad(self.turn_deg_s)])
        if pace is None:
            return Gaussian(np.zeros(3), np.diag(sigma**2) * seconds**2)
        kept = np.exp(-seconds / self.pace_s)
        cov = kept**2 * pace.cov + (1.0 - kept**2) * np.diag(sigma**2)
        return Gaussian(kept * pace.mean * seconds, cov * seconds**2)


SCALE_SIGMA = 0.12  # of the scale of all ranges: what is taken for feet stands on plinths and shelves of about 0.1 m
SCALE_M = 2.0  # how far the robot drives until other things are in view, and the scale is another


@dataclass(frozen=True, slots=True, eq=False)
class Odometer:
    """Turns what two images of one camera say into an increment."""

    camera: Camera
    parameters: VisualOdometryParameters

    def warm_up(self) -> None:
        """Compile what follows edges, or load it from the disk, so that no image has to wait for it."""
        one = Edges.from_bearings([0.0], 0.01)
        self.motion(one, one, 1.0, None)

    def motion(
        self, before: Edges | None, after: Edges, seconds: float, pace: Gaussian | None
    ) -> tuple[Gaussian, Gaussian]:
        """Return the motion over `seconds` by edges alone, without the error of their scale, and the pace from then on.

        before: the edges of the last image, None when there was none. pace: motion per second at the last image, None
        when not known. The robot is taken to steer. Wheels are not judged by that: where edges do not tell, it would
        speak against those of every robot that walks or flies.
        """
        images = TwoImages.of(Edges.none() if before is None else before, after, self.camera)
        prior = self.parameters.expected(None if before is None else pace, seconds)
        share = self.parameters.sidle_share
        # Along an arc it ends to the right by half of its turn times the way back, give or take the speed sideways,
        # and what the product varies by that is not linear: all of it where no pace is known.
        right_m, back_m, turn = prior.mean
        of_arc = np.array([1.0, -0.5 * turn, -0.5 * back_m])
        across = prior.cov @ of_arc
        bent = 0.25 * (prior.cov[1, 1] * prior.cov[2, 2] + prior.cov[1, 2] ** 2)
        gain = across / (of_arc @ across + bent + (self.parameters.sideways_m_s * seconds) ** 2)
        straight = Gaussian(prior.mean - gain * (right_m - 0.5 * turn * back_m), prior.cov - np.outer(gain, across))
        motion = follow(images, [(straight, float(np.log1p(-share))), (prior, float(np.log(share)))])
        return motion, Gaussian(motion.mean / seconds, motion.cov / seconds**2)


def with_scale(motion: Gaussian, *, walks: bool) -> Gaussian:
    """Return a motion by edges with the error of their ranges' scale, which is the same for `SCALE_M`.

    walks: whether as a random walk that errs by as much over that way; else that of this motion alone.
    """
    var = SCALE_SIGMA**2 * (max(SCALE_M / max(np.hypot(*motion.mean[:2]), 1e-6), 1.0) if walks else 1.0)
    along = np.append(motion.mean[:2], 0.0)
    return replace(motion, cov=motion.cov + var * np.outer(along, along))


def increment_of(motion: Gaussian) -> Increment:
    """Return the increment of a motion that edges tell, and not wheels.

    Its path is how far the robot may well have come: one of which nothing is known has not stood still.
    """
    path_m = float(np.sqrt(np.square(motion.mean[:2]).sum() + np.trace(motion.cov[:2, :2])))
    turned_rad = float(np.sqrt(motion.mean[2] ** 2 + motion.cov[2, 2]))
    return Increment(motion.mean, motion.cov, path_m, turned_rad, told=np.array([path_m, turned_rad]))
