"""Draw one step of the filter for docs/filter.md: python docs/make_filter_figure.py."""

from __future__ import annotations

from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Ellipse, Rectangle

from localiser import geometry
from localiser.geometry import Array
from localiser.particles import systematic_resample

OUT = Path(__file__).resolve().parent / "figures" / "filter.svg"
INK, MUTED, CLOUD, HEAVY, LANDMARK, CLUTTER = "#22303c", "#8a97a3", "#6f9bc6", "#d1782f", "#3f8f5f", "#c2434f"
LANDMARKS = np.array([[-1.1, -4.1], [1.1, -3.2], [-0.35, -4.6], [0.55, -4.6]])
START, TRUTH, STEP = np.zeros(3), np.array([0.10, -1.28, -0.05]), np.array([0.0, -1.2, 0.0])
COUNT = 260
SPAN, INLIER_RATE, SIGMA = np.radians(64.0), 0.7, np.radians(1.5)


def expected_bearings(pose: Array) -> Array:
    """Return the bearing of every landmark from a pose."""
    seen = geometry.robot_from_map(pose, LANDMARKS)
    return np.asarray(np.arctan2(seen[..., 0], -seen[..., 1]))


def density(bearing: Array, pose: Array) -> Array:
    """Return p(bearing | pose) of the mixture over landmarks and clutter, for bearings (B,)."""
    normal = np.exp(-0.5 * ((bearing[:, None] - expected_bearings(pose)) / SIGMA) ** 2) / (SIGMA * np.sqrt(2 * np.pi))
    return (1 - INLIER_RATE) / SPAN + INLIER_RATE * normal.mean(axis=1)


def draw_floor(axes: Axes, title: str) -> None:
    """Walls and landmarks from above, ahead is up."""
    axes.add_patch(Rectangle((-1.1, -0.5), 2.2, 5.1, facecolor="#f5f7f9", edgecolor="none"))
    for x in (-1.1, 1.1):
        axes.plot([x, x], [-0.5, 4.6], color="#c9d1d8", lw=2.5, solid_capstyle="butt", zorder=1)
    axes.plot([-1.1, 1.1], [4.6, 4.6], color="#c9d1d8", lw=2.5, zorder=1)
    axes.plot(LANDMARKS[:, 0], -LANDMARKS[:, 1], "s", color=LANDMARK, ms=7, zorder=5)
    axes.set(xlim=(-1.65, 1.65), ylim=(-0.55, 4.85), aspect="equal")
    axes.set_title(title, loc="left")
    axes.axis("off")


def draw_poses(axes: Axes, poses: Array, colour: str | Array, size: float | Array, **style: float) -> None:
    """Particles as dots."""
    axes.scatter(poses[:, 0], -poses[:, 1], c=colour, s=size, linewidths=0, **style)


def draw_mixture(axes: Axes, pose: Array, measured: Array, clutter: int) -> None:
    """The density that one particle predicts over bearing, and the edges that were measured."""
    grid = np.linspace(-SPAN / 2, SPAN / 2, 1600)
    axes.fill_between(np.degrees(grid), density(grid, pose), color="#dcebe2", lw=0)
    axes.plot(np.degrees(grid), density(grid, pose), color=LANDMARK, lw=1.6)
    for at, bearing in enumerate(measured):
        height, colour = density(np.array([bearing]), pose)[0], CLUTTER if at == clutter else INK
        axes.plot(2 * [np.degrees(bearing)], [0, height], color=colour, lw=1.2)
        axes.plot(np.degrees(bearing), height, "o", color=colour, ms=5)
    floor = (1 - INLIER_RATE) / SPAN
    axes.axhline(floor, color=CLUTTER, lw=0.9, ls=":")
    axes.annotate(
        "an edge of no landmark meets\nclutter's density (1 − w) / span:\nits cost is bounded",
        (np.degrees(measured[clutter]), floor + 0.06),
        (np.degrees(measured[clutter]), 3.02),
        color=CLUTTER,
        size=9,
        ha="center",
        va="bottom",
        arrowprops={"arrowstyle": "-|>", "color": CLUTTER, "lw": 0.9},
    )
    axes.text(-31, 3.48, "p(edge | pose)", color=LANDMARK, size=9)
    axes.text(-31, 3.25, "measured edges", color=INK, size=9)
    axes.set(xlim=(-32, 32), ylim=(0, 3.7), xlabel="bearing (°)", yticks=[])
    axes.set_title("2a  What one particle expects", loc="left")
    axes.spines[["top", "right", "left"]].set_visible(False)


def main() -> None:
    """Draw the figure; the same bytes on every run."""
    rng = np.random.default_rng(3)
    plt.rcParams.update({"svg.hashsalt": "localiser", "font.size": 10, "axes.titleweight": "bold"})
    before = START + rng.normal(0, [0.10, 0.06, 0.05], (COUNT, 3))
    turn = rng.normal(0, 0.12, COUNT)
    moved = geometry.compose(before, np.stack([-0.6 * turn, STEP[1] * (1 + rng.normal(0, 0.08, COUNT)), turn], axis=-1))
    measured = np.append(expected_bearings(TRUTH) + rng.normal(0, 0.35 * SIGMA, len(LANDMARKS)), np.radians(14.0))
    log_weight = np.array([np.log(density(measured, pose)).sum() for pose in moved])
    weight = np.exp(log_weight - log_weight.max())
    weight /= weight.sum()
    mean = weight @ moved
    cov = np.cov(moved[:, :2].T, aweights=weight)

    figure, axes = plt.subplots(1, 4, figsize=(13.0, 4.9), layout="constrained", width_ratios=(1, 1.25, 1, 1))
    draw_floor(axes[0], "1  Predict")
    draw_poses(axes[0], before, CLOUD, 5, alpha=0.45)
    draw_poses(axes[0], moved, INK, 5, alpha=0.5)
    axes[0].annotate("", (0.42, 1.2), (0.42, 0.05), arrowprops={"arrowstyle": "-|>", "color": INK, "lw": 1.4})
    axes[0].text(0.5, 0.62, "odometry\nand its\nnoise", color=INK, va="center", size=8)
    axes[0].text(0, -0.32, "particles before", color=CLOUD, ha="center", size=9)
    axes[0].text(-1.2, 3.55, "landmarks", color=LANDMARK, ha="center", va="center", size=9, rotation=90)

    draw_mixture(axes[1], TRUTH + np.array([0.02, 0.0, -0.012]), measured, len(LANDMARKS))

    draw_floor(axes[2], "2b  Weigh")
    for bearing in measured[:-1]:
        ray = geometry.map_from_robot(TRUTH, 3.9 * np.array([np.sin(bearing), -np.cos(bearing)]))
        axes[2].plot([TRUTH[0], ray[0]], [-TRUTH[1], -ray[1]], color=HEAVY, lw=0.8, alpha=0.7)
    lost = geometry.map_from_robot(TRUTH, 3.2 * np.array([np.sin(measured[-1]), -np.cos(measured[-1])]))
    axes[2].plot([TRUTH[0], lost[0]], [-TRUTH[1], -lost[1]], color=CLUTTER, lw=1.2, ls="--")
    draw_poses(axes[2], moved, MUTED, 4, alpha=0.5)
    draw_poses(axes[2], moved, HEAVY, 420 * weight, zorder=6)
    axes[2].text(0, 0.2, "size of a dot:\nweight of the particle", color=HEAVY, ha="center", size=9)

    draw_floor(axes[3], "3  Estimate   4  Resample")
    chosen = systematic_resample(weight, len(weight), rng)
    draw_poses(axes[3], moved[chosen] + rng.normal(0, 0.008, (len(weight), 3)), INK, 5, alpha=0.5)
    values, vectors = np.linalg.eigh(cov)
    tilt = -np.degrees(np.arctan2(vectors[1, 1], vectors[0, 1]))
    axes[3].add_patch(
        Ellipse((mean[0], -mean[1]), 6 * values[1] ** 0.5, 6 * values[0] ** 0.5, angle=tilt, fill=False, ec=HEAVY, lw=2)
    )
    axes[3].plot(TRUTH[0], -TRUTH[1], "+", color=CLUTTER, ms=10, mew=1.8, zorder=7)
    axes[3].text(0, 0.3, "weighted mean and 3σ", color=HEAVY, ha="center", size=9)
    axes[3].text(0, 0.02, "+ true position", color=CLUTTER, ha="center", size=9)
    figure.savefig(OUT, metadata={"Date": None}, facecolor="white")


if __name__ == "__main__":
    main()
