"""A located image with all results, which every sink takes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from localiser.filter.events import Located
from localiser.filter.mcl import Mcl
from localiser.geometry import Array
from localiser.observation import Matches, Sighting, matches_of

Image = NDArray[np.uint8] | bytes
"""Pixels (height, width) grey or (height, width, 3) BGR as OpenCV has them, or the bytes of a JPEG or PNG file."""


@dataclass(frozen=True, slots=True, eq=False)
class LocatedFrame:
    """One image, located.

    matches: which landmark each edge shows, seen from the estimate. image: None where edges were measured elsewhere.
    truth: (3,) true pose then, where known. stage_ms: what each stage of the work took.
    """

    located: Located
    matches: Matches
    image: Image | None
    truth: Array | None
    stage_ms: Mapping[str, float]


def matched(mcl: Mcl, located: Located) -> Matches:
    """Return which landmark each of the edges that particles were weighed by shows, seen from the estimate."""
    sighting = located.sighting or Sighting(located.t_ns, located.edges)
    return matches_of(mcl.observation, located.estimate.pose_as_seen, sighting, mcl.landmark_map)
