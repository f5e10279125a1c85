"""Motions as Gaussians and as twists.

A twist is the constant velocity (right, backward, turn) that makes a motion in one unit of time. A robot that steers
goes along arcs, so that its sideways velocity is 0 although the chord of its way points sideways.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from localiser.geometry import Array, arc_log, arc_motion, map_from_robot, wrap_angle


@dataclass(frozen=True, slots=True, eq=False)
class Gaussian:
    """What is believed of a motion: mean (3,), right (m), backward (m), turn (rad), and covariance (3, 3)."""

    mean: Array
    cov: Array

    def log_density(self, value: Array) -> float:
        """Return log N(value (3,); mean, cov)."""
        apart = value - self.mean
        return float(-0.5 * (apart @ np.linalg.solve(self.cov, apart) + np.linalg.slogdet(2 * np.pi * self.cov)[1]))

    def mixed(self, other: Gaussian, share: float) -> Gaussian:
        """Return the Gaussian with mean and covariance of a mixture, of which `share`, 0 … 1, is the other one."""
        apart = other.mean - self.mean
        cov = (1.0 - share) * self.cov + share * other.cov + share * (1.0 - share) * np.outer(apart, apart)
        return Gaussian(self.mean + share * apart, cov)


def mixture(parts: Sequence[Gaussian], log_weight: Array) -> Gaussian:
    """Return the Gaussian with mean and covariance of a mixture of K motions; log_weight: (K,), up to a constant."""
    weight = np.exp(log_weight - log_weight.max())
    weight /= weight.sum()
    origin = parts[int(weight.argmax())].mean
    offset = np.array([part.mean - origin for part in parts])
    offset[:, 2] = wrap_angle(offset[:, 2])
    mean = weight @ offset
    spread = offset - mean
    cov = np.einsum("k,kij->ij", weight, [part.cov for part in parts]) + np.einsum(
        "k,ki,kj->ij", weight, spread, spread
    )
    total = origin + mean
    total[2] = wrap_angle(total[2])
    return Gaussian(total, cov)


def at_least(cov: Array, other: Array) -> Array:
    """Return the smallest covariance (3, 3) that is in no direction below either: both estimate the same spread."""
    root = np.linalg.cholesky(cov)
    inverse = np.linalg.inv(root)
    ratio, axes = np.linalg.eigh(inverse @ other @ inverse.T)
    grown = root @ axes * np.sqrt(np.maximum(ratio, 1.0))
    return np.asarray(grown @ grown.T)


def motion_of(twist: Array) -> Array:
    """Return the motion (3,) that a twist (3,) makes in its unit of time."""
    return arc_motion(twist[:2], float(twist[2]), 1.0)


def twist_of(motion: Array) -> Array:
    """Return the twist (3,) that makes this motion (3,)."""
    return np.append(arc_log(motion), motion[2])


def motion_gaussian(twist: Gaussian) -> Gaussian:
    """Return the motion, to first order, of a twist that is known so well."""
    jac = motion_by_twist(twist.mean)
    return Gaussian(motion_of(twist.mean), jac @ twist.cov @ jac.T)


def twist_gaussian(motion: Gaussian) -> Gaussian:
    """Return the twist, to first order, of a motion that is known so well."""
    twist = twist_of(motion.mean)
    jac = np.linalg.inv(motion_by_twist(twist))
    return Gaussian(twist, jac @ motion.cov @ jac.T)


def motion_by_twist(twist: Array) -> Array:
    """Return ∂motion/∂twist (3, 3)."""
    jac = np.eye(3)
    turn = float(twist[2])
    for column in range(2):
        jac[:2, column] = arc_motion(np.eye(2)[column], turn, 1.0)[:2]
    # ψ F = ∫ R(s) v ds from 0 to ψ, hence F' = (R(ψ) v - F) / ψ.
    at_end = map_from_robot([0.0, 0.0, turn], twist[:2])
    jac[:2, 2] = [twist[1] / 2, -twist[0] / 2] if abs(turn) < 1e-6 else (at_end - motion_of(twist)[:2]) / turn
    return jac
