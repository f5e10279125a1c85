"""Compare the shipped defaults of the odometry's noise with real wheels: encoders and motion capture.

python benchmarks/wheels.py          # 25 runs of a small robot in $LOCALISER_DATA/wheels
"""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np

from localiser.calibration import ALPHAS, SCALES, Drive, Pieces, fit_odometry, on_one_clock
from localiser.geometry import Array, Trajectory, compose
from localiser.motion import MotionParameters

METRES_A_TICK = np.pi * 0.084 / (43.7 * 64)
TRACK_M = 0.2
PIECES = ((1.0, 1.0), (0.3, 0.3))


def read_drive(path: Path) -> Drive:
    """Return a run: columns t s, x, y, theta (truth, ROS axes), ticks right and left of each cycle."""
    t_s, x, y, theta, right, left = np.loadtxt(path, delimiter=",").T
    t_ns = np.round(1e9 * (t_s - t_s[0])).astype(np.int64)
    truth = np.stack([x, -y, np.unwrap(theta) - np.pi / 2], axis=-1)
    return Drive(f"{path.parent.name}/{path.stem}", Trajectory(t_ns, _by_wheels(right, left)), Trajectory(t_ns, truth))


def _by_wheels(right: Array, left: Array) -> Array:
    """Return the poses (T, 3) that nominal wheels report."""
    way, turn = METRES_A_TICK * (right + left) / 2, METRES_A_TICK * (right - left) / TRACK_M
    poses = np.zeros((len(way), 3))
    for k in range(1, len(way)):
        half = turn[k] / 2
        step = [-way[k] * np.sin(half), -way[k] * np.cos(half), turn[k]]
        poses[k] = compose(poses[k - 1], step)
    poses[:, 2] = np.unwrap(poses[:, 2])
    return poses


def main() -> None:
    """Print constants of each run, fitted noise, and how honest defaults and fit are on each kind of drive."""
    folder = Path(os.environ.get("LOCALISER_DATA", "../shared/data")) / "wheels"
    checked = [on_one_clock(read_drive(path)) for path in sorted(folder.glob("*/*.csv"))]
    drives = [drive for drive, _ in checked]
    before = MotionParameters()
    fit = fit_odometry(drives, before)
    if fit is None:
        raise SystemExit(f"{folder}: expected drives, found too few")
    print(f"{'run':34}" + "".join(f"{name:>16}" for name in SCALES) + "   truth is stamped")
    for (drive, clock), values in zip(checked, fit.constants, strict=True):
        print(f"{drive.name:34}" + "".join(f"{value:16.4f}" for value in values) + f"   {clock.text}")
    for name, factor in zip(ALPHAS, fit.factor, strict=True):
        print(f"{name}: default {getattr(before, name):.2e}, found {getattr(fit.motion, name):.2e} ×/÷ {factor:.2f}")
    print("consistency (1: honest, below: modest), distance and turn")
    for kind in sorted({drive.name.split("/")[0] for drive in drives}):
        for piece_m, piece_rad in PIECES:
            own = [drive for drive in drives if drive.name.startswith(kind)]
            pieces = Pieces.together([Pieces.of(drive, i, piece_m, piece_rad) for i, drive in enumerate(own)])
            texts = [f"{name} {pieces.consistency(motion).round(2)}" for name, motion in _named(before, fit.motion)]
            print(f"{kind:10} {piece_m:g} m or {piece_rad:g} rad, {len(pieces):4} pieces: {', '.join(texts)}")


def _named(before: MotionParameters, found: MotionParameters) -> tuple[tuple[str, MotionParameters], ...]:
    return ("defaults", before), ("fitted", found)


if __name__ == "__main__":
    main()
