"""The batched Kalman filter of direction and inverse distance, against filterpy's."""

from __future__ import annotations

import numpy as np
from filterpy.kalman import ExtendedKalmanFilter

from localiser.geometry import wrap_angle
from localiser.mapping.sightings import direction_of
from localiser.mapping.tracks import first_state, predicted, update_states


def test_many_filters_at_once_are_filterpys_one_by_one() -> None:
    rng, sigma = np.random.default_rng(0), np.full(4, 2e-3)
    points = np.array([[1.0, -4.0], [-0.5, -2.0], [3.0, -9.0], [0.2, -30.0]])
    cameras = np.stack([0.05 * np.sin(np.arange(12)), np.linspace(0.0, -1.2, 12), np.zeros(12)], axis=-1)
    seen = np.array([direction_of(points, np.tile(camera, (4, 1)))[0] for camera in cameras])
    seen = wrap_angle(seen + sigma * rng.standard_normal(seen.shape))
    origin = np.tile(cameras[0, :2], (4, 1))
    state, cov = first_state(seen[0], sigma, 1.0)
    filters = [ExtendedKalmanFilter(dim_x=2, dim_z=1) for _ in points]
    for k, ekf in enumerate(filters):
        ekf.x, ekf.P, ekf.R = state[k].copy(), cov[k].copy(), np.array([[sigma[k] ** 2]])
    for camera, heading in zip(cameras[1:], seen[1:], strict=True):
        expected, jacobian = predicted(origin, state, camera)
        state, cov = update_states(state, cov, wrap_angle(heading - expected), jacobian, sigma)
        for k, ekf in enumerate(filters):
            at = origin[k : k + 1]
            ekf.update(
                heading[k : k + 1],
                lambda x, at=at, camera=camera: predicted(at, x[None], camera)[1],
                lambda x, at=at, camera=camera: predicted(at, x[None], camera)[0],
                residual=lambda a, b: wrap_angle(a - b),
            )
            ekf.x[1] = max(ekf.x[1], 0.0)
    np.testing.assert_allclose(state, [ekf.x for ekf in filters], rtol=1e-9)
    np.testing.assert_allclose(cov, [ekf.P for ekf in filters], rtol=1e-9)
    # The nearer ones are known by now: the inverse distance is the true one within four sigmas.
    true = 1 / np.hypot(*(points - cameras[0, :2]).T)
    assert (np.abs(state[:, 1] - true) < 4 * np.sqrt(cov[:, 1, 1])).all()
    assert (np.sqrt(cov[:2, 1, 1]) < 0.1 * true[:2]).all()
