"""Is p_correct right? Log score, expected calibration error, and the diagram of claims against what was right.

All images of a run are summed up in ten ranges of p_correct. Every scenario counts the same, however many images it
has. Intervals draw whole runs with replacement, since images of one run are not independent.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from localiser.geometry import Array

BINS = 10
LEAST = 1e-6  # probability that the log score takes for 0: one image that was certain and wrong costs 13.8 nats
RESAMPLES = 1000


@dataclass(frozen=True, slots=True, eq=False)
class Claims:
    """Claims of one run by range of p_correct, each (10,): images, sum of p_correct, images that were right.

    log_score: sum over all images.
    """

    count: Array
    claimed: Array
    right: Array
    log_score: float

    @classmethod
    def of(cls, p_correct: Array, right: Array) -> Claims:
        """Sum up T claims, p_correct (T,), and whether each was right (T,)."""
        index = np.minimum((p_correct * BINS).astype(int), BINS - 1)
        count, claimed, hits = (
            np.bincount(index, weights, minlength=BINS) for weights in (np.ones(len(index)), p_correct, right)
        )
        said = np.clip(np.where(right, p_correct, 1.0 - p_correct), LEAST, 1.0)
        return cls(count, claimed, hits, float(np.log(said).sum()))

    @property
    def table(self) -> Array:
        """Images, sum of p_correct and images that were right (3, 10)."""
        return np.array([self.count, self.claimed, self.right])


@dataclass(frozen=True, slots=True, eq=False)
class Calibration:
    """What runs claimed. ece, log_score: value and its 95 % interval. rows: see `rows_of`."""

    images: int
    ece: tuple[float, float, float]
    log_score: tuple[float, float, float]
    rows: Array


def calibration(runs: Mapping[str, Sequence[Claims]]) -> Calibration:
    """Return how well the claims of runs, by scenario, are calibrated; every scenario has the same weight."""
    rng = np.random.default_rng(0)
    tables = [np.array([one.table for one in claims]) for claims in runs.values()]
    scores = [np.array([one.log_score for one in claims]) for claims in runs.values()]
    drawn_ece, drawn_score, drawn_share = [], [], []
    for _ in range(RESAMPLES):
        drawn = [rng.integers(len(table), size=len(table)) for table in tables]
        mean = _mean([table[k] for table, k in zip(tables, drawn, strict=True)])
        drawn_ece.append(_ece(mean))
        drawn_score.append(_score(tables, scores, drawn))
        drawn_share.append(_share(mean))
    mean, everyone = _mean(tables), [np.arange(len(table)) for table in tables]
    return Calibration(
        int(sum(table[:, 0].sum() for table in tables)),
        _with_interval(_ece(mean), drawn_ece),
        _with_interval(_score(tables, scores, everyone), drawn_score),
        rows_of(sum(table.sum(axis=0) for table in tables), mean, np.array(drawn_share)),
    )


def rows_of(total: Array, mean: Array, drawn: Array) -> Array:
    """Return for each range with images: its number, images, mean claim, share that was right, 95 % interval (R, 6).

    total: (3, 10) over all images. mean: the same with equal weight of scenarios. drawn: (B, 10) resampled shares.
    """
    filled = np.flatnonzero(total[0])
    claimed, right = (np.divide(mean[k], mean[0], where=mean[0] > 0, out=np.zeros(BINS)) for k in (1, 2))
    low, high = np.nanquantile(drawn[:, filled], [0.025, 0.975], axis=0)
    return np.stack([filled, total[0, filled], claimed[filled], right[filled], low, high], axis=1)


def draw(all_runs: Calibration, by_scenario: Mapping[str, Calibration], path: Path) -> None:
    """Draw the diagram: what was claimed against what was right, all runs and each scenario."""
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(figsize=(5.6, 5.6), dpi=130, layout="constrained")
    axes.plot([0, 1], [0, 1], color="0.7", linewidth=1, label="claimed = true")
    rows = all_runs.rows
    reach = np.maximum([rows[:, 3] - rows[:, 4], rows[:, 5] - rows[:, 3]], 0.0)
    axes.errorbar(rows[:, 2], rows[:, 3], reach, fmt="o-", color="#d97706", capsize=3, label="all", zorder=3)
    colours = ("#2563eb", "#16a34a", "#9333ea", "#db2777", "#0891b2", "#65a30d", "#78716c")
    for (scenario, one), colour in zip(by_scenario.items(), colours, strict=False):
        axes.plot(one.rows[:, 2], one.rows[:, 3], ".--", color=colour, linewidth=0.8, label=scenario)
    axes.set(xlabel="p_correct, mean of a range", ylabel="share within 0.5 m and 10°", xlim=(0, 1), ylim=(0, 1.02))
    figure.legend(loc="outside lower center", ncols=4, frameon=False, fontsize="small")
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path)
    plt.close(figure)


def _mean(tables: Sequence[Array]) -> Array:
    """Return (3, 10) shares of images, mean over scenarios of runs (R, 3, 10)."""
    return np.mean([table.sum(axis=0) / table[:, 0].sum() for table in tables], axis=0)


def _ece(mean: Array) -> float:
    return float(np.abs(mean[1] - mean[2]).sum())


def _score(tables: Sequence[Array], scores: Sequence[Array], drawn: Sequence[Array]) -> float:
    parts = [score[k].sum() / table[k, 0].sum() for table, score, k in zip(tables, scores, drawn, strict=True)]
    return float(np.mean(parts))


def _share(mean: Array) -> Array:
    return np.divide(mean[2], mean[0], where=mean[0] > 0, out=np.full(BINS, np.nan))


def _with_interval(value: float, drawn: Sequence[float]) -> tuple[float, float, float]:
    low, high = np.quantile(drawn, [0.025, 0.975])
    return value, float(low), float(high)
