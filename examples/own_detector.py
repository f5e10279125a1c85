"""Localise with your own edge detector.

Run it in the project's folder: `python examples/own_detector.py logs/corridor`.
"""

import argparse

import cv2
import numpy as np

from localiser import Camera, replay_log


def half_size(image: np.ndarray, camera: Camera) -> np.ndarray:
    """Return line segments (S, 4) of a grey image: u, v of one end, u, v of the other, in pixels.

    This one is OpenCV's LSD at half the image size. Lines that are not vertical are sorted out later.
    """
    small = cv2.resize(image, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
    lines = cv2.createLineSegmentDetector().detect(small)[0]
    return np.zeros((0, 4)) if lines is None else 2.0 * lines.reshape(-1, 4) + 0.5


def main() -> None:
    """Replay the log that the command line names, and print the error."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("log", help="a log folder or a ROS bag, with images and a map")
    run = replay_log(parser.parse_args().log, detector=half_size)
    print(f"edges in an image: {run.metrics['edges_per_frame']:.1f}")
    print(f"error: {run.metrics['position_rmse_m']:.4f} m")


if __name__ == "__main__":
    main()
