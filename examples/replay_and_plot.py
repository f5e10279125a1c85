"""Replay a log and plot the path.

Run it in the project's folder: `python examples/replay_and_plot.py logs/corridor --out path.png`.
"""

import argparse

import matplotlib.pyplot as plt

from localiser import open_log, replay_log


def main() -> None:
    """Replay the log that the command line names."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("log", help="a log folder or a ROS bag, with a map")
    parser.add_argument("--out", help="a picture to write; without it, a window is shown")
    arguments = parser.parse_args()

    log = open_log(arguments.log)
    run = replay_log(log)
    for name in ("position_rmse_m", "position_max_m", "heading_rmse_deg"):
        print(f"{name}: {run.metrics[name]}")

    _, axes = plt.subplots(figsize=(9, 6), layout="constrained")
    axes.plot(*log.landmark_map.points.T, ".", color="grey", label="landmarks")
    if log.groundtruth is not None:
        axes.plot(*log.groundtruth.poses[:, :2].T, color="black", label="true path")
    axes.plot(*run.track.poses[:, :2].T, color="tab:orange", label="estimate")
    axes.set(xlabel="x (m)", ylabel="z (m)", title=log.name, aspect="equal")
    axes.invert_yaxis()  # z points backward
    axes.legend()
    plt.savefig(arguments.out) if arguments.out else plt.show()


if __name__ == "__main__":
    main()
