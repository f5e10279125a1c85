"""Localise a robot from your own arrays of bearings, without images.

Run it in the project's folder: `python examples/own_bearings.py`.
"""

from collections.abc import Iterator

import numpy as np

from localiser import BearingSensor, Edges, LandmarkMap, Localiser, compose, robot_from_map

SENSOR = BearingSensor(bearing_sigma_deg=1.0, half_view_deg=45.0)
SIGMA = np.radians(SENSOR.bearing_sigma_deg)
Pose = np.ndarray  # x (m), z (m), heading (rad)


def measured(landmarks: np.ndarray, steps: int) -> Iterator[tuple[int, Pose, np.ndarray, Pose]]:
    """Yield time (ns), pose of the wheels, bearings (rad, positive to the right), true pose: put your own data here."""
    rng = np.random.default_rng(1)
    true_pose, wheels = np.zeros(3), np.zeros(3)
    for step in range(steps):
        right, back = robot_from_map(true_pose, landmarks).T
        bearing = np.arctan2(right, -back)
        seen = np.abs(bearing) < np.radians(SENSOR.half_view_deg)
        yield step * 100_000_000, wheels, rng.normal(bearing[seen], SIGMA), true_pose
        true_pose = compose(true_pose, [0.0, -0.05, np.radians(2.0)])  # right, backward, turn to the left
        wheels = compose(wheels, [0.0, -0.051, np.radians(2.04)])  # which measure 2 % too much


def main() -> None:
    """Drive a circle and print how far the estimate is from the truth."""
    landmarks = np.random.default_rng(0).uniform(-6.0, 6.0, (30, 2))  # x, z in metres
    localiser = Localiser(LandmarkMap.from_points(landmarks), SENSOR.camera(), seed=0)
    localiser.start(pose=[0.2, -0.2, 0.1], cov=np.diag([0.3, 0.3, 0.1]) ** 2)

    errors_m = []
    for t_ns, wheels, bearings, true_pose in measured(landmarks, steps=200):
        localiser.odometry(t_ns, wheels)
        for frame in localiser.edges(t_ns, Edges.from_bearings(bearings, SIGMA)):
            errors_m.append(np.hypot(*(frame.located.estimate.pose - true_pose)[:2]))

    print(f"error: {errors_m[-1]:.3f} m, at most {max(errors_m):.3f} m")
    print(f"error of the wheels alone: {np.hypot(*(wheels - true_pose)[:2]):.3f} m")


if __name__ == "__main__":
    main()
