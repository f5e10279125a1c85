"""The motion that edges followed from one frame to the next tell: least squares over motion, mount and ranges.

Unknown are the robot's motion x (3), errors common to all edges (K, whitened by their prior), the typical inverse
range μ of what is in view, and of every edge its bearing and inverse range (b, ρ). An edge gives up to four
measurements, its bearing and the inverse range of its foot in both frames, and one belief: ρ ~ N(μ, spread²). Each
edge appears in its own equations only, so it is eliminated by the Schur complement, and what is left is a handful of
unknowns however many edges there are.

Nothing is assumed about how the robot can move. What the edges do not tell, such as the distance driven when no range
is known, keeps the covariance that it had before.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from localiser.camera import Camera
from localiser.geometry import Array
from localiser.increments.pairs import TYPICAL_INVERSE_RANGE, TYPICAL_SPREAD
from localiser.increments.views import Sights, camera_motion, predicted

_STEPS = 3
_SMALL_STEP = 1e-5
_LEAST_WEIGHT = 1e-6  # keeps the equations of an edge that tells nothing solvable


@dataclass(frozen=True, slots=True, eq=False)
class Gaussian:
    """What is believed about a motion: mean (3,), right (m), backward (m), turn (rad), and covariance (3, 3)."""

    mean: Array
    cov: Array

    def log_density(self, value: Array) -> float:
        """Return log N(value (3,); mean, cov)."""
        apart = value - self.mean
        return float(-0.5 * (apart @ np.linalg.solve(self.cov, apart) + np.linalg.slogdet(2 * np.pi * self.cov)[1]))


@dataclass(frozen=True, slots=True, eq=False)
class Links:
    """M followed edges. sights: what both frames say of them. weight, on_floor: (M,) 0 … 1, of the link and the feet.

    feet: whether ranges of feet count.
    """

    sights: tuple[Sights, Sights]
    weight: Array
    on_floor: Array
    feet: bool = True


@dataclass(frozen=True, slots=True, eq=False)
class Solution:
    """motion: (3,) of the robot. cov: (3, 3). inverse_range: (M,) 1/m of the edges from the first camera."""

    motion: Array
    cov: Array
    inverse_range: Array


def solve(links: Links, camera: Camera, motion: Array, prior: Gaussian) -> Solution:
    """Return the motion that explains the links best, by Gauss-Newton from `motion` (3,), given a prior of it."""
    one, two = links.sights
    terms = one.common.shape[-1]
    measured = np.concatenate([one.measured, two.measured, np.zeros((len(one.measured), 1))], axis=1)
    before = np.eye(4 + terms)
    before[:3, :3] = np.linalg.inv(prior.cov)
    before[-1, -1] = 1.0 / TYPICAL_SPREAD**2
    expected = np.concatenate([prior.mean, np.zeros(terms), [TYPICAL_INVERSE_RANGE]])

    weight = _weight(links)
    unknown = np.concatenate([motion, expected[3:]])
    edge = np.stack([one.bearing, _first_inverse_range(links)], axis=-1)
    for _ in range(_STEPS):
        model, by_edge, by_unknown = _model(links, camera, unknown, edge)
        residual = np.where(weight > 0, measured - model, 0.0)
        weighted = by_edge * weight[..., None]
        own = np.linalg.inv(np.swapaxes(weighted, 1, 2) @ by_edge)
        cross = np.swapaxes(weighted, 1, 2) @ by_unknown
        pull = (np.swapaxes(weighted, 1, 2) @ residual[..., None])[..., 0]
        # Schur complement: what the edges leave to say about what they share.
        reduced = own @ cross
        information = (
            before
            + np.einsum("mri,mr,mrj->ij", by_unknown, weight, by_unknown)
            - np.einsum("mai,maj->ij", cross, reduced)
        )
        gradient = (
            before @ (expected - unknown)
            + np.einsum("mri,mr,mr->i", by_unknown, weight, residual)
            - np.einsum("mai,ma->i", reduced, pull)
        )
        step = np.linalg.solve(information, gradient)
        unknown = unknown + step
        edge = edge + (own @ (pull - cross @ step)[..., None])[..., 0]
        if np.abs(step).max() < _SMALL_STEP:
            break
    return Solution(unknown[:3], np.linalg.inv(information)[:3, :3], edge[:, 1])


def _model(links: Links, camera: Camera, unknown: Array, edge: Array) -> tuple[Array, Array, Array]:
    """Return what is expected (M, 5), and its derivatives by the edge (M, 5, 2) and by the shared unknowns (M, 5, U).

    Bearing and inverse range in the first frame, the same in the second, and that the inverse range is a typical
    one.
    """
    one, two = links.sights
    moved, by_robot = camera_motion(unknown[:3], camera)
    seen = predicted(edge[:, 0], edge[:, 1], moved)
    by_edge = np.zeros((len(edge), 5, 2))
    by_edge[:, :2] = np.eye(2)
    by_edge[:, 2:4] = seen.by_edge
    by_edge[:, 4, 1] = 1.0
    by_unknown = np.zeros((len(edge), 5, len(unknown)))
    by_unknown[:, :2, 3:-1], by_unknown[:, 2:4, 3:-1] = one.common[:, :2], two.common[:, :2]
    by_unknown[:, 2:4, :3] = seen.by_motion @ by_robot
    by_unknown[:, 4, -1] = -1.0
    model = np.empty((len(edge), 5))
    model[:, :2], model[:, 2], model[:, 3] = edge, seen.bearing, seen.inverse_range
    model[:, 4] = edge[:, 1]
    return model + by_unknown[..., 3:] @ unknown[3:], by_edge, by_unknown


def _weight(links: Links) -> Array:
    """Return the weights (M, 5) of the equations: inverse variances, times how surely each holds; 0 where unknown."""
    one, two = links.sights
    sigma = np.concatenate([one.sigma, two.sigma, np.full((len(one.sigma), 1), TYPICAL_SPREAD)], axis=1)
    weight = np.nan_to_num(np.maximum(links.weight, _LEAST_WEIGHT)[:, None] / sigma**2)
    weight[:, [1, 3]] *= links.on_floor[:, None] * links.feet
    return np.asarray(weight)


def _first_inverse_range(links: Links) -> Array:
    one, two = links.sights
    foot = np.where(np.isnan(one.inverse_range), two.inverse_range, one.inverse_range)
    return np.where(np.isnan(foot) | (links.on_floor < 0.5), TYPICAL_INVERSE_RANGE, foot)
