"""Whether tilt and roll over a log, and their sigmas, are right where things lean: many simulated worlds.

python benchmarks/leaning.py --worlds 60        # a table: errors, sigmas, errors in sigmas
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np

from localiser.calibration import mount_of_lines
from localiser.geometry import Array

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "tests" / "support"))

WORLDS = ((0.3, 0.15, "any"), (0.3, 0.15, "along"), (0.3, 0.15, "back"), (0.1, 0.3, "any"), (0.02, 0.02, "any"))
STATED_OFF_RAD = np.deg2rad([0.4, -0.3])


def errors_and_sigmas(seed: int, row_deg: float, own_deg: float, along: str) -> Array:
    """Return error and sigma (2, 2) deg of tilt and roll in one world."""
    from leaning_rows import leaning_drive

    drive = leaning_drive(seed, row_deg=row_deg, own_deg=own_deg, along=along)
    found = mount_of_lines(drive.lines, drive.odometry, drive.camera, drive.mount + STATED_OFF_RAD)
    return np.rad2deg([found.mount - drive.mount, found.sigma])


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--worlds", type=int, default=60)
    worlds = parser.parse_args().worlds
    print(
        "| row leans ° | each ° | direction | RMSE of tilt, roll ° | sigma, median ° | RMS in sigmas | worst | over 3 |"
    )
    for number, (row_deg, own_deg, along) in enumerate(WORLDS):
        seeds = range(1000 * number, 1000 * number + worlds)
        error, sigma = np.moveaxis([errors_and_sigmas(seed, row_deg, own_deg, along) for seed in seeds], 1, 0)
        rmse, median, scaled = np.sqrt((error**2).mean(axis=0)), np.median(sigma, axis=0), np.abs(error / sigma)
        rms, worst = np.sqrt((scaled**2).mean(axis=0)), scaled.max(axis=0)
        print(
            f"| {row_deg} | {own_deg} | {along} | {rmse[0]:.3f}, {rmse[1]:.3f} | {median[0]:.3f}, {median[1]:.3f} | "
            f"{rms[0]:.2f}, {rms[1]:.2f} | {worst[0]:.1f}, {worst[1]:.1f} | {(scaled > 3).mean():.1%} |",
            flush=True,
        )
