"""The optimal proposal: draw the steps of particles from odometry and edges together [Doucet, Godsill, Andrieu 2000].

Odometry is far less accurate than edges. Of the particles that are moved by odometry alone, one in a hundred or fewer
explains the next image, and each resampling that follows loses information from earlier images. Equations:
docs/filter.md. Where an edge with a certain landmark or the linearisation is wrong, the weights correct it: they come
from the full observation, and some of the steps are drawn from odometry alone.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from localiser import particles
from localiser.camera import Camera
from localiser.geometry import MANY, Array, Increment, cos_sin
from localiser.motion import MotionParameters, Step
from localiser.observation import Targets
from localiser.particles import MOST_STAGES, POSE, Particles, systematic_resample

BLIND = 0.1  # fraction of steps drawn from odometry alone, and of particles resampled by what they weighed before


@dataclass(frozen=True, slots=True, eq=False)
class OptimalProposal:
    """What the edges of an image say, and how particles are resampled by it.

    novelty: how much of the edges' evidence is new, 0 … 1. stage_below: fraction of effective samples that each stage
    leaves. resample_below: the fraction from which on nothing needs to be resampled.
    """

    camera: Camera
    targets: Targets
    novelty: float
    stage_below: float
    resample_below: float

    def moved(
        self, cloud: Particles, step: Step, increment: Increment, motion: MotionParameters, rng: np.random.Generator
    ) -> Particles:
        """Return the particles moved to where the edges say, with weights that take that back.

        step: which they are expected to take by `increment`.
        """
        count, left = len(cloud), 1.0
        for stage in range(MOST_STAGES + 1):
            root, explained, log_evidence = step_density(step, self.camera, self.targets, self.novelty)
            ahead = flattened(log_evidence, cloud.log_weight)
            weight = particles.normalised(cloud.log_weight + left * ahead)
            if stage == MOST_STAGES or particles.effective_sample_size(weight) >= self.resample_below * count:
                break
            taken = particles.largest_step(cloud.log_weight, ahead, left, self.stage_below * count)
            weight = particles.normalised(cloud.log_weight + taken * ahead)
            cloud, left = particles.take(cloud, systematic_resample(weight, count, rng)), left - taken
            if left > 0:
                cloud = particles.spread(cloud, rng)
            step = motion.expected_step(cloud, increment)
        normal, log_ratio = drawn(root, explained, rng)
        moved = motion.stepped(cloud, step, normal, increment)
        return replace(moved, log_weight=cloud.log_weight + log_ratio - (1 - left) * ahead)


def step_density(step: Step, camera: Camera, targets: Targets, novelty: float) -> tuple[Array, Array, Array]:
    """Return the optimal proposal of standardised steps, from odometry and the new part of the edges' evidence.

    For each of N particles it is N(A⁻¹ b, A⁻¹), A = L Lᵀ. Returned are L (6, N), its rows 00, 10, 11, 20, 21, 22, then
    L⁻¹ b (3, N), and log ψ (N,), ψ the mean of the edges' likelihood over all steps that odometry allows.
    """
    from localiser.filter import optimal_proposal_kernel as kernel

    mount, angle, poses = camera.mount, targets.angle, step.poses
    table = np.column_stack([targets.points, np.cos(angle), np.sin(angle), novelty / targets.variance])
    offset = (mount.right_m, mount.back_m, float(np.cos(mount.yaw_rad)), float(np.sin(mount.yaw_rad)))
    steps = np.concatenate([poses[:2], cos_sin(poses[2]), step.axes.reshape(9, -1)])
    found = kernel.linearised(steps, table, offset, float(np.sin(mount.tilt_rad)), targets.is_slope)
    root = found[:6]
    return root, found[6:9], found[9] - np.log(root[0] * root[2] * root[5])


def drawn(root: Array, explained: Array, rng: np.random.Generator) -> tuple[Array, Array]:
    """Return standardised steps (3, N), and log p/q (N,) of having drawn them. root, explained: of `step_density`."""
    (l00, l10, l11, l20, l21, l22), step = root, rng.standard_normal(explained.shape)
    blind, (y0, y1, y2), (z0, z1, z2) = rng.random(len(step.T)) < BLIND, explained, step
    third = np.where(blind, z2, (y2 + z2) / l22)
    second = np.where(blind, z1, (y1 + z1 - l21 * third) / l11)
    first = np.where(blind, z0, (y0 + z0 - l10 * second - l20 * third) / l00)
    square = first**2 + second**2 + third**2
    square -= (l00 * first + l10 * second + l20 * third - y0) ** 2 + (l11 * second + l21 * third - y1) ** 2
    square -= (l22 * third - y2) ** 2
    return np.stack([first, second, third]), -_log_mixed(0.5 * square + np.log(l00 * l11 * l22))


def warm_up() -> None:
    """Compile the loops, or load them from the disk."""
    from localiser.filter import optimal_proposal_kernel as kernel

    cos_sin(np.zeros(MANY))
    one = Particles(POSE, np.zeros((3, 1)), np.zeros(1))
    MotionParameters().predict(one, Increment.from_mean(np.zeros(3)), np.random.default_rng(0))
    for is_slope in (False, True):
        kernel.linearised(np.zeros((13, 1)), np.zeros((1, 5)), (0.0, 0.0, 1.0, 0.0), 0.3, is_slope)


def flattened(log_evidence: Array, log_weight: Array) -> Array:
    """Return log (N,) of ψ with a fraction of its mean in its place, so that no particle is given up for ψ's sake."""
    mean = particles.log_sum(log_weight + log_evidence) - particles.log_sum(log_weight)
    return mean + _log_mixed(log_evidence - mean)


def _log_mixed(log_ratio: Array) -> Array:
    """Return log((1 - BLIND) ratio + BLIND): faster than `np.logaddexp`."""
    top = np.maximum(log_ratio, 0.0)
    return np.asarray(top + np.log((1 - BLIND) * np.exp(log_ratio - top) + BLIND * np.exp(-top)))
