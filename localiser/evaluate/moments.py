"""The worst moments of a run: images that say why it was unsure, or wrong. They are chosen while the run goes on.

Each kind of trouble has a score, and the images with the highest scores are kept, some seconds apart. So only a few
images and clouds of particles are in memory, however long the run is.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from localiser.evaluate.residuals import residual_sums
from localiser.filter import CORRECT_M, CORRECT_RAD, SURE, LocatedFrame
from localiser.geometry import wrap_angle

APART_NS = 3_000_000_000
MOST_OF_A_KIND = 2
FEWEST_EDGES = 5  # for how few of them match to say something


@dataclass(frozen=True, slots=True, eq=False)
class Moment:
    """An image of a run, and in what it is the worst. number: of the image, from 0."""

    number: int
    frame: LocatedFrame
    reasons: tuple[str, ...]


def error_m(frame: LocatedFrame) -> float:
    """Return the distance from the truth, nan where it is not known."""
    return float("nan") if frame.truth is None else float(np.hypot(*(frame.located.estimate.pose - frame.truth)[:2]))


def wrong_though_sure(frame: LocatedFrame) -> float:
    """Return the error of an image whose pose is sure and not within 0.5 m and 10°, else nan."""
    if frame.truth is None or frame.located.p_correct <= SURE:
        return float("nan")
    turn = abs(float(wrap_angle(frame.located.estimate.pose[2] - frame.truth[2])))
    return error_m(frame) if error_m(frame) > CORRECT_M or turn > CORRECT_RAD else float("nan")


def position_sigma_m(frame: LocatedFrame) -> float:
    """Return the RMS distance that the filter expects to be off."""
    return float(np.sqrt(np.trace(frame.located.estimate.pose_cov[:2, :2])))


def residuals_over(frame: LocatedFrame) -> float:
    """Return by how many standard deviations the squared residuals exceed what is expected."""
    found, expected, variance = residual_sums(frame.matches)
    return float((found - expected) / np.sqrt(variance))


def unmatched(frame: LocatedFrame) -> float:
    """Return the fraction of edges without a landmark, nan where there are few edges."""
    landmark = frame.matches.landmark
    return float((landmark < 0).mean()) if len(landmark) >= FEWEST_EDGES else float("nan")


SCORES: dict[str, Callable[[LocatedFrame], float]] = {
    "sure and wrong": wrong_though_sure,
    "largest error": error_m,
    "least sure": lambda frame: 1.0 - float(frame.located.p_correct),
    "largest uncertainty": position_sigma_m,
    "largest residuals": residuals_over,
    "fewest edges matched": unmatched,
}
"""What an image can be the worst in, and its score: the larger the worse, nan where it says nothing."""


Kept = list[tuple[float, int, LocatedFrame]]
"""Score, number and content of images, the worst first."""


@dataclass(slots=True, eq=False)
class WorstMoments:
    """Keeps the worst images of a run, a sink of `replay`."""

    _kept: dict[str, Kept] = field(default_factory=lambda: {kind: [] for kind in SCORES})
    _number: int = 0

    def frame(self, frame: LocatedFrame) -> None:
        """Take an image, and keep it where it is among the worst."""
        for kind, score_of in SCORES.items():
            score = score_of(frame)
            if np.isfinite(score):
                self._kept[kind] = _with(self._kept[kind], (score, self._number, frame))
        self._number += 1

    def close(self, complete: bool) -> None:
        """End; what was kept stays."""

    @property
    def moments(self) -> list[Moment]:
        """The worst images, each once, in the order of time."""
        frames: dict[int, LocatedFrame] = {}
        reasons: dict[int, list[str]] = {}
        for kind, kept in self._kept.items():
            for _, number, frame in kept:
                frames[number] = frame
                reasons.setdefault(number, []).append(kind)
        return [Moment(number, frames[number], tuple(reasons[number])) for number in sorted(frames)]


def _with(kept: Kept, one: tuple[float, int, LocatedFrame]) -> Kept:
    """Return the worst of those kept and one more, of images close in time the worst alone."""
    near = [other for other in kept if abs(other[2].located.t_ns - one[2].located.t_ns) < APART_NS]
    if any(other[0] >= one[0] for other in near):
        return kept
    far = [other for other in kept if all(other is not close for close in near)]
    return sorted([*far, one], key=lambda item: (-item[0], item[1]))[:MOST_OF_A_KIND]
