"""Replay a log with a hundred seeds on all cores, and print how the errors spread.

Run it in the project's folder: `python examples/hundred_seeds.py logs/corridor --seeds 100`.
"""

import argparse
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from functools import partial

import numpy as np

from localiser import ImageEvent, Log, Sighting, find_edges, open_log, replay_log


def with_edges(log: Log) -> Log:
    """Return the log with the edges of its images, which are the same for all seeds."""

    def edges_of(image: ImageEvent) -> Sighting:
        return Sighting(image.t_ns, find_edges(image.load(), log.camera))

    return replace(log, frames=[edges_of(frame) if isinstance(frame, ImageEvent) else frame for frame in log.frames])


def error_m(log: Log, seed: int) -> float:
    """Return the position error (RMS) of a replay with one seed."""
    return replay_log(log, seed=seed).metrics["position_rmse_m"]


def main() -> None:
    """Replay the log that the command line names."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("log", help="a log folder or a ROS bag, with a map and the truth")
    parser.add_argument("--seeds", type=int, default=100)
    arguments = parser.parse_args()

    log = with_edges(open_log(arguments.log))
    with ProcessPoolExecutor() as processes:
        errors_m = list(processes.map(partial(error_m, log), range(arguments.seeds)))
    low, median, high = np.quantile(errors_m, [0.05, 0.5, 0.95])
    print(f"{len(errors_m)} seeds: median error {median:.4f} m, 90 % between {low:.4f} and {high:.4f} m")


if __name__ == "__main__":
    main()
