"""Which share of an edge's error is seen again in the next images, learnt while driving.

What a landmark is off on the map, or what stands beside it, is seen again from nearby. Noise of an image is not.
`observation.correlation_of` says how far errors of the first kind agree between two images: ρ. If a share f of the
variance is of that kind, residuals z of the same landmark in two images have E[z z'] = f ρ E[z²]. So f is learnt from
pairs of residuals. An image then counts for 1 / (1 + 2 f ρ / (1 - ρ)), see `observation.novelty_of`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from localiser.geometry import Array
from localiser.observation import Matches

PRIOR_PAIRS = 100.0  # of residuals, that a share of 1 counts for: some five images
MEMORY_PAIRS = 5000.0  # by then other landmarks are in view
LEAST_SHARE = 0.05  # lens and mount are the same in every image, however good the map is
NEAR = 0.4  # correlation above which images are not compared: what matters is how long errors repeat
FEWEST = 4  # landmarks in an image: of fewer nothing is left beside the pose
FARTHEST = 3.0  # sigmas: edges beyond may be of something else


@dataclass(frozen=True, slots=True, eq=False)
class Repetition:
    """The share of errors that repeats.

    pairs: of residuals seen. product: Σ z z'. square: Σ ρ (z² + z'²) / 2, what that would be if all errors repeated.
    last: z (L,) of each landmark in an earlier image, nan where not seen. correlation: ρ since that image.
    """

    pairs: float = 0.0
    product: float = 0.0
    square: float = 0.0
    last: Array | None = None
    correlation: float = 1.0

    @property
    def share(self) -> float:
        """The share f of errors that repeats, 0 … 1."""
        found = self.product / self.square if self.square > 0.0 else 1.0
        share = (PRIOR_PAIRS + self.pairs * found) / (PRIOR_PAIRS + self.pairs)
        return float(np.clip(share, LEAST_SHARE, 1.0))

    def interrupted(self) -> Repetition:
        """Return it without the earlier image, when it is not known from where that was seen."""
        return replace(self, last=None)

    def after(self, matches: Matches, correlation: float) -> Repetition:
        """Return what is known after an image. correlation: ρ since the last image."""
        since = self.correlation * correlation
        if self.last is not None and since > NEAR:
            return replace(self, correlation=since)
        now = _standardised(matches)
        if self.last is None:
            return replace(self, last=now, correlation=1.0)
        in_both = np.isfinite(self.last) & np.isfinite(now)
        before, after = self.last[in_both], now[in_both]
        kept = np.exp(-len(after) / MEMORY_PAIRS)
        return Repetition(
            pairs=kept * self.pairs + len(after),
            product=kept * self.product + float(before @ after),
            square=kept * self.square + since * float(before @ before + after @ after) / 2,
            last=now,
        )


def _standardised(matches: Matches) -> Array:
    """Return residual over sigma (L,) of each landmark, nan where not seen; what is common to all is an error of the
    heading and is taken out.
    """
    z = np.full(len(matches.visible), np.nan)
    edge = np.flatnonzero(matches.landmark >= 0)
    if matches.sigma is not None:
        each = matches.residual[edge] / matches.sigma[edge]
        near = np.abs(each) < FARTHEST
        if near.sum() >= FEWEST:
            z[matches.landmark[edge[near]]] = each[near] - each[near].mean()
    return z
