"""Pose proposals: from the edges of one image to a density that particles are drawn from."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from localiser.geometry import Array
from localiser.relocalisation import hypotheses
from localiser.relocalisation.evidence import evidence_of, score_poses
from localiser.relocalisation.mixture import Proposals
from localiser.relocalisation.places import Places
from localiser.relocalisation.refine import refined
from localiser.relocalisation.views import View

LogLikelihood = Callable[[Array], Array]

FEWEST = 5  # edges; fewer may all be clutter almost anywhere, and draws that are even are as good as any
SEARCH_BLUR_RAD = np.radians(0.4)  # how far off the bearings of a hypothesis may be
EQUAL = 0.5  # part of the draws in which all Gaussians count alike
SAME_M, SAME_RAD = 0.2, np.radians(6.0)  # hypotheses in one such cell are one


@dataclass(frozen=True, slots=True)
class ProposalParameters:
    """How hard to look for poses in one frame."""

    hypotheses: Annotated[int, Field(ge=1, description="poses tried by their quick score in one frame")] = 12_500
    refined: Annotated[int, Field(ge=1, description="of these, the best that are refined and weighed")] = 50
    kept: Annotated[int, Field(ge=1, description="Gaussians that the density is made of")] = 40
    widened: Annotated[float, Field(ge=1, description="factor on each Gaussian's sigmas, against thin tails")] = 1.2
    tempered: Annotated[
        float, Field(gt=0, le=1, description="power of the likelihood by which the Gaussians are mixed")
    ] = 0.5
    even: Annotated[float, Field(gt=0, le=1, description="share of draws that are even over the region")] = 0.05

    def scaled(self, effort: float) -> ProposalParameters:
        """Return parameters with this part of the work, or multiple of it."""

        def part(count: int) -> int:
            return max(round(effort * count), 1)

        return replace(self, hypotheses=part(self.hypotheses), refined=part(self.refined), kept=part(self.kept))


def propose(
    view: View,
    places: Places,
    log_likelihood: LogLikelihood,
    rng: np.random.Generator,
    parameters: ProposalParameters | None = None,
) -> Proposals:
    """Return a density over robot poses that is high where the edges of an image fit the map.

    log_likelihood: maps robot poses (K, 3) to log p(edges | pose) (K,), up to a constant. Called once, with at most
    `refined` poses. Half of the draws are from the likelier Gaussians, half from all alike, because one image tells
    little of which of them is right.
    """
    parameters = parameters or ProposalParameters()
    if len(view) < FEWEST:
        return Proposals.blind(places.region)
    candidates, hits = _best_hypotheses(view, places, rng, parameters)
    poses, covs = refined(view, places, candidates)
    inside = places.region.contains(poses)
    poses, covs = poses[inside], covs[inside]
    if len(poses) == 0:
        return replace(Proposals.blind(places.region), hits=hits)
    # Laplace: the mass of a mode is its height times its volume.
    mass = log_likelihood(poses) + 0.5 * np.linalg.slogdet(covs)[1]
    best = _distinct(poses, mass)[: parameters.kept]
    likely = parameters.tempered * mass[best]
    weight = (1.0 - EQUAL) * np.exp(likely - np.logaddexp.reduce(likely)) + EQUAL / len(best)
    log_weight = np.log(weight)
    return Proposals(log_weight, poses[best], covs[best] * parameters.widened**2, places.region, parameters.even, hits)


def _best_hypotheses(
    view: View, places: Places, rng: np.random.Generator, parameters: ProposalParameters
) -> tuple[Array, float]:
    """Return the poses (K, 3) that the quick score likes best, none beside another.

    The second value is how many of those tried are expected to be the true one.
    """
    count = parameters.hypotheses
    poses, hits = hypotheses.from_feet(view, places, count, rng)
    if len(poses) < count // 2:
        more, more_hits = hypotheses.from_bearings(view, places, count - len(poses), rng)
        poses, hits = np.concatenate([poses, more]), hits + more_hits
    poses = poses[places.region.contains(poses)]
    evidence = evidence_of(view, SEARCH_BLUR_RAD)
    score = score_poses(evidence, places, poses)
    return np.asarray(poses[_distinct(poses, score)[: parameters.refined]]), hits


def _distinct(poses: Array, score: Array) -> NDArray[np.int64]:
    """Return indices of poses (N, 3), best score (N,) first, of each cell in space and heading only the best."""
    order = np.argsort(-score, kind="stable")
    if len(order) == 0:
        return order
    cell = np.floor(poses[order] / [SAME_M, SAME_M, SAME_RAD]).astype(np.int64)
    cell -= cell.min(axis=0)
    extent = cell.max(axis=0) + 1
    _, first = np.unique((cell[:, 0] * extent[1] + cell[:, 1]) * extent[2] + cell[:, 2], return_index=True)
    return np.asarray(order[np.sort(first)])
