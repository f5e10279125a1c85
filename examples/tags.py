"""Localise by your own observation: range and bearing to tags with known identities, without a camera.

Run it in the project's folder: `python examples/tags.py`.
"""

import numpy as np

from localiser import LandmarkMap, Localiser, Particles, Sighting, compose, read_config, robot_from_map, wrap_angle

SIGMA = np.array([0.05, np.radians(1.0)])  # errors of a range (m) and of a bearing (rad)
FARTHEST_M = 6.0


def range_and_bearing(poses: np.ndarray, tag: np.ndarray) -> np.ndarray:
    """Return range (m) and bearing (rad, positive to the right) (N, 2) of a tag at (x, z), seen from poses (N, 3)."""
    right, back = np.moveaxis(robot_from_map(poses, tag), -1, 0)
    return np.stack([np.hypot(right, back), np.arctan2(right, -back)], axis=-1)


class TagObservation:
    """The likelihood of tags. A measurement (T, 3) has one row for each tag: its index in the map, range, bearing."""

    def log_likelihood(self, particles: Particles, sighting: Sighting, landmark_map: LandmarkMap) -> np.ndarray:
        """Return log p(tags | particle) (N,): normal errors, independent of each other."""
        total = np.zeros(len(particles))
        for tag, *measured in sighting.measurement:
            error = measured - range_and_bearing(particles.poses, landmark_map.points[int(tag)])
            error[:, 1] = wrap_angle(error[:, 1])
            total -= 0.5 * np.sum((error / SIGMA) ** 2, axis=1)
        return total


def measured_tags(pose: np.ndarray, tags: LandmarkMap, rng: np.random.Generator) -> np.ndarray:
    """Return what the robot measures (T, 3) at a pose; use your own sensor instead."""
    seen = np.stack([range_and_bearing(pose, tag) for tag in tags.points])
    near = np.flatnonzero(seen[:, 0] < FARTHEST_M)
    return np.column_stack([near, rng.normal(seen[near], SIGMA)])


def main() -> None:
    """Drive a circle and print how far the estimate is from the truth."""
    rng = np.random.default_rng(0)
    tags = LandmarkMap.from_points(np.array([[-3.0, -3.0], [3.0, -3.0], [3.0, 3.0], [-3.0, 3.0]]))
    independent = read_config(overrides=["observation.decorrelation_m=0"])  # errors of consecutive measurements
    localiser = Localiser(tags, config=independent, seed=0, observation=TagObservation())
    localiser.start(pose=[0.2, -0.2, 0.1], cov=np.diag([0.3, 0.3, 0.1]) ** 2)

    errors_m = []
    true_pose, wheels = np.zeros(3), np.zeros(3)
    for step in range(1, 200):
        true_pose = compose(true_pose, [0.0, -0.05, np.radians(2.0)])  # right, backward, turn to the left
        wheels = compose(wheels, [0.0, -0.051, np.radians(2.04)])  # which measure 2 % too much
        localiser.odometry(step * 100_000_000, wheels)
        for frame in localiser.measurement(step * 100_000_000, measured_tags(true_pose, tags, rng)):
            errors_m.append(np.hypot(*(frame.located.estimate.pose - true_pose)[:2]))

    print(f"error: {errors_m[-1]:.3f} m, at most {max(errors_m):.3f} m")
    print(f"error of the wheels alone: {np.hypot(*(wheels - true_pose)[:2]):.3f} m")


if __name__ == "__main__":
    main()
